"""The diagnosed faults in the picture of the tanks: which are present, their marks and their labels.

An alarm that names a fault has a mark where the fault acts and a label with its size. One that is not isolated yet has
a question mark at each candidate, and a line above the picture.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import cos, isfinite, pi, sin
from typing import Any

from hil.core.tanks import TankModel
from hil.core.types import NAMELESS, UNKNOWN, Pair, Quad
from hil.edge.record.picture_layout import CENTERS_X, CORNERS, PUMPS, VALVES, WIDTH, Point, Strip

NO_FAULT: Quad = (0.0, 0.0, 0.0, 0.0)
SENSORS: tuple[Point, ...] = tuple((x + WIDTH - 1.2, y - 9.5) for x, y in CORNERS)
ABOVE: Point = (32.0, -10.2)


@dataclass(frozen=True, slots=True)
class Mark:
    """A shape and a text at its place."""

    strip: Strip
    text: str
    at: Point


@dataclass(frozen=True)
class PresentFaults:
    """The faults that are diagnosed at a time, by the number of their alarm, as the data of the last alarm of each."""

    alarms: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)

    def with_alarm(self, data: Mapping[str, Any]) -> PresentFaults:
        """After one more alarm; a recovery removes its fault."""
        alarms = dict(self.alarms)
        number = int(data.get("number") or 0) or -1 - len(alarms)
        alarms.pop(number, None)
        if not data.get("is_recovery"):
            alarms[number] = data
        return replace(self, alarms=alarms)

    def shares(self, kind: str) -> Quad:
        """(4,) sizes of the faults of that kind by target; 0 where there is none."""
        found = list(NO_FAULT)
        for data in self.alarms.values():
            target = _target(data)
            if data.get("kind") == kind and 1 <= target <= 4:
                found[target - 1] = _size(data) or 0.0
        return found[0], found[1], found[2], found[3]

    def splits(self, model: TankModel) -> Pair:
        """(2,) splits of the valves, as diagnosed or as in the rig file."""
        split = list(model.valve_split)
        for data in self.alarms.values():
            target, size = _target(data), _size(data)
            if data.get("kind") == "valve_split" and target in (1, 2) and size is not None:
                split[target - 1] = size
        return split[0], split[1]

    def marks(self) -> tuple[Mark, ...]:
        """Everything to draw, the oldest fault first."""
        found: list[Mark] = []
        for data in self.alarms.values():
            if data.get("kind") not in NAMELESS:
                found.append(_named(str(data.get("kind")), _target(data), _size(data)))
                continue
            candidates = [str(name) for name in data.get("candidates") or ()]
            found += [_question(name) for name in candidates]
            begin = "unknown fault, most like" if data.get("kind") == UNKNOWN else "not isolated yet:"
            text = f"{begin} {' or '.join(name.replace('_', ' ') for name in candidates)}" if candidates else begin
            line = sum(mark.at[0] == ABOVE[0] and mark.at[1] <= ABOVE[1] for mark in found)
            found.append(Mark((), text, (ABOVE[0], ABOVE[1] - 2.4 * (line + 1))))
        return tuple(found)


def place(kind: str, target: int) -> Point:
    """Where in the picture a fault acts; above it for a target that the picture has not."""
    if kind.startswith(("pump", "reservoir")) and target in (1, 2):
        return PUMPS[target - 1]
    if kind == "valve_split" and target in (1, 2):
        return VALVES[target - 1]
    if not 1 <= target <= 4:
        return ABOVE
    x, y = CORNERS[target - 1]
    if kind.startswith("sensor"):
        return SENSORS[target - 1]
    return (CENTERS_X[target - 1], y + 1.5) if kind == "outlet_block" else (x + WIDTH, y - 1.5)


def _named(kind: str, target: int, size: float | None) -> Mark:
    x, y = place(kind, target)
    is_left = target in (1, 3)
    text = _text(kind, target, size)
    if kind == "leak":
        return Mark(((x, y), (x + 2.0, y - 0.8), (x + 2.6, y + 0.8), (x + 4.6, y + 2.6)), text, (x + 6.0, y + 4.0))
    if kind == "outlet_block":
        return Mark(_cross(x, y, 1.4), text, (x - 9.0 if is_left else x + 9.0, y + 2.0))
    if kind == "pump_dead":
        return Mark(_cross(x, y, 3.0), text, (x - 7.0 if is_left else x + 7.0, y - 5.5))
    if kind.startswith("pump"):
        return Mark(_ring(x, y, 3.6), text, (x - 7.0 if is_left else x + 7.0, y - 5.5))
    if kind == "valve_split":
        return Mark(_ring(x, y, 2.0), text, (x - 7.0 if is_left else x + 7.0, y - 3.2))
    return Mark(_ring(x, y, 1.8), text, (x, y - 3.0))


def _question(name: str) -> Mark:
    kind, _, target = name.rpartition(" ")
    x, y = place(kind, int(target) if target.isdigit() else 0)
    return Mark((), "?", (x, y - 1.0))


TEXTS = {
    "pump_effectiveness": "pump {target}: {percent} of its gain",
    "pump_dead": "pump {target}: dead",
    "pump_stuck_on": "pump {target}: stuck at {size} V",
    "pump_lag": "pump {target}: slow",
    "valve_split": "valve {target}: split {size}",
    "leak": "leak, tank {target}: {percent} of its outlet",
    "outlet_block": "outlet {target}: {percent} blocked",
    "sensor_bias": "sensor {target}: off by {size} V",
    "sensor_drift": "sensor {target}: drifts {size} V/s",
    "sensor_stuck": "sensor {target}: stuck",
    "sensor_noise": "sensor {target}: noisy",
    "sensor_open": "sensor {target}: open",
    "sensor_garbage": "sensor {target}: out of range",
}


def _text(kind: str, target: int, size: float | None) -> str:
    known = size is not None
    words = {"percent": f"{100.0 * size:.0f} %", "size": f"{size:.3g}"} if size is not None and known else {}
    form = TEXTS.get(kind, f"{kind.replace('_', ' ')} {{target}}")
    return form.format(target=target, **{"percent": "?", "size": "?", **words})


def _target(data: Mapping[str, Any]) -> int:
    target = data.get("target")
    return target if isinstance(target, int) else 0


def _size(data: Mapping[str, Any]) -> float | None:
    size = data.get("size")
    return float(size) if isinstance(size, (int, float)) and isfinite(size) else None


def _ring(x: float, y: float, radius: float) -> Strip:
    return tuple((x + radius * cos(k * pi / 8.0), y + radius * sin(k * pi / 8.0)) for k in range(17))


def _cross(x: float, y: float, half: float) -> Strip:
    return (x - half, y - half), (x + half, y + half), (x, y), (x - half, y + half), (x + half, y - half)
