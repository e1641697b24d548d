"""Scheduled faults: what is wrong with the rig, from when on and until when, in scenario time.

Scenario time starts (t = 0) when the pump node first enters run. A kind of fault is one frozen table with
an `apply` method that writes into `Effects`; plant and nodes read `Effects` and know nothing of schedules.
Of two faults that set the same thing, the one that began later holds; when it ends, the earlier one holds
again.
"""

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Protocol

from pydantic import ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from firmware_sim.checks import Table, one_of, within

NS_PER_S = 1_000_000_000
LONGEST_S = 1e7


@dataclass
class Effects:
    """What the faults that are active now do to the rig; a healthy rig by default."""

    effectiveness: list[float] = field(default_factory=lambda: [1.0, 1.0])


class Fault(Protocol):
    """One scheduled fault; times in seconds of scenario time."""

    @property
    def at_s(self) -> float:
        """Onset."""

    @property
    def until_s(self) -> float | None:
        """End, or None: it stays."""

    def apply(self, effects: Effects) -> None:
        """Write this fault into the effects."""


class PumpEffectiveness(Table):
    """A pump gives only a share of the flow that its voltage should give (1: healthy, 0: dead)."""

    at_s: Annotated[float, within(0.0, LONGEST_S)]
    until_s: Annotated[float, within(0.0, LONGEST_S)] | None = None
    kind: Literal["pump_effectiveness"]
    target: Annotated[int, one_of(1, 2)]
    value: Annotated[float, within(0.0, 1.0)]

    @field_validator("until_s")
    @classmethod
    def _ends_after_onset(cls, until_s: float | None, info: ValidationInfo) -> float | None:
        at_s: Any = info.data.get("at_s")
        if until_s is not None and at_s is not None and until_s <= at_s:
            raise PydanticCustomError("order", "must be later than at_s = {at_s}", {"at_s": at_s})
        return until_s

    def apply(self, effects: Effects) -> None:
        """Set the share of the target pump."""
        effects.effectiveness[self.target - 1] = self.value


class FaultSchedule:
    """Runs scheduled faults on the emulator's clock; idle until `start`."""

    def __init__(self, faults: tuple[Fault, ...]) -> None:
        self._faults = sorted(faults, key=lambda fault: fault.at_s)
        self._start_ns: int | None = None
        self._changes_ns: list[int] = []
        self.effects = Effects()

    @property
    def next_ns(self) -> int | None:
        """When the next fault begins or ends, or None."""
        return self._changes_ns[0] if self._changes_ns else None

    def start(self, now_ns: int) -> None:
        """Make now the moment t = 0 of the scenario."""
        self._start_ns = now_ns
        times_s = {fault.at_s for fault in self._faults}
        times_s |= {fault.until_s for fault in self._faults if fault.until_s is not None}
        self._changes_ns = sorted(now_ns + round(time_s * NS_PER_S) for time_s in times_s)

    def advance(self, now_ns: int) -> None:
        """Bring `effects` to the faults that are active now."""
        if self._start_ns is None:
            return
        while self._changes_ns and self._changes_ns[0] <= now_ns:
            del self._changes_ns[0]
        elapsed_ns = now_ns - self._start_ns
        self.effects = Effects()
        for fault in self._faults:
            has_begun = round(fault.at_s * NS_PER_S) <= elapsed_ns
            has_ended = fault.until_s is not None and round(fault.until_s * NS_PER_S) <= elapsed_ns
            if has_begun and not has_ended:
                fault.apply(self.effects)
