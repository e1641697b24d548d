"""Two detectors to compare a real one with.

`IdealDetector` knows the scenario's pump faults and reports each after a fixed delay: the assumption of Hajiani and
Poshtan (2012), section 4. `NoDetector` never reports anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hil.core.estimator import Estimate
from hil.core.fault_course import FaultCourse
from hil.core.types import Alarm, Diagnosis, Measurement, Pair

TIME_TOLERANCE_S = 1e-6
"""Rounding: a fault at a step's own time counts for that step."""

UPDATE_CHANGE = 0.01
"""Change of a growing fault's effectiveness after which its alarm is updated."""


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
    """From at_s of the run until until_s, pump `target` (1 or 2) moves only `effectiveness` of its flow.

    ramp_s, period_s, duty : of a growing or intermittent loss, see `FaultCourse`.
    """

    at_s: float
    target: int
    effectiveness: float
    until_s: float = float("inf")
    ramp_s: float = 0.0
    period_s: float | None = None
    duty: float = 1.0

    @property
    def course(self) -> FaultCourse:
        """When it is there, and how it grows."""
        return FaultCourse(self.at_s, self.until_s, self.ramp_s, self.period_s, self.duty)


@dataclass(frozen=True)
class IdealDetector:
    """Knows the faults to come and reports each, exactly, delay_s after it has happened (or has gone).

    Of two faults of one pump the one that began later holds; when it ends or pauses, the earlier one holds again. The
    diagnosed effectiveness follows a growing fault at every step, its alarm in steps of `UPDATE_CHANGE`.
    """

    faults: tuple[PumpFault, ...]
    delay_s: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "faults", tuple(sorted(self.faults, key=lambda fault: fault.at_s)))

    def start(self) -> Any:
        """The effectiveness that the last alarm of each pump gave."""
        return (1.0, 1.0)

    def step(
        self,
        memory: Any,
        t_s: float,
        measurement: Measurement,
        estimate: Estimate,
        applied_V: Pair,
    ) -> tuple[Any, Diagnosis]:
        """The faults as they were delay_s ago; an alarm for every pump whose effectiveness has changed."""
        then = t_s - self.delay_s + TIME_TOLERANCE_S
        known, is_growing = [1.0, 1.0], [False, False]
        for fault in self.faults:
            course = fault.course
            if course.is_present(then):
                known[fault.target - 1] = course.size(then, 1.0, fault.effectiveness)
                is_growing[fault.target - 1] = then < fault.at_s + fault.ramp_s
        effectiveness = (known[0], known[1])
        has_changed = [
            abs(now - before) >= UPDATE_CHANGE if grows else now != before
            for now, before, grows in zip(effectiveness, memory, is_growing, strict=True)
        ]
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
            if has_changed[pump]
        )
        told = tuple(
            now if new else before for now, before, new in zip(effectiveness, memory, has_changed, strict=True)
        )
        return told, Diagnosis(effectiveness=effectiveness, new_alarms=alarms)
