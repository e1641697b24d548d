"""Which fault, since when, how large.

A `FaultDetector` turns each step's numbers into a verdict. Two are here for comparison with a real one:
`IdealDetector` has the scenario's own faults reported to it after a delay (the paper's assumption, section 4),
`NoDetector` never says anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from hil.core.estimator import Estimate
from hil.core.types import Alarm, Diagnosis, Measurement, Pair

TIME_TOLERANCE_S = 1e-6
"""A fault due at a step's own time is due, however the float of it came out."""


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


class NoDetector:
    """Takes every pump for sound."""

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
        """The faults that stood delay_s ago; an alarm for every pump whose effectiveness is reported anew."""
        then = t_s - self.delay_s + TIME_TOLERANCE_S
        reported = [1.0, 1.0]
        for fault in self.faults:
            if fault.at_s <= then < fault.until_s:
                reported[fault.target - 1] = fault.effectiveness
        effectiveness = (reported[0], reported[1])
        alarms = tuple(
            Alarm(
                t_s,
                "pump_effectiveness",
                pump + 1,
                effectiveness[pump],
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
        return effectiveness, Diagnosis(effectiveness, alarms)
