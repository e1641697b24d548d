"""The tanks as a picture that follows the time cursor: levels, references, pumps, flows, and what is diagnosed.

It is made of the recorded steps, five times a second of run time, in the thread or process of the recorder. What has
not changed to the eye since the last picture is not recorded again. Levels and flows are the estimated ones; the flows
follow from them by eq. (1), with the faults as diagnosed.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import rerun as rr

from hil.core.types import Mode
from hil.edge.record.picture_faults import PresentFaults
from hil.edge.record.picture_layout import (
    CORNERS,
    FLOWS,
    RADIUS_PER_FLOW,
    ROOM,
    TALLEST,
    WIDTH,
    Floats,
    log_layout,
    scale_of,
)
from hil.edge.record.picture_model import PictureModel

PERIOD_S = 0.2
BATCH_S = 100.0
"""Pictures of so much run time are sent together, because each chunk costs about 1.1 kB of file."""

LEVEL_STEP, RADIUS_STEP = 0.02, 0.01
"""Changes below these, in units of the picture, are not recorded."""


class TankPicture:
    """The picture of one run; see `hil.edge.record.rerun_log`. columns : those of the rows that it is given.

    slower : a long run is drawn so many times less often.
    """

    def __init__(self, model: PictureModel, columns: Sequence[str], slower: int = 1) -> None:
        self._model, self._scale = model, scale_of(model)
        self._period, self._batch_s = Thinning(PERIOD_S * slower), BATCH_S * slower
        self._rows: list[Floats] = []
        self._faults: list[tuple[float, PresentFaults]] = [(-np.inf, PresentFaults())]
        self._new_faults: list[tuple[float, PresentFaults]] = []
        self._last: dict[str, npt.NDArray[Any]] = {}
        at = {name: place for place, name in enumerate(columns)}
        self._mode = at["mode"]
        self._estimated, self._measured = ([at[f"h{i}{what}_V"] for i in (1, 2, 3, 4)] for what in ("_est", ""))
        self._requested, self._target = [at["r1_V"], at["r2_V"]], [at["target1_V"], at["target2_V"]]
        self._command, self._applied = [at["v1_V"], at["v2_V"]], [at["v1_applied_V"], at["v2_applied_V"]]
        self._effectiveness = [at["theta1"], at["theta2"]]

    def log_static(self, recording: rr.RecordingStream) -> None:
        """Log what never changes."""
        log_layout(recording, self._model)

    def note_alarm(self, t_s: float, data: Mapping[str, Any]) -> None:
        """Take the data of an alarm."""
        faults = self._faults[-1][1].with_alarm(data)
        for changes in (self._faults, self._new_faults):
            if changes and changes[-1][0] == t_s:
                changes.pop()
            changes.append((t_s, faults))

    def add(self, table: Floats) -> None:
        """Take rows of the record, (n, columns)."""
        if len(kept := table[self._period.kept(table[:, 0])]):
            self._rows.append(kept)

    @property
    def is_due(self) -> bool:
        """Whether there is enough to be sent."""
        return bool(self._rows) and self._rows[-1][-1, 0] - self._rows[0][0, 0] >= self._batch_s

    def send(self, recording: rr.RecordingStream) -> None:
        """Send what was taken."""
        if self._rows:
            rows = np.concatenate(self._rows)
            self._rows.clear()
            _Sender(recording, rows[:, 0], self._last).send(self._columns(rows))
            del self._faults[:-1]
        for t_s, faults in self._new_faults:
            _send_faults(recording, t_s, faults)
        self._new_faults.clear()

    def _columns(self, rows: Floats) -> dict[str, tuple[npt.NDArray[Any], float]]:
        """By entity: what is drawn, one row a picture, and the smallest change that is recorded."""
        gain = self._model.tanks.level_gain_V_cm
        level_cm = np.nan_to_num(rows[:, self._estimated] / gain)
        heights = self._scale * np.clip(level_cm, 0.0, 1.1 * np.array(self._model.tanks.height_cm))
        flow = self.flows_cm3_s(rows[:, 0], level_cm, rows[:, self._applied], rows[:, self._effectiveness])
        found: dict[str, tuple[npt.NDArray[Any], float]] = {
            f"water/tank{tank + 1}": (np.maximum(heights[:, tank], 1e-3)[:, None], LEVEL_STEP) for tank in range(4)
        }
        found["flows"] = (np.maximum(RADIUS_PER_FLOW * flow, 1e-3), RADIUS_STEP)
        found["measured"] = (self._scale * np.nan_to_num(rows[:, self._measured] / gain), 2.0 * LEVEL_STEP)
        found["references"] = (self._scale * np.nan_to_num(rows[:, self._target] / gain), LEVEL_STEP)
        found["requested"] = (self._scale * np.nan_to_num(rows[:, self._requested] / gain), LEVEL_STEP)
        found["text/tanks"] = (np.round(level_cm, 1), 0.05)
        pumps = np.hstack([rows[:, self._command], rows[:, self._applied], rows[:, self._effectiveness]])
        found["text/pumps"] = (np.round(np.nan_to_num(pumps), 2), 0.02)
        found["text/mode"] = (rows[:, [self._mode]], 0.5)
        split = np.array([self._faults_at(t_s).splits(self._model.tanks) for t_s in rows[:, 0]])
        found["text/valves"] = (np.round(split, 2), 0.005)
        return found

    def flows_cm3_s(self, times_s: Floats, level_cm: Floats, applied_V: Floats, effectiveness: Floats) -> Floats:
        """(n, 10) cm^3/s: the flows of `FLOWS`, by eq. (1) with what is diagnosed at each time."""
        tanks = self._model.tanks
        drive = np.nan_to_num(applied_V)
        if not self._model.pumps.is_straight:
            drive = np.array([self._model.pumps.drive((v1, v2)) for v1, v2 in drive.tolist()])
        pumped = np.array(tanks.pump_gain_cm3_Vs) * np.nan_to_num(effectiveness, nan=1.0) * drive
        faults = [self._faults_at(t_s) for t_s in times_s.tolist()]
        split = np.array([one.splits(tanks) for one in faults])
        open_share = 1.0 - np.array([one.shares("outlet_block") for one in faults])
        head = np.maximum(level_cm + np.array(tanks.datum_cm), 0.0) * (level_cm > 0.0)
        out = np.array(tanks.outlet_cm2) * open_share * np.sqrt(2.0 * tanks.gravity_cm_s2 * head)
        lower, upper = split * pumped, (1.0 - split) * pumped
        return np.column_stack([pumped, lower, upper[:, ::-1], out])

    def _faults_at(self, t_s: float) -> PresentFaults:
        return self._faults[bisect_right(self._faults, t_s, key=lambda change: change[0]) - 1][1]


class Thinning:
    """Keeps the first row of every period of run time."""

    def __init__(self, period_s: float) -> None:
        self._period_s, self._last = period_s, -np.inf

    def kept(self, times_s: Floats) -> npt.NDArray[np.bool_]:
        """Which of the rows at these times, (n,), to keep."""
        number = np.floor(times_s / self._period_s + 1e-6)
        found: npt.NDArray[np.bool_] = np.asarray(np.diff(number, prepend=self._last) != 0.0)
        self._last = float(number[-1])
        return found


class _Sender:
    """Sends the columns of one batch. last : by entity, what was sent last; it is kept up to date."""

    def __init__(self, recording: rr.RecordingStream, times_s: Floats, last: dict[str, npt.NDArray[Any]]) -> None:
        self._recording, self._times_s, self._last = recording, times_s, last

    def send(self, columns: Mapping[str, tuple[npt.NDArray[Any], float]]) -> None:
        for name, (values, smallest) in columns.items():
            places = self._changed(name, values, smallest)
            if places:
                times = rr.TimeColumn(
                    "run_time", duration=np.round(self._times_s[places] * 1e9).astype("timedelta64[ns]")
                )
                for entity, batch in _drawn(name, values[places]).items():
                    self._recording.send_columns(f"{ROOM}/{entity}", [times], batch)

    def _changed(self, name: str, values: npt.NDArray[Any], smallest: float) -> list[int]:
        """Places of the rows that differ from the one sent before."""
        found: list[int] = []
        last = self._last.get(name)
        for place, row in enumerate(values):
            if last is None or np.abs(row - last).max() >= smallest:
                found.append(place)
                last = row
        if last is not None:
            self._last[name] = last
        return found


def _drawn(name: str, values: npt.NDArray[Any]) -> dict[str, Any]:
    """The columns of an entity, and of those that go with it, for values as `TankPicture._columns` has them."""
    n = len(values)
    if name.startswith("water/"):
        x, y = CORNERS[int(name[-1]) - 1]
        height = values[:, 0]
        place = np.column_stack([np.full(n, x), y - height, np.zeros(n)])
        scale = np.column_stack([np.ones(n), height / TALLEST, np.ones(n)])
        return {name: rr.Transform3D.columns(translation=place, scale=scale)}
    if name == "flows":
        return {name: rr.LineStrips2D.columns(radii=values.ravel()).partition([len(FLOWS)] * n)}
    if name == "measured":
        sensors_x = np.array([corner[0] + WIDTH - 1.2 for corner in CORNERS])
        shown_y = np.array([corner[1] for corner in CORNERS]) - values
        at = np.stack([np.broadcast_to(sensors_x, shown_y.shape), shown_y], axis=-1).reshape(-1, 2)
        return {name: rr.Points2D.columns(positions=at).partition([4] * n)}
    if name in ("references", "requested"):
        return _lines(name, values)
    texts = [text for row in values.tolist() for text in _TEXTS[name](row)]
    return {name: rr.Points2D.columns(labels=texts).partition([len(texts) // n] * n)}


def _lines(name: str, values: Floats) -> dict[str, Any]:
    """A line across each lower tank, (n, 2) units above its bottom."""
    over = 0.8
    strips = [
        ((x - over, y - height), (x + WIDTH + over, y - height))
        for row in values.tolist()
        for (x, y), height in zip(CORNERS[:2], row, strict=True)
    ]
    return {name: rr.LineStrips2D.columns(strips=strips).partition([2] * len(values))}


def _pump_texts(row: Sequence[float]) -> list[str]:
    """Four lines a pump."""
    return [
        text
        for j, (command, applied, gain) in enumerate(zip(row[:2], row[2:4], row[4:], strict=True))
        for text in (
            f"pump {j + 1}",
            f"command {command:.2f} V",
            f"applied {applied:.2f} V",
            f"gain {100.0 * gain:.0f} %",
        )
    ]


def _valve_texts(row: Sequence[float]) -> list[str]:
    """Three lines a valve."""
    return [
        text
        for j, split in enumerate(row)
        for text in (
            f"valve {j + 1}",
            f"{100.0 * split:.0f} % to tank {j + 1}",
            f"{100.0 * (1.0 - split):.0f} % to tank {4 - j}",
        )
    ]


_TEXTS: Mapping[str, Callable[[Sequence[float]], list[str]]] = {
    "text/tanks": lambda row: [f"tank {i + 1}: {level:.1f} cm" for i, level in enumerate(row)],
    "text/pumps": _pump_texts,
    "text/mode": lambda row: [Mode(int(row[0])).name],
    "text/valves": _valve_texts,
}


def _send_faults(recording: rr.RecordingStream, t_s: float, faults: PresentFaults) -> None:
    marks = faults.marks()
    strips = [mark.strip for mark in marks if mark.strip]
    times = rr.TimeColumn("run_time", duration=np.array([round(t_s * 1e9)], dtype="timedelta64[ns]"))
    drawn = rr.LineStrips2D.columns(strips=strips).partition([len(strips)])
    recording.send_columns(f"{ROOM}/faults/marks", [times], drawn)
    at = np.array([mark.at for mark in marks], dtype=np.float64).reshape(-1, 2)
    texts = rr.Points2D.columns(positions=at, labels=[mark.text for mark in marks]).partition([len(marks)])
    recording.send_columns(f"{ROOM}/faults/text", [times], texts)
