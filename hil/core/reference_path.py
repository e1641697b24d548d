"""The references of a run over time, with the start phase that leads to the first of them."""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.start_phase import StartPhase
from hil.core.types import Pair

TIME_TOLERANCE_S = 1e-6
"""Tolerance for comparing times, against rounding of floats."""


@dataclass(frozen=True, slots=True)
class RunReferences:
    """schedule : (at_s, (r1, r2) in V), ascending in time, the first at 0. start : the run's start phase, or None."""

    schedule: tuple[tuple[float, Pair], ...]
    start: StartPhase | None = None

    def requested(self, t_s: float) -> Pair:
        """(2,) outputs requested at run time t_s, V; before time 0 the first ones."""
        past = (values for at_s, values in reversed(self.schedule) if at_s <= t_s + TIME_TOLERANCE_S)
        return next(past, self.schedule[0][1])

    def at(self, t_s: float) -> Pair:
        """(2,) outputs to aim at, at run time t_s, V; in a start phase on the way to the first ones."""
        requested = self.requested(t_s)
        return requested if self.start is None else self.start.toward(t_s, requested)

    def rate(self, t_s: float) -> Pair:  # noqa: ARG002 - so far every change is a step
        """(2,) rates at which the outputs to aim at move from t_s on, V/s; 0 at a step."""
        return 0.0, 0.0
