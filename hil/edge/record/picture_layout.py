"""Where everything stands in the picture of the tanks, and what in it never changes.

x goes to the right, y downwards, as in Rerun's 2D views. The tallest tank is `TALLEST` units high; the scale of all
levels follows from that. Water of pump 1 is blue and that of pump 2 orange, as in the plots; what is diagnosed is
magenta and has a mark and a label, so that nobody depends on the colour.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import rerun as rr

from hil.edge.record.picture_model import PictureModel
from hil.edge.record.signals import AMBER, BLUE, GREY, ORANGE, WHITE

Floats = npt.NDArray[np.float64]
Point = tuple[float, float]
Strip = tuple[Point, ...]

ROOM = "picture"
"""Entity below which the picture is."""

WATER_LINE = 0x6FB1E0FF
MAGENTA, WALL, PIPE, WATER = 0xFF5CB8FF, 0xC9D1D9FF, 0x3A424BFF, (52, 108, 158, 255)
TALLEST, WIDTH = 20.0, 10.0
LEFT_X, RIGHT_X, UPPER_Y, LOWER_Y = 14.0, 40.0, 20.0, 48.0
"""Left walls of the left (1, 3) and the right (2, 4) tanks; bottoms of the upper and the lower tanks."""

CORNERS: tuple[Point, ...] = ((LEFT_X, LOWER_Y), (RIGHT_X, LOWER_Y), (LEFT_X, UPPER_Y), (RIGHT_X, UPPER_Y))
"""Lower left corner of each tank."""

CENTERS_X = tuple(x + 0.5 * WIDTH for x, _ in CORNERS)
PIPE_X = (7.0, 57.0)
PUMPS: tuple[Point, ...] = ((PIPE_X[0], 52.0), (PIPE_X[1], 52.0))
VALVE_Y, RESERVOIR_Y, RESERVOIR_BOTTOM = 24.5, 57.0, 61.0
VALVES: tuple[Point, ...] = ((PIPE_X[0], VALVE_Y), (PIPE_X[1], VALVE_Y))
BOUNDS_X, BOUNDS_Y = (-10.0, 74.0), (-13.5, 66.0)
BACKGROUND = (13, 17, 23)

FLOWS: tuple[tuple[str, Strip, int], ...] = (
    ("pump 1", ((7.0, 59.0), (7.0, VALVE_Y)), BLUE),
    ("pump 2", ((57.0, 59.0), (57.0, VALVE_Y)), ORANGE),
    ("pump 1 to tank 1", ((7.0, VALVE_Y), (16.5, VALVE_Y), (16.5, 29.0)), BLUE),
    ("pump 2 to tank 2", ((57.0, VALVE_Y), (47.5, VALVE_Y), (47.5, 29.0)), ORANGE),
    ("pump 2 to tank 3", ((57.0, VALVE_Y), (57.0, -3.0), (19.0, -3.0), (19.0, 1.5)), ORANGE),
    ("pump 1 to tank 4", ((7.0, VALVE_Y), (7.0, -7.0), (45.0, -7.0), (45.0, 1.5)), BLUE),
    ("out of tank 1", ((CENTERS_X[0], LOWER_Y), (CENTERS_X[0], RESERVOIR_Y)), WATER_LINE),
    ("out of tank 2", ((CENTERS_X[1], LOWER_Y), (CENTERS_X[1], RESERVOIR_Y)), WATER_LINE),
    ("tank 3 to tank 1", ((CENTERS_X[2], UPPER_Y), (CENTERS_X[2], LOWER_Y - 16.0)), WATER_LINE),
    ("tank 4 to tank 2", ((CENTERS_X[3], UPPER_Y), (CENTERS_X[3], LOWER_Y - 16.0)), WATER_LINE),
)
"""What flows, where it is drawn, and its colour, in the order of the recorded widths."""

LEGEND = "white line: reference    grey ball: sensor reading    width of a pipe: flow    magenta: diagnosed"

RADIUS_PER_FLOW = 0.05
"""Half the width of a flow, for each cm^3/s: 10 cm^3/s, a usual one, is a unit wide."""


def scale_of(model: PictureModel) -> float:
    """Units of the picture for each cm of level."""
    return TALLEST / max(model.tanks.height_cm)


def log_layout(recording: rr.RecordingStream, model: PictureModel) -> None:
    """Log tanks, pipes, pumps, valves, the reservoir and the looks of what moves."""
    scale = scale_of(model)
    walls = [_walls(corner, scale * height) for corner, height in zip(CORNERS, model.tanks.height_cm, strict=True)]
    reservoir = [
        ((2.0, RESERVOIR_Y - 1.0), (2.0, RESERVOIR_BOTTOM), (62.0, RESERVOIR_BOTTOM), (62.0, RESERVOIR_Y - 1.0))
    ]
    _strips(recording, "walls", [*walls, *reservoir], [WALL], 0.2, order=30.0)
    _strips(recording, "pipes", [strip for _, strip, _ in FLOWS], [PIPE], 0.15, order=10.0)
    _strips(recording, "flows", [strip for _, strip, _ in FLOWS], [color for _, _, color in FLOWS], None, order=20.0)
    _strips(recording, "surface", [((2.2, RESERVOIR_Y), (61.8, RESERVOIR_Y))], [WATER_LINE], 0.12, order=19.0)
    water = np.empty((int(TALLEST), int(WIDTH), 4), dtype=np.uint8)
    water[:] = WATER
    for tank in range(4):
        recording.log(f"{ROOM}/water/tank{tank + 1}", rr.Image(water, draw_order=-10.0), static=True)
    rims = [(x + WIDTH + 3.4, y - 1.2 - scale * h) for (x, y), h in zip(CORNERS, model.tanks.height_cm, strict=True)]
    _labels(recording, "text/rims", rims, GREY, [f"rim {height:g} cm" for height in model.tanks.height_cm])
    if model.level_max_cm is not None:
        trips = [mark for corner in CORNERS for mark in _ticks(corner, scale * model.level_max_cm)]
        _strips(recording, "trip_level", trips, [AMBER], 0.15, order=33.0)
        below = [(x - 2.6, y - 1.2 - scale * model.level_max_cm) for x, y in CORNERS]
        _labels(recording, "text/trip_level", below, AMBER, ["trip"] * 4)
    _points(recording, "pumps", PUMPS, [BLUE, ORANGE], 2.6)
    _points(recording, "valves", VALVES, [WALL], 1.0)
    _labels(recording, "text/reservoir", [(32.0, 59.0)], GREY, ["reservoir"])
    _labels(recording, "text/legend", [(32.0, 62.5)], GREY, [LEGEND])
    _labels(recording, "text/tanks", [(x, y - 3.4) for x, (_, y) in zip(CENTERS_X, CORNERS, strict=True)], WHITE)
    _labels(recording, "text/pumps", _lines(((-2.5, 46.0), (66.5, 46.0)), 4), WHITE)
    _labels(recording, "text/valves", _lines(((-1.0, 21.0), (65.0, 21.0)), 3), GREY)
    _labels(recording, "text/mode", [(32.0, -10.2)], WHITE)
    _points(recording, "measured", None, [GREY], 0.6)
    _strips(recording, "references", None, [WHITE], 0.15, order=35.0)
    _strips(recording, "requested", None, [GREY], 0.1, order=34.0)
    _labels(recording, "text/references", None, WHITE)
    _strips(recording, "faults/marks", None, [MAGENTA], 0.25, order=40.0)
    _labels(recording, "faults/text", None, MAGENTA)


def _ticks(corner: Point, height: float) -> tuple[Strip, Strip]:
    """Two short marks at the walls of a tank."""
    x, y = corner
    return ((x, y - height), (x + 1.5, y - height)), ((x + WIDTH - 1.5, y - height), (x + WIDTH, y - height))


def _lines(tops: tuple[Point, ...], count: int) -> list[Point]:
    """Places of so many lines of text below each of the tops."""
    return [(x, y + 2.5 * line) for x, y in tops for line in range(count)]


def _walls(corner: Point, height: float) -> Strip:
    x, y = corner
    return (x, y - height), (x, y), (x + WIDTH, y), (x + WIDTH, y - height)


def _strips(
    recording: rr.RecordingStream,
    name: str,
    strips: list[Strip] | None,
    colors: list[int],
    radius: float | None,
    *,
    order: float,
) -> None:
    look = rr.LineStrips2D.from_fields(
        strips=strips, colors=np.array(colors, dtype=np.uint32), radii=radius, draw_order=order
    )
    recording.log(f"{ROOM}/{name}", look, static=True)


def _points(
    recording: rr.RecordingStream, name: str, at: tuple[Point, ...] | None, colors: list[int], radius: float
) -> None:
    look = rr.Points2D.from_fields(
        positions=at, colors=np.array(colors, dtype=np.uint32), radii=radius, draw_order=32.0
    )
    recording.log(f"{ROOM}/{name}", look, static=True)


def _labels(
    recording: rr.RecordingStream, name: str, at: list[Point] | None, color: int, texts: list[str] | None = None
) -> None:
    look = rr.Points2D.from_fields(
        positions=at,
        colors=np.array([color], dtype=np.uint32),
        radii=0.0,
        labels=texts,
        show_labels=True,
        draw_order=50.0,
    )
    recording.log(f"{ROOM}/{name}", look, static=True)
