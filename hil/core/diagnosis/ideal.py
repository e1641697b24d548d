"""Two detectors to compare a real one with.

`IdealDetector` knows the scenario's pump faults and reports each after a fixed delay: the assumption of Hajiani and
Poshtan (2012), section 4. `NoDetector` never reports anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hil.core.estimator import Estimate
from hil.core.types import Alarm, Diagnosis, Measurement, Pair

TIME_TOLERANCE_S = 1e-6
"""Rounding: a fault at a step's own time counts for that step."""


class NoDetector:
    """Treats every pump as healthy."""

    def start(self) -> Any:
        """Nothing to remember."""
        return None

    def step(
        self,
        memory: Any,
        t_s: float,
        measurement: Measurement,
        estimate: Estimate,
        applied_V: Pair,
    ) -> tuple[Any, Diagnosis]:
        """Nothing found."""
        return memory, Diagnosis()


@dataclass(frozen=True, slots=True)
class PumpFault:
    """From at_s of the run until until_s, pump `target` (1 or 2) moves only `effectiveness` of its flow."""

    at_s: float
    target: int
    effectiveness: float
    until_s: float = float("inf")


@dataclass(frozen=True)
class IdealDetector:
    """Knows the faults to come and reports each, exactly, delay_s after it has happened (or has gone).

    Of two faults of one pump the one that began later holds; when it ends, the earlier one holds again.
    """

    faults: tuple[PumpFault, ...]
    delay_s: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "faults", tuple(sorted(self.faults, key=lambda fault: fault.at_s)))

    def start(self) -> Any:
        """The effectiveness reported last."""
        return (1.0, 1.0)

    def step(
        self,
        memory: Any,
        t_s: float,
        measurement: Measurement,
        estimate: Estimate,
        applied_V: Pair,
    ) -> tuple[Any, Diagnosis]:
        """The faults that were present delay_s ago; an alarm for every pump whose effectiveness has changed."""
        then = t_s - self.delay_s + TIME_TOLERANCE_S
        reported = [1.0, 1.0]
        for fault in self.faults:
            if fault.at_s <= then < fault.until_s:
                reported[fault.target - 1] = fault.effectiveness
        effectiveness = (reported[0], reported[1])
        alarms = tuple(
            Alarm(
                detected_s=t_s,
                kind="pump_effectiveness",
                target=pump + 1,
                size=effectiveness[pump],
                size_std=0.0,
                onset_s=t_s - self.delay_s,
                isolated_s=t_s,
                candidates=(f"pump_effectiveness {pump + 1}",),
                number=pump + 1,
                is_recovery=effectiveness[pump] == 1.0,
            )
            for pump in (0, 1)
            if effectiveness[pump] != memory[pump]
        )
        return effectiveness, Diagnosis(effectiveness=effectiveness, new_alarms=alarms)
