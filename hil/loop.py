"""The control loop, for any clock: read, decode, step, encode, write, record.

`runtime` runs it on the monotonic clock and a real bus, `lockstep` on a simulated clock and the emulator. See
docs/decisions/0011-interlocks.md for the end of a run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Any, Literal, Protocol

from hil.core import supervisor
from hil.core.controller import ControllerConfig, Output
from hil.core.live_request import LiveRequest
from hil.core.steps import ScenarioSteps, Steps, StepState
from hil.core.types import Command, Event, Inputs, Mode, NodeState, Quad, Severity, TickRecord, Timing, TripCause
from hil.wire.command_sender import CommandSender
from hil.wire.contract import Contract
from hil.wire.frame_check import Frame, is_plain
from hil.wire.receiver import Receiver

Status = Literal["complete", "stopped", "tripped", "failed"]

REST_TIMEOUT_S = 1.0
"""How long the end of a run waits for the pump node to confirm 0 V."""


class Port(Protocol):
    """What the loop needs of a bus."""

    send_failures: int
    is_up: bool
    last_error: str

    @property
    def lines_rejected(self) -> str:
        """Commands refused by an adapter and its rejected lines, as text; "" if there are none."""
        ...

    def send(self, frame_id: int, data: bytes, timestamp_s: float) -> bool:
        """Send a frame now or not at all; return whether it was sent."""
        ...


class Recorder(Protocol):
    """Receives the loop's record; no method may block or raise."""

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None) -> None:
        """One control step."""
        ...

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        """One frame of the bench."""
        ...

    def message(self, timestamp_s: float, message: Any) -> None:
        """A frame of any other kind, as received."""
        ...

    def event(self, t_s: float, event: Event) -> None:
        """One event outside of a recorded step."""
        ...


class OperatorChannel(Protocol):
    """Brings an operator's requests and shows the run; no method may block or raise."""

    @property
    def is_open(self) -> bool:
        """Whether requests can still come."""
        ...

    def requests(self) -> tuple[LiveRequest, ...]:
        """Those for this step: a few at most."""
        ...

    def show(self, inputs: Inputs, output: Output, state: Any, now_ns: int) -> tuple[Event, ...]:
        """What was done in this step; events for the record."""
        ...


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended, at which run time, and what became of its commands. begun_s : run time of the first step."""

    status: Status
    reason: str
    t_s: float
    commands_sent: int
    commands_lost: int
    frames_lost: int
    begun_s: float = 0.0


class ControlLoop:
    """Holds the controller's state between steps. One thread calls it.

    config : of a scenario's controller; or the steps of something else, such as a phase of an experiment.
    true_level_cm : the emulator's levels for the record, where they can be known. on_tick : watches every step.
    clock_ns : tells when a command has gone out; without it, it went out at the step's own time.
    operator : who may change the run while it goes on. sender : of a replay. troubles : what has failed of the record
    since it was last asked; must neither block nor raise.
    """

    def __init__(
        self,
        config: ControllerConfig | Steps,
        contract: Contract,
        sensor_range_V: tuple[float, float],
        port: Port,
        recorder: Recorder,
        *,
        arm_timeout_s: float,
        clear_trip: bool = False,
        true_level_cm: Callable[[], Quad] | None = None,
        on_tick: Callable[[Inputs, Output, Mode], None] | None = None,
        clock_ns: Callable[[], int] | None = None,
        operator: OperatorChannel | None = None,
        sender: CommandSender | None = None,
        troubles: Callable[[], tuple[Event, ...]] = tuple,
    ) -> None:
        self._steps: Steps = ScenarioSteps(config) if isinstance(config, ControllerConfig) else config
        self._sender = CommandSender(contract) if sender is None else sender
        self._receiver = Receiver(contract, self._sender, sensor_range_V, self._steps.sensors)
        self._port = port
        self._recorder = recorder
        self._arm_timeout_s = arm_timeout_s
        self._clear_trip = clear_trip
        self._true_level_cm = true_level_cm
        self._on_tick = on_tick
        self._clock_ns = clock_ns
        self._operator = operator
        self._troubles = troubles
        self._state: StepState = self._steps.start()
        self._waiting_since_ns: int | None = None
        self._ending_since_ns: int | None = None
        self._t_s = 0.0
        self._begun_s: float | None = None
        self._noted: tuple[Event, ...] = ()
        self.outcome: Outcome | None = None

    def receive(self, frame: Frame, received_ns: int) -> None:
        """Read, decode: one frame off the bus."""
        self._receiver.take(frame, received_ns)
        if is_plain(frame):
            self._recorder.frame(received_ns * 1e-9, frame.arbitration_id, frame.data, True)
        else:
            self._recorder.message(received_ns * 1e-9, frame)

    def note(self, event: Event) -> None:
        """Record an event of the bus, and pass it to the watcher with the next step."""
        self._recorder.event(self._t_s, event)
        self._noted += (event,)

    def tick(self, now_ns: int, timing: Timing, stop_reason: str = "") -> None:
        """Step, encode, write, record. `outcome` is set once the run is over and the pumps are known to be off."""
        self._noted += self._troubles()
        inputs = self._inputs(now_ns, timing, bool(stop_reason))
        must_stay_silent = self._must_stay_silent()
        asked = self._operator.requests() if self._operator is not None else ()
        try:
            self._state, output = self._steps.step(self._state, inputs, now_ns, asked)
            data = b"" if must_stay_silent else self._sender.encode(self._with_clearing(output, inputs), now_ns)
        except Exception as error:  # noqa: BLE001 - whatever a step raises, this tick sends 0 V
            text = f"{type(error).__name__}: {error}"
            self._state, output = self._steps.fail(self._state, TripCause.CONTROLLER_FAILED, text)
            data = b"" if must_stay_silent else self._sender.encode(output.command, now_ns)
        if data:
            self._send(data, now_ns)
        self._record(output)
        self._show(inputs, output, now_ns)
        self._settle(inputs, now_ns, stop_reason)

    def _must_stay_silent(self) -> bool:
        """Whether another sender's commands caused the trip: then nothing is sent after the trip's own 0 V.

        If two controllers both went on sending 0 V, the node's watchdog would never trip.
        """
        return self._state.supervision.cause is TripCause.FOREIGN_COMMAND

    def make_safe(self, now_ns: int) -> None:
        """Send 0 V, disabled, whatever happened before; the last command of every run."""
        self._send(self._sender.encode(supervisor.OFF, now_ns), now_ns)

    def _inputs(self, now_ns: int, timing: Timing, stop_requested: bool) -> Inputs:
        receiver, port = self._receiver, self._port
        return Inputs(
            measurement=receiver.measurement(now_ns),
            pumps=receiver.pumps(now_ns),
            nodes=receiver.nodes(now_ns),
            bus=receiver.bus(now_ns, port.send_failures, port.is_up, port.last_error, port.lines_rejected),
            timing=timing,
            stop_requested=stop_requested,
            noted=self._noted,
        )

    def _with_clearing(self, output: Output, inputs: Inputs) -> Command:
        """While disarmed, and only if the operator asked for it, clear the node's trip, also an earlier run's."""
        supervision = self._state.supervision
        may_clear = self._clear_trip or supervision.clears_node
        if may_clear and supervision.mode is Mode.DISARMED and inputs.pumps.state is NodeState.TRIPPED:
            return supervisor.CLEAR
        return output.command

    def _send(self, data: bytes, now_ns: int) -> None:
        if self._port.send(self._sender.frame_id, data, now_ns * 1e-9):
            sent_ns = self._clock_ns() if self._clock_ns is not None else now_ns
            self._recorder.frame(sent_ns * 1e-9, self._sender.frame_id, data, False)

    def _record(self, output: Output) -> None:
        if output.record is not None:
            self._t_s = output.record.t_s
            self._begun_s = self._t_s if self._begun_s is None else self._begun_s
            self._recorder.tick(output.record, self._true_level_cm() if self._true_level_cm else None)
            return
        for event in output.events:
            self._recorder.event(self._t_s, event)

    def _show(self, inputs: Inputs, output: Output, now_ns: int) -> None:
        """Call the watcher and the operator's channel with the step; if one raises, the run goes on without it."""
        noted, self._noted = self._noted, ()
        if self._on_tick is None and self._operator is None:
            return
        if noted:
            output = output._replace(events=noted + output.events)
        try:
            if self._on_tick is not None:
                self._on_tick(inputs, output, self._state.supervision.mode)
        except Exception as error:  # noqa: BLE001 - an error of a display must not stop the run
            self._on_tick = None
            self._recorder.event(self._t_s, Event(Severity.WARNING, "watcher_failed", f"no more display: {error}"))
        if self._operator is None:
            return
        try:
            events = self._operator.show(inputs, output, self._state, now_ns)
        except Exception as error:  # noqa: BLE001 - nor an error of the channel
            self._operator = None
            text = f"the control channel has failed: {type(error).__name__}: {error}"
            events = (Event(Severity.WARNING, "control_lost", text),)
        for event in events:
            self.note(event)

    def _settle(self, inputs: Inputs, now_ns: int, stop_reason: str) -> None:
        """Decide whether the run is over: disarmed for too long, or pumps known to be off after a stop or a trip."""
        mode = self._state.supervision.mode
        if mode in (Mode.DISARMED, Mode.READY):
            self._settle_disarmed(inputs, now_ns, stop_reason)
            return
        self._waiting_since_ns = None
        may_be_cleared = mode is Mode.TRIPPED and not stop_reason
        can_be_asked = self._operator is not None and self._operator.is_open
        if mode.moves_pumps or (may_be_cleared and self._steps.will_be_cleared(self._state, can_be_asked)):
            self._ending_since_ns = None
            return
        if self._ending_since_ns is None:
            self._ending_since_ns = now_ns
        unconfirmed = _unconfirmed(inputs, self._steps.limits.status_age_max_s)
        if not unconfirmed or (now_ns - self._ending_since_ns) * 1e-9 > REST_TIMEOUT_S:
            cause, stopped_by = self._state.supervision.cause, stop_reason or self._state.supervision.stopped_by
            if cause is not None:
                self._finish("tripped", cause.value + unconfirmed)
            else:
                self._finish("stopped" if stopped_by else "complete", (stopped_by or "duration over") + unconfirmed)

    def _settle_disarmed(self, inputs: Inputs, now_ns: int, stop_reason: str) -> None:
        if self._waiting_since_ns is None:
            self._waiting_since_ns = now_ns
        stopped_by = stop_reason or self._state.supervision.stopped_by
        if stopped_by:
            self._finish("stopped", stopped_by)
        elif self._steps.is_over(self._state):
            self._finish("complete", "duration over")
        elif (now_ns - self._waiting_since_ns) * 1e-9 > self._arm_timeout_s:
            blocker = supervisor.not_ready(self._steps.limits, inputs)
            rejected = inputs.bus.rejection_summary
            if rejected and rejected not in blocker:
                blocker += f"; {rejected}"
            text = f"not ready within {self._arm_timeout_s:g} s: {blocker}"
            self._recorder.event(self._t_s, Event(Severity.ERROR, "not_ready", text))
            self._finish("failed", text)

    def _finish(self, status: Status, reason: str) -> None:
        sender = self._sender
        begun_s = self._begun_s or 0.0
        self.outcome = Outcome(status, reason, self._t_s, sender.sent, sender.lost, self._receiver.lost, begun_s)


def _unconfirmed(inputs: Inputs, status_age_max_s: float) -> str:
    """What is missing to know that the pumps are off, as an addition to the reason; "" if nothing is.

    Two separate facts: what the node's newest status reports, and whether the last command was echoed.
    """
    pumps = inputs.pumps
    is_at_rest, is_echoed = supervisor.is_at_rest(inputs), pumps.unechoed_s == 0.0
    if is_at_rest and is_echoed:
        return ""
    if pumps.age_s > status_age_max_s:
        is_known = pumps.age_s < inf
        text = f"its last status is {pumps.age_s:.2g} s old" if is_known else "no status was received"
        text = f"; the pump node has not confirmed 0 V: {text}"
    elif is_at_rest:
        return "; the pump node reports 0 V, but the last command was not echoed"
    else:
        first_V, second_V = pumps.applied_V
        state = pumps.state.name.lower()
        text = f"; the pump node has not confirmed 0 V: it reports {first_V:.3g} and {second_V:.3g} V in state {state}"
    return text if is_echoed else f"{text}; the last command was not echoed"
