"""What the loop calls at each control step: a scenario's controller, or a phase of an experiment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from hil.core import controller
from hil.core.controller import ControllerConfig, ControllerState, Output
from hil.core.interlocks import Limits
from hil.core.live_request import LiveRequest
from hil.core.sensors import LevelSensors
from hil.core.supervisor import Supervision
from hil.core.types import Inputs, TripCause


class StepState(Protocol):
    """What the loop sees of the state between two steps."""

    @property
    def supervision(self) -> Supervision:
        """Of the supervisor."""
        ...


class Steps(Protocol):
    """The control steps of a run. A state is what `start` or `step` of the same object returned."""

    @property
    def limits(self) -> Limits:
        """Of the supervisor."""
        ...

    @property
    def sensors(self) -> LevelSensors:
        """What the readings mean."""
        ...

    def start(self) -> StepState:
        """The state before the first step."""
        ...

    def step(
        self, state: Any, inputs: Inputs, now_ns: int, asked: tuple[LiveRequest, ...] = ()
    ) -> tuple[StepState, Output]:
        """One step; the command is always safe. Whatever it raises is answered with `fail`.

        asked : by an operator since the last step, while the run goes on.
        """
        ...

    def fail(self, state: Any, cause: TripCause, text: str) -> tuple[StepState, Output]:
        """State and output for a step that raised an exception: trip, 0 V in the same step."""
        ...

    def will_be_cleared(self, state: Any, can_be_asked: bool) -> bool:
        """Whether a trip may still be cleared. can_be_asked : whether an operator's requests can come."""
        ...

    def is_over(self, state: Any) -> bool:
        """Whether the run has reached its end."""
        ...


@dataclass(frozen=True)
class ScenarioSteps:
    """The steps of `hil.core.controller`."""

    config: ControllerConfig

    @property
    def limits(self) -> Limits:
        """Of the supervisor."""
        return self.config.limits

    @property
    def sensors(self) -> LevelSensors:
        """What the readings mean."""
        return self.config.loop.sensors

    def start(self) -> ControllerState:
        """The state before the first step."""
        return ControllerState()

    def step(
        self, state: ControllerState, inputs: Inputs, now_ns: int, asked: tuple[LiveRequest, ...] = ()
    ) -> tuple[ControllerState, Output]:
        """See `controller.step`."""
        return controller.step(self.config, state, inputs, now_ns, asked)

    def fail(self, state: ControllerState, cause: TripCause, text: str) -> tuple[ControllerState, Output]:
        """See `controller.fail`."""
        return controller.fail(state, cause, text)

    def will_be_cleared(self, state: ControllerState, can_be_asked: bool) -> bool:
        """See `controller.will_be_cleared`."""
        return controller.will_be_cleared(self.config, state, can_be_asked)

    def is_over(self, state: ControllerState) -> bool:
        """See `controller.is_over`."""
        return controller.is_over(self.config, state)
