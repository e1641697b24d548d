"""The configuration of the control loop, and its state from one step to the next."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from typing import Any, NamedTuple

from hil.core.control_law import Authority, ControlLaw, LawInputs, LawRequest
from hil.core.diagnosis.detector import FaultDetector
from hil.core.estimator import Estimate, LevelFilter
from hil.core.following import Followed
from hil.core.law_copies import is_own
from hil.core.pumps import STRAIGHT, PumpPath, UnderWay
from hil.core.reference_path import ReferenceMove
from hil.core.sensors import PLAIN, LevelSensors
from hil.core.start_phase import StartConfig, StartPhase
from hil.core.types import Diagnosis, Pair, Quad

UNSTABLE_S = 5.0
"""A split is refined after it was found: no stable law for this time is a reason to stop. Instability grows slowly."""


@dataclass(frozen=True)
class LoopConfig:
    """Configuration of the control loop.

    references, moves : (at_s, (r1, r2) in V), ascending in time, the first at 0, and which of them are reached by a
    ramp or trajectory, see `RunReferences`. reconfigure : whether the law is told of the
    diagnosis by `LawInputs.followed`. pumps, sensors : what lies between the law's drives and the commands, and between
    readings and level signals. start : of the start phase.
    """

    law: ControlLaw
    detector: FaultDetector
    level_filter: LevelFilter
    references: tuple[tuple[float, Pair], ...]
    reconfigure: bool
    period_s: float
    pumps: PumpPath = STRAIGHT
    sensors: LevelSensors = PLAIN
    start: StartConfig = field(default_factory=StartConfig)
    moves: tuple[tuple[int, ReferenceMove], ...] = ()

    @cached_property
    def is_own_law(self) -> bool:
        """Whether the law is one of this project's, which needs no copies of what the loop goes on to use."""
        return is_own(self.law)


class LastCommand(NamedTuple):
    """What became of the drives that the law asked for, see `LawInputs`. At first the pumps have what was found."""

    given_V: Pair
    excess_V: Pair = (0.0, 0.0)
    authority: Authority = Authority.NOBODY


class LoopState(NamedTuple):
    """State of the control loop between two steps.

    started_ns : time 0 of the run, still to come in a start phase. reference_V : (2,) outputs to aim at; in a start
    phase on the way to those that are requested. start : the start phase that the run began with, or None. request : of
    the law at this step. law_memory, memory : of the law and of the detector. inputs : what the law knew. followed :
    what of the diagnosis the law follows. drive_V, raw_V : (2,) what law and probe ask for at this step, as drives and
    as voltages. unstable_since_s : since when the law can't hold the outputs, inf if it can. under_way :
    drives that have not arrived, for pumps with a delay.
    """

    started_ns: int
    stepped_ns: int
    reference_V: Pair
    start: StartPhase | None
    request: LawRequest
    law_memory: Any
    inputs: LawInputs
    last: LastCommand
    estimate: Estimate
    memory: Any
    diagnosis: Diagnosis
    iae_Vs: Pair
    drive_V: Pair
    raw_V: Pair
    under_way: UnderWay
    followed: Followed = Followed()
    unstable_since_s: float = inf

    @property
    def t_s(self) -> float:
        """Run time of the last step, s; negative in a start phase."""
        return (self.stepped_ns - self.started_ns) * 1e-9

    @property
    def level_cm(self) -> Quad:
        """(4,) the levels fed back, less a probe's movement."""
        return self.inputs.level_cm

    @property
    def is_starting(self) -> bool:
        """Whether the last step was in a start phase, which ends with the step nearest to time 0."""
        return self.start is not None and self.t_s < -0.5 * self.start.period_s

    @property
    def problem(self) -> str:
        """Why the outputs can't be held; "" if they can, or if it is not known for UNSTABLE_S yet."""
        return self.request.problem if self.t_s - self.unstable_since_s >= UNSTABLE_S else ""
