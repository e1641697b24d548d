"""The protocol that a fault detector follows: which fault, since when, how large."""

from __future__ import annotations

from typing import Any, Protocol

from hil.core.estimator import Estimate
from hil.core.types import Diagnosis, Measurement, Pair


class FaultDetector(Protocol):
    """What the controller needs of a diagnosis. Users plug in their own; state travels through `memory`."""

    def start(self) -> Any:
        """Memory to begin with."""
        ...

    def step(
        self, memory: Any, t_s: float, measurement: Measurement, estimate: Estimate, applied_V: Pair
    ) -> tuple[Any, Diagnosis]:
        """Verdict at run time t_s."""
        ...
