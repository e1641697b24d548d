"""What every kind of fault has: an onset, perhaps an end, and `apply`. Times are seconds of scenario time.

A kind of fault is one class below `FaultTable`. Everything else is made from it: the check of a scenario, the `failure`
command, its help and the table in the documentation (see `firmware_sim.faults.catalogue`).
"""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Protocol, get_args

from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from firmware_sim.faults.effects import Effects
from firmware_sim.faults.episode import Episode, Timed
from firmware_sim.setting_types import Table, one_of, within

MAX_S = 1e7

PumpNumber = Annotated[int, one_of(1, 2)]
TankNumber = Annotated[int, one_of(1, 2, 3, 4)]
Share = Annotated[float, within(0.0, 1.0)]
Volt = Annotated[float, within(0.0, 10.0)]


class Fault(Timed, Protocol):
    """One fault; times in seconds from the moment t = 0 of the scenario, or from its injection."""

    @property
    def kind(self) -> str:
        """Its name."""

    @property
    def target(self) -> int | str:
        """What the fault acts on."""

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Write this fault into the effects."""


@dataclass(frozen=True)
class FailureWord:
    """A failure type of the `failure` command: its component, its word, the value if none is given, a fixed target."""

    component: str
    word: str
    value: float | None = None
    target: str | None = None


class FaultTable(Table):
    """A [[fault]] of a scenario.

    acts_on : the part that fails, as the documentation calls it. targets_text : for the documentation, where listing
    all targets would be too long. unit : of `value`, "" where the kind takes none. grows_from : what `value` is in a
    healthy rig, from which a fault with `ramp_s` grows; "" for a kind that can't grow.
    words : how the `failure` command calls this kind; the first one decides the component and the target of the kind's
    own name.
    """

    acts_on: ClassVar[str]
    targets_text: ClassVar[str] = ""
    unit: ClassVar[str] = ""
    grows_from: ClassVar[str] = ""
    words: ClassVar[tuple[FailureWord, ...]]

    at_s: Annotated[float, within(0.0, MAX_S)]
    until_s: Annotated[float, within(0.0, MAX_S)] | None = None
    ramp_s: Annotated[float, within(0.0, MAX_S)] = 0.0
    period_s: Annotated[float, within(0.01, MAX_S)] | None = None
    duty: Annotated[Annotated[float, within(0.001, 0.999)] | None, Field(validate_default=True)] = None

    @field_validator("until_s")
    @classmethod
    def _ends_after_onset(cls, until_s: float | None, info: ValidationInfo) -> float | None:
        at_s: Any = info.data.get("at_s")
        if until_s is not None and at_s is not None and until_s <= at_s:
            raise PydanticCustomError("order", "must be later than at_s = {at_s}", {"at_s": at_s})
        return until_s

    @field_validator("ramp_s")
    @classmethod
    def _can_grow(cls, ramp_s: float) -> float:
        if ramp_s > 0.0 and not cls.grows_from:
            raise PydanticCustomError("growth", "must be 0: {kind} has no size that grows", {"kind": kind_of(cls)})
        return ramp_s

    @field_validator("duty")
    @classmethod
    def _belongs_to_a_period(cls, duty: float | None, info: ValidationInfo) -> float | None:
        if "period_s" in info.data and (duty is None) != (info.data["period_s"] is None):
            other = "needs period_s, too" if duty is not None else "must be given with period_s"
            raise PydanticCustomError("intermittent", "{other}", {"other": other})
        return duty


def kind_of(table: type[FaultTable]) -> str:
    """Name of a kind of fault, from the literal type of its `kind`."""
    return str(get_args(table.model_fields["kind"].annotation)[0])
