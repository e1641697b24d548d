"""What the diagnosis says with its uncertainty, for the recording: a value with a band of one standard deviation.

diagnosis/levels/tank1     level signal as estimated, and its standard deviation
diagnosis/effectiveness/pump1    effectiveness in force, and that of the last alarm about this pump
diagnosis/sizes/leak_3     size of a fault, at each report of it
diagnosis/candidates       what an alarm that is not isolated may be
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import numpy as np
import rerun as rr

from hil.core.types import NAMELESS
from hil.edge.record.picture_layout import Floats
from hil.edge.record.run_states import NO_STATE
from hil.edge.record.tank_picture import Thinning

ROOM = "diagnosis"
PERIOD_S, BATCH_S = 1.0, 100.0
"""Of the bands in run time, and how much of them is sent together."""

EFFECTIVENESS = "pump_effectiveness"


class DiagnosisBands:
    """The bands of one run. columns : those of the rows that it is given. slower : drawn so many times less often."""

    def __init__(self, columns: Sequence[str], slower: int = 1) -> None:
        at = {name: place for place, name in enumerate(columns)}
        self._level = [(at[f"h{i}_est_V"], at[f"h{i}_std_V"]) for i in (1, 2, 3, 4)]
        self._effectiveness = [at["theta1"], at["theta2"]]
        self._deviation: list[list[tuple[float, float]]] = [[(-np.inf, 0.0)], [(-np.inf, 0.0)]]
        self._sizes: list[tuple[float, str, float, float]] = []
        self._present: dict[str, tuple[float, float]] = {}
        self._thinning, self._batch_s = Thinning(PERIOD_S * slower), BATCH_S * slower
        self._rows: list[Floats] = []

    def note_alarm(self, t_s: float, data: Mapping[str, Any]) -> str:
        """Take the data of an alarm; the candidates that it leaves open, as a state."""
        kind, target, deviation = str(data.get("kind")), data.get("target"), _number(data.get("size_std"))
        size = _number(data.get("size"))
        is_over = bool(data.get("is_recovery"))
        if kind in NAMELESS and not is_over:
            return " or ".join(map(str, data.get("candidates") or ())) or kind
        if kind == EFFECTIVENESS and target in (1, 2):
            self._deviation[target - 1].append((t_s, 0.0 if is_over or deviation is None else deviation))
        name = f"{kind}_{target}"
        if is_over:
            self._present.pop(name, None)
        elif size is not None:
            self._present[name] = size, deviation or 0.0
            self._sizes.append((t_s, name, size, deviation or 0.0))
        return NO_STATE

    def add(self, table: Floats) -> None:
        """Take rows of the record, (n, columns)."""
        if len(kept := table[self._thinning.kept(table[:, 0])]):
            self._rows.append(kept)

    @property
    def is_due(self) -> bool:
        """Whether there is enough to be sent."""
        return bool(self._rows) and self._rows[-1][-1, 0] - self._rows[0][0, 0] >= self._batch_s

    def send(self, recording: rr.RecordingStream) -> None:
        """Send the bands of what was taken, and the sizes that were reported."""
        if not self._rows:
            return
        table = np.concatenate(self._rows)
        self._rows.clear()
        times = _times(table[:, 0])
        for tank, (level, deviation) in enumerate(self._level, start=1):
            if np.isfinite(table[:, deviation]).any():
                _send(recording, f"levels/tank{tank}", times, table[:, level], table[:, deviation] ** 2)
        for pump, place in enumerate(self._effectiveness):
            starts, values = zip(*self._deviation[pump], strict=True)
            in_force: Floats = np.array(values)[np.searchsorted(starts, table[:, 0], side="right") - 1]
            _send(recording, f"effectiveness/pump{pump + 1}", times, table[:, place], in_force**2)
            del self._deviation[pump][:-1]
        held = [(float(table[-1, 0]), name, *found) for name, found in self._present.items()]
        for t_s, name, size, size_std in (*self._sizes, *held):
            _send(recording, f"sizes/{name}", _times(np.array([t_s])), np.array([size]), np.array([size_std**2]))
        self._sizes.clear()


def _send(recording: rr.RecordingStream, name: str, times: rr.TimeColumn, values: Floats, variances: Floats) -> None:
    drawn = rr.Measurements.columns(values=np.ascontiguousarray(values), variances=np.ascontiguousarray(variances))
    recording.send_columns(f"{ROOM}/{name}", [times], drawn)


def _times(times_s: Floats) -> rr.TimeColumn:
    return rr.TimeColumn("run_time", duration=np.round(times_s * 1e9).astype("timedelta64[ns]"))


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and isfinite(value) else None
