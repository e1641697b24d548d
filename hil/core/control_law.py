"""The protocol that a control law follows: from levels, diagnosis and references to the drives of the two pumps.

A law works on straight pumps: its *drives* are voltages of a pump whose flow is proportional to them. The loop turns
drives into voltages by the rig file's dead zone and curve, and the supervisor decides what is sent: it limits range and
rate, and it ignores the law in MANUAL, in a trip and in a stop. So no law can move a pump past the supervisor.
Why it is so: docs/decisions/0036-control-laws.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable

from hil.core.estimator import Estimate
from hil.core.following import Followed
from hil.core.start_phase import StartPhase
from hil.core.types import Diagnosis, Event, Pair, Quad


class Authority(StrEnum):
    """Who decided the last command: the law, the operator (MANUAL), or nobody (pumps off, or on their way there)."""

    LAW = "law"
    OPERATOR = "operator"
    NOBODY = "nobody"


class ReferencePath(Protocol):
    """The references of the whole run, so that a law may look ahead."""

    @property
    def start(self) -> StartPhase | None:
        """The start phase that the run began with, or None."""
        ...

    def at(self, t_s: float) -> Pair:
        """References (2,) in V at run time t_s; before time 0 those of the start phase, on the way to the first."""
        ...

    def rate(self, t_s: float) -> Pair:
        """Rates (2,) in V/s at which the references move from t_s on; 0 where they are at rest, and at a step."""
        ...


@dataclass(frozen=True, slots=True)
class LawInputs:
    """What a law knows at one step.

    t_s : run time, negative in a start phase. period_s : since the last step, 0 at the first of a run.
    level_cm : (4,) levels to feed back: readings, and estimates where a sensor is not trusted; less the movement that a
    probe of the diagnosis causes.
    estimate, diagnosis : as they are. followed : what of the diagnosis the loop follows, free of flicker; that of a
    healthy rig with `control.reconfigure = false`.
    reference_V : (2,) outputs wanted now. requested_V : (2,) the same, but in a start phase the outputs that it leads
    to. references : those of the whole run.
    wanted_V : (2,) drives that the law asked for at its last step. given_V : (2,) drives that the supervisor allowed
    then, less a probe's. excess_V : (2,) the first less the second, plus what the pump node fell short of.
    authority : who decided them. While it is not the law, the law keeps its memory such that it goes on from given_V
    without a jump.
    """

    t_s: float
    period_s: float
    level_cm: Quad
    estimate: Estimate
    diagnosis: Diagnosis
    followed: Followed
    reference_V: Pair
    requested_V: Pair
    references: ReferencePath
    wanted_V: Pair
    given_V: Pair
    excess_V: Pair
    authority: Authority


@dataclass(frozen=True, slots=True)
class FeedbackRecord:
    """What the record has columns for, of a law that is a state feedback with integral action.

    operating_V : (2,) drives at the operating point. integral_Vs : (2,) integrals of the control error. gain : (12,) by
    rows, in force on the pumps: four levels, V/cm, then two integrals, 1/s.
    """

    operating_V: Pair
    integral_Vs: Pair
    gain: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class LawRequest:
    """What a law asks for at one step.

    drive_V : (2,) drives, before all limits; whatever is not finite is a trip. target_V : (2,) outputs that the law
    aims at: the references, or what can be reached. reason : why these are not the references, "" if they are.
    problem : why the outputs can't be held at all, "" if they can: after 5 s the run ends in an orderly way.
    shown : numbers for the record, by name; the names are the same at every step.
    events : for the record; their codes are among `hil.core.law_check.CODES`. feedback : of a state feedback.
    """

    drive_V: Pair
    target_V: Pair
    reason: str = ""
    problem: str = ""
    shown: Mapping[str, float] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    feedback: FeedbackRecord | None = None


class ControlLaw(Protocol):
    """What the controller needs of a law. Users plug in their own; state travels through `memory`."""

    def start(self, inputs: LawInputs) -> Any:
        """Memory to begin with: pumps have the drives `given_V`.

        Called at the first step in control, and after a trip at every step until the rig is armed again.
        """
        ...

    def step(self, memory: Any, inputs: LawInputs) -> tuple[Any, LawRequest]:
        """One step: new memory, and the drives wanted. `memory` is handed on and never looked at."""
        ...


@runtime_checkable
class ChecksReferences(Protocol):
    """A law that can say before a run whether it can hold a reference; it need not."""

    def check(self, reference_V: Pair) -> None:
        """Raises ValueError that says why these outputs (2,) in V can't be held on a healthy rig."""
        ...
