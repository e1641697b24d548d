"""The references of a run over time: steps, ramps and trajectories, with the start phase that leads to the first."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

from hil.core.start_phase import StartPhase
from hil.core.types import Pair

TIME_TOLERANCE_S = 1e-6
"""Tolerance for comparing times, against rounding of floats."""


@dataclass(frozen=True, slots=True)
class ReferenceMove:
    """References that move linearly from point to point. times_s : run times, ascending. values_V : (2,) at each."""

    times_s: tuple[float, ...]
    values_V: tuple[Pair, ...]

    @property
    def end_s(self) -> float:
        """When the last point is reached."""
        return self.times_s[-1]

    def at(self, t_s: float) -> Pair:
        """(2,) at run time t_s; after the last point, that point."""
        after = bisect_right(self.times_s, t_s)
        if after == len(self.times_s) or after == 0:
            return self.values_V[max(after - 1, 0)]
        (a1, a2), (b1, b2) = self.values_V[after - 1], self.values_V[after]
        share = (t_s - self.times_s[after - 1]) / (self.times_s[after] - self.times_s[after - 1])
        return a1 + share * (b1 - a1), a2 + share * (b2 - a2)

    def rate(self, t_s: float) -> Pair:
        """(2,) V/s from run time t_s on."""
        after = bisect_right(self.times_s, t_s + TIME_TOLERANCE_S)
        if after == len(self.times_s) or after == 0:
            return 0.0, 0.0
        (a1, a2), (b1, b2) = self.values_V[after - 1], self.values_V[after]
        time_s = self.times_s[after] - self.times_s[after - 1]
        return (b1 - a1) / time_s, (b2 - a2) / time_s


@dataclass(frozen=True, slots=True)
class RunReferences:
    """schedule : (at_s, (r1, r2) in V), ascending in time, the first at 0. start : the run's start phase, or None.

    moves : by the number of an entry in the schedule, how the references get to its values; without one by a step.
    """

    schedule: tuple[tuple[float, Pair], ...]
    start: StartPhase | None = None
    moves: tuple[tuple[int, ReferenceMove], ...] = ()

    def entry(self, t_s: float) -> int:
        """The entry of the schedule in force at run time t_s; before time 0 the first one."""
        for number in range(len(self.schedule) - 1, 0, -1):
            if self.schedule[number][0] <= t_s + TIME_TOLERANCE_S:
                return number
        return 0

    def requested(self, t_s: float) -> Pair:
        """(2,) outputs requested at run time t_s, V; before time 0 the first ones."""
        number = self.entry(t_s)
        move = self.move(number)
        return self.schedule[number][1] if move is None else move.at(t_s)

    def move(self, number: int) -> ReferenceMove | None:
        """How the references get to an entry's values; None: by a step."""
        if not self.moves:
            return None
        return next((move for index, move in self.moves if index == number), None)

    def at(self, t_s: float) -> Pair:
        """(2,) outputs to aim at, at run time t_s, V; in a start phase on the way to the first ones."""
        requested = self.requested(t_s)
        return requested if self.start is None else self.start.toward(t_s, requested)

    def rate(self, t_s: float) -> Pair:
        """(2,) rates at which the outputs requested move from t_s on, V/s; 0 at a step."""
        if not self.moves:
            return 0.0, 0.0
        move = self.move(self.entry(t_s))
        return (0.0, 0.0) if move is None else move.rate(t_s)
