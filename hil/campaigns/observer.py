"""Observation of a run without a record: takes the recorder's place in the loop and keeps everything in memory.

A step costs one tuple. The emulator's outputs are watched at each of their changes, levels at each step; the water that
went over a rim is counted by the tanks themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import nan
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from hil.core.types import Event, Mode, NodeState, Pair, Quad, TickRecord

Floats = npt.NDArray[np.float64]

NODE_LATCH_S = 0.25
"""A pump node without commands is at 0 V after this time; after a trip of the controller it must be so, too."""

CLEARED = "cleared"
"""Cause of a node's change when its trip was cleared by a request."""

VOLT_TOLERANCE_V = 0.006
"""What converters of 12 bit and the wire's steps may add to a change of voltage, both ends together."""

DRY_S = 2.0
"""For how long a pump may be driven while no pump gives water."""

DRY_SHARE, DRY_V = 0.05, 0.5
"""A pump with a smaller share of its flow gives no water; with a smaller voltage it hardly turns."""

COLUMNS = (
    *("t_s", "r1_V", "r2_V", "h1_cm", "h2_cm", "h3_cm", "h4_cm", "v1_V", "v2_V", "accepted"),
    *("e1", "e2", "true_e1", "true_e2"),
)


class PumpTruth(Protocol):
    """What the emulator's pump node knows of itself."""

    applied_V: Pair
    accepted: int


class PumpChange(Protocol):
    """A change of a node's state or outputs, as the emulator reports it."""

    @property
    def t_ns(self) -> int:
        """When, on the emulator's clock."""
        ...

    @property
    def node(self) -> str:
        """Which node: pump or level."""
        ...

    @property
    def state(self) -> int:
        """State that it is in now."""
        ...

    @property
    def applied_V(self) -> tuple[float, ...]:  # noqa: N802 - V is the unit
        """Its outputs."""
        ...

    @property
    def cause(self) -> str:
        """Why it changed."""
        ...


@dataclass(frozen=True, eq=False)
class Observations:
    """What was observed of a run.

    steps : (n, len(COLUMNS)), a row a step, references and effectiveness e1, e2 as the controller has them, all else as
    it truly is; true_e1, true_e2 are nan where nobody knows them. events : with their run time. range_broken,
    latch_broken : what went out of range, or moved again after a trip, in words; empty when nothing did.
    """

    steps: Floats
    events: tuple[tuple[float, Event], ...]
    range_broken: str
    latch_broken: str

    def column(self, name: str) -> Floats:
        """(n,) values of one column."""
        return self.steps[:, COLUMNS.index(name)]


@dataclass
class Observer:
    """Has the recorder's methods for the loop, and `on_change` for the emulator's pump node. One run, then `result`.

    effectiveness : tells the true share of its flow that each pump gives.
    """

    range_V: Pair
    pump: PumpTruth | None = None
    effectiveness: Callable[[], Sequence[float]] = lambda: (nan, nan)
    _rows: list[tuple[float, ...]] = field(default_factory=list)
    _events: list[tuple[float, Event]] = field(default_factory=list)
    _tripped_ns: int | None = None
    _controller_tripped_s: float | None = None
    _range_broken: str = ""
    _latch_broken: str = ""

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None) -> None:
        """Take one step."""
        if true_level_cm is None or self.pump is None:
            raise ValueError("a campaign needs the emulator's truth")
        pump, t_s = self.pump, record.t_s
        known, true = record.effectiveness, self.effectiveness()
        self._rows.append((t_s, *record.reference_V, *true_level_cm, *pump.applied_V, pump.accepted, *known, *true))
        if record.events:
            self._events += [(t_s, event) for event in record.events]
        if record.mode is Mode.TRIPPED:
            self._watch_trip(t_s, pump.applied_V)
        elif self._controller_tripped_s is not None:
            self._controller_tripped_s = None

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        """Frames are not kept."""

    def message(self, timestamp_s: float, message: Any) -> None:
        """Frames of other kinds are not kept either."""

    def event(self, t_s: float, event: Event) -> None:
        """Take one event outside of a recorded step."""
        self._events.append((t_s, event))

    def on_change(self, change: PumpChange) -> None:
        """Check a change of the pump node's outputs."""
        if change.node != "pump":
            return
        v1, v2 = change.applied_V
        high_V = self.range_V[1]
        if not (0.0 <= v1 <= high_V and 0.0 <= v2 <= high_V):
            self._range_broken = self._range_broken or f"{v1:g}, {v2:g} V at {change.t_ns * 1e-9:.3f} s"
        if change.cause == CLEARED:
            self._tripped_ns = None
        if change.state == NodeState.TRIPPED:
            self._tripped_ns = self._tripped_ns or change.t_ns
        if self._tripped_ns is not None and (v1 or v2):
            self._latch_broken = self._latch_broken or f"the node moved again at {change.t_ns * 1e-9:.3f} s"

    def result(self) -> Observations:
        """All observations."""
        steps = np.array(self._rows, dtype=np.float64).reshape(-1, len(COLUMNS))
        return Observations(steps, tuple(self._events), self._range_broken, self._latch_broken)

    def _watch_trip(self, t_s: float, applied_V: Pair) -> None:
        if self._controller_tripped_s is None:
            self._controller_tripped_s = t_s
        is_late = t_s > self._controller_tripped_s + NODE_LATCH_S
        if is_late and applied_V != (0.0, 0.0):
            self._latch_broken = self._latch_broken or f"{applied_V} V at {t_s:.1f} s, after the controller's trip"


def rate_broken(seen: Observations, rate_V_s: float, period_s: float) -> str:
    """The first change of an output steeper than the rate allows, in words; empty when there is none.

    Between two commands that the node took, an output may change by the rate times the time between them, which is a
    control period at least. Going to 0 V at once is always allowed.
    """
    accepted, t_s = seen.column("accepted"), seen.column("t_s")
    took = np.flatnonzero(np.diff(accepted) > 0) + 1
    if len(took) < 2:
        return ""
    allowed_V = rate_V_s * np.maximum(np.diff(t_s[took]), period_s) + VOLT_TOLERANCE_V
    for name in ("v1_V", "v2_V"):
        volts = seen.column(name)[took]
        steep = (np.abs(np.diff(volts)) > allowed_V) & (volts[1:] > 0.0)
        if steep.any():
            at = int(np.argmax(steep))
            return f"{name[:2]} from {volts[at]:.3f} to {volts[at + 1]:.3f} V at {t_s[took[at + 1]]:.2f} s"
    return ""


def ran_dry(seen: Observations) -> bool:
    """Whether a pump was driven for more than `DRY_S` without a pause while neither gave water, whatever the reason."""
    t_s, volts = seen.column("t_s"), np.maximum(seen.column("v1_V"), seen.column("v2_V"))
    share = np.maximum(seen.column("true_e1"), seen.column("true_e2"))
    is_dry = (share < DRY_SHARE) & (volts > DRY_V)
    began = np.flatnonzero(is_dry & ~np.concatenate(([False], is_dry[:-1])))
    ended = np.flatnonzero(is_dry & ~np.concatenate((is_dry[1:], [False])))
    return bool((t_s[ended] - t_s[began] > DRY_S).any()) if len(began) else False
