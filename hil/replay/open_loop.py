"""The control loop driven by recorded frames at their recorded times; what it would send is kept and goes nowhere.

Open loop: the recorded rig answered the recorded commands. Echoes of the pump node are therefore matched with the
recorded commands, not with today's; otherwise a law that asks for other voltages would seem to be disobeyed.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from typing import Any

from hil.bench.assembly import Bench, make_loop
from hil.core.controller import ControllerConfig, ControllerState, Output
from hil.core.live_request import LiveRequest
from hil.core.types import Command, Event, Inputs, Quad, TickRecord, Timing
from hil.edge.record.record_format import event_line
from hil.loop import Outcome
from hil.replay.recorded_steps import NOTHING, RecordedStep, RecordedSteps
from hil.wire.command_sender import CommandSender
from hil.wire.contract import Contract

OnProgress = Callable[[int, int], None]


def count_of_command(contract: Contract) -> float:
    """One count of a command on the wire, V. The default tolerance: another processor may round to the other side."""
    return next(s.scale for s in contract.frames["PumpCommand"].signals if s.name == "Command1")


@dataclass(frozen=True, eq=False)
class Replayed:
    """What today's controller did.

    payloads : what it sent at each step; b"" for nothing. event_text : lines as in events.jsonl. columns : of the steps
    in control, by name. step_s : run time of each step; NaN outside of control. outcome : how it would have ended the
    run, if it did.
    """

    payloads: tuple[bytes, ...]
    event_text: str
    columns: dict[str, array[float]]
    step_s: array[float]
    outcome: Outcome | None


class ReplayPort:
    """Takes what the loop sends. is_up, can_send : as the record says of the step."""

    def __init__(self) -> None:
        self.send_failures = 0
        self.is_up = True
        self.last_error = ""
        self.lines_rejected = ""
        self.can_send = True
        self.payload = b""

    def send(self, frame_id: int, data: bytes, timestamp_s: float) -> bool:
        """Keep the payload."""
        del frame_id, timestamp_s
        self.payload = data
        self.send_failures += not self.can_send
        return self.can_send


class RecordedCommandSender(CommandSender):
    """Encodes today's commands, but expects the echo of the recorded ones."""

    def __init__(self, contract: Contract) -> None:
        super().__init__(contract)
        self._layout = contract.frames["PumpCommand"]
        self._count_V = count_of_command(contract)
        self.recorded = b""
        """What the record sent at this step; empty: nothing."""

    def encode(self, command: Command, now_ns: int) -> bytes:
        """Payload of today's command, with the counter of the recorded one."""
        values = self._layout.decode(self.recorded) if self.recorded else None
        if values is None:
            return super().encode(command, now_ns)
        self.sent += (int(values["Counter"]) - self.sent) % 16
        payload = super().encode(command, now_ns)
        recorded_V, enable = (values["Command1"], values["Command2"]), bool(values["Enable"])
        off_V = max(abs(was - now) for was, now in zip(recorded_V, command.voltage_V, strict=True))
        if enable != command.enable or off_V > self._count_V:  # otherwise it is the command itself, less its rounding
            self.replace_last(recorded_V, enable=enable)
        return payload


class ReplayRecorder:
    """Keeps the events, and of the steps what the comparison shows."""

    def __init__(self) -> None:
        self.events: list[str] = []
        names = ("t_s", "mode", "v1_V", "v2_V", "theta1", "theta2", "test_ratio", "test_limit")
        self.columns = {name: array("d") for name in names}

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None) -> None:
        """Keep one step and its events."""
        del true_level_cm
        (v1, v2), (theta1, theta2) = record.command_V, record.effectiveness
        row = (record.t_s, record.mode, v1, v2, theta1, theta2, record.test_ratio, record.test_limit)
        for column, value in zip(self.columns.values(), row, strict=True):
            column.append(value)
        for event in record.events:
            self.event(record.t_s, event)

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        """Frames are in the record already."""

    def message(self, timestamp_s: float, message: Any) -> None:
        """Frames are in the record already."""

    def event(self, t_s: float, event: Event) -> None:
        """Keep one event."""
        self.events.append(event_line(t_s, event))


class RecordedOperator:
    """Hands over the requests of a step."""

    def __init__(self) -> None:
        self.waiting: tuple[LiveRequest, ...] = ()
        self.is_open = True

    def requests(self) -> tuple[LiveRequest, ...]:
        """Those of this step."""
        return self.waiting

    def show(self, inputs: Inputs, output: Output, state: ControllerState, now_ns: int) -> tuple[Event, ...]:
        """Nobody looks."""
        del inputs, output, state, now_ns
        return ()


def play(
    recorded: RecordedSteps,
    bench: Bench,
    config: ControllerConfig,
    *,
    clear_trip: bool = False,
    on_progress: OnProgress | None = None,
) -> Replayed:
    """Drive the controller with the record. on_progress : called every 100 steps with those done, and of how many."""
    port, recorder, operator = ReplayPort(), ReplayRecorder(), RecordedOperator()
    sender = RecordedCommandSender(bench.contract)
    loop = make_loop(bench, config, port, recorder, clear_trip=clear_trip, operator=operator, sender=sender)
    log, payloads, done, had = recorded.log, [], 0, 0
    step_s = array("d")
    for number, step in enumerate(recorded.steps):
        for row in recorded.received[done : step.until].tolist():
            loop.receive(log.message(row), int(log.time_ns[row]))
        done = step.until
        sender.recorded = b"" if step.command == NOTHING else log.payload(step.command)
        operator.waiting, operator.is_open = recorded.requests.get(number, ()), step.has_channel
        port.is_up, port.can_send, port.payload = step.link_is_up, step.command != NOTHING, b""
        if loop.outcome is not None and _is_last_command(recorded.steps, number):
            loop.make_safe(step.now_ns)
        else:
            loop.tick(step.now_ns, Timing(step.lateness_s, step.skipped), step.stop_reason)
        payloads.append(port.payload)
        times_s = recorder.columns["t_s"]
        step_s.append(times_s[-1] if len(times_s) > had else nan)
        had = len(times_s)
        if on_progress is not None and number % 100 == 99:
            on_progress(number + 1, len(recorded.steps))
    return Replayed(tuple(payloads), "".join(recorder.events), recorder.columns, step_s, loop.outcome)


def _is_last_command(steps: tuple[RecordedStep, ...], number: int) -> bool:
    """Whether it is the 0 V that every live run sends when it is over."""
    return number == len(steps) - 1 and not steps[number].is_in_control
