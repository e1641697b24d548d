"""Helpers of the safety tests: what a bench says, healthy or with one fault; the loop with a port that records."""

import math
import struct
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from can import Message

from firmware_sim import frames as node
from hil.core.controller import ControllerConfig
from hil.core.diagnosis.ideal import NoDetector
from hil.core.estimator import LevelFilter
from hil.core.gain_design import choose_rig_design
from hil.core.interlocks import NO_FAULT, Belief
from hil.core.laws.state_feedback_law import StateFeedbackLaw
from hil.core.loop_state import LoopConfig
from hil.core.reconfiguration import Reconfiguration
from hil.core.tanks import TankModel, equilibrium, linearise
from hil.core.types import (
    BusHealth,
    Diagnosis,
    Event,
    Inputs,
    Measurement,
    Mode,
    NodeHealth,
    NodeState,
    PumpFeedback,
    Quad,
    TickRecord,
    Timing,
    TripCause,
)
from hil.loop import ControlLoop, Outcome
from hil.wire.contract import Contract
from tests.core import core_bench
from tests.narrowing import not_none, pair, quad

ROOT = Path(__file__).resolve().parents[2]
CONTRACT = Contract.from_dbc((ROOT / "config/bench.dbc").read_text())
RIG = tomllib.loads((ROOT / "config/rig.toml").read_text())
MS = 1_000_000
PERIOD_S = 0.1
PERIOD_NS = 100 * MS
START_NS = 1000 * MS
BENCH = TankModel()
REST_V = quad(0.5 * h for h in equilibrium(BENCH, (3.0, 3.0)))
LIMITS = replace(core_bench.LIMITS, stop_ramp_V_s=10.0)
HEALTHY = Inputs(
    Measurement(REST_V, (True,) * 4, 0.01, 5),
    PumpFeedback((3.0, 3.0), (0.0, 0.0), NodeState.RUN, 0, 0.02, 0.0),
    NodeHealth(0.05, rebooted=False, contract_matches=True),
    BusHealth(10, 0, 0, 0, is_up=True),
)
READY = replace(HEALTHY, pumps=replace(HEALTHY.pumps, state=NodeState.READY, applied_V=(0.0, 0.0)))


def but(inputs: Inputs, part: str, **changes: Any) -> Inputs:
    """These inputs with something changed: but(HEALTHY, "bus", is_up=False)."""
    return replace(inputs, **{part: replace(getattr(inputs, part), **changes)})


def level(inputs: Inputs, channel: int, volts: float) -> Inputs:
    levels = list(inputs.measurement.level_V)
    levels[channel] = volts
    return but(inputs, "measurement", level_V=tuple(levels))


def invalid(inputs: Inputs, channel: int) -> Inputs:
    """Its newest three readings are not valid."""
    return but(
        inputs,
        "measurement",
        valid=tuple(i != channel for i in range(4)),
        invalid_run=tuple(3 * (i == channel) for i in range(4)),
    )


FAULTS: tuple[tuple[str, TripCause, Callable[[Inputs], Inputs]], ...] = (
    ("bus down", TripCause.BUS_FAILED, lambda i: but(i, "bus", is_up=False)),
    ("foreign command", TripCause.FOREIGN_COMMAND, lambda i: but(i, "bus", foreign_commands=1)),
    ("node tripped", TripCause.NODE_TRIPPED, lambda i: but(i, "pumps", state=NodeState.TRIPPED)),
    ("node rebooted", TripCause.NODE_REBOOTED, lambda i: but(i, "nodes", rebooted=True)),
    ("wrong contract", TripCause.WRONG_CONTRACT, lambda i: but(i, "nodes", contract_matches=False)),
    ("frames refused", TripCause.FRAMES_REFUSED, lambda i: but(i, "bus", refused_run=5)),
    ("error storm", TripCause.ERROR_STORM, lambda i: but(i, "bus", errors_per_s=20)),
    ("node boots", TripCause.NODE_REBOOTED, lambda i: but(i, "pumps", state=NodeState.BOOT)),
    ("levels late", TripCause.STALE_LEVELS, lambda i: but(i, "measurement", age_s=0.31)),
    ("levels never seen", TripCause.STALE_LEVELS, lambda i: but(i, "measurement", age_s=math.inf)),
    ("status late", TripCause.STALE_STATUS, lambda i: but(i, "pumps", age_s=0.31)),
    ("status never seen", TripCause.STALE_STATUS, lambda i: but(i, "pumps", age_s=math.inf)),
    ("heartbeat late", TripCause.NODE_LOST, lambda i: but(i, "nodes", age_s=0.26)),
    ("heartbeat never seen", TripCause.NODE_LOST, lambda i: but(i, "nodes", age_s=math.inf)),
    ("no echo", TripCause.ECHO_MISSING, lambda i: but(i, "pumps", unechoed_s=0.51)),
    *((f"level {c + 1} invalid", TripCause.INVALID_LEVELS, lambda i, c=c: invalid(i, c)) for c in range(4)),
    *((f"level {c + 1} unknown", TripCause.INVALID_LEVELS, lambda i, c=c: level(i, c, math.nan)) for c in range(4)),
    *((f"level {c + 1} infinite", TripCause.INVALID_LEVELS, lambda i, c=c: level(i, c, math.inf)) for c in range(4)),
    *((f"tank {c + 1} nearly full", TripCause.HIGH_LEVEL, lambda i, c=c: level(i, c, 9.51)) for c in range(4)),
)
"""Name, the cause that it trips with, and what it does to the inputs."""

ALL = (True,) * 4
REST_CM = quad(y / 0.5 for y in REST_V)


def doubted(*channels: int) -> tuple[bool, bool, bool, bool]:
    """Trust in all sensors but these."""
    return quad(i not in channels for i in range(4))


VERDICTS: tuple[tuple[str, TripCause, Diagnosis], ...] = (
    *(
        (f"pump {n} is no number", TripCause.CONTROLLER_FAILED, Diagnosis(theta))
        for n, theta in ((1, (math.nan, 1.0)), (2, (1.0, math.nan)), (2, (1.0, math.inf)))
    ),
    *(
        (f"sensor {c + 1} without substitute", TripCause.INVALID_LEVELS, Diagnosis(trusted=doubted(c)))
        for c in range(4)
    ),
    *(
        (
            f"sensor {c + 1} replaced by no number",
            TripCause.INVALID_LEVELS,
            Diagnosis(trusted=doubted(c), level_V=quad(math.nan if i == c else 2.0 for i in range(4))),
        )
        for c in range(4)
    ),
    ("two sensors lost", TripCause.SENSORS_LOST, Diagnosis(trusted=doubted(1, 3), level_V=REST_V)),
    (
        "a level that nobody knows",
        TripCause.SENSORS_LOST,
        Diagnosis(trusted=doubted(0), level_V=REST_V, is_blind=True),
    ),
    ("four sensors lost", TripCause.SENSORS_LOST, Diagnosis(trusted=doubted(0, 1, 2, 3), level_V=REST_V)),
    *(
        (
            f"tank {c + 1} is full behind a lost sensor",
            TripCause.HIGH_LEVEL,
            Diagnosis(trusted=doubted(c), level_V=quad(9.51 if i == c else 2.0 for i in range(4))),
        )
        for c in range(4)
    ),
    ("pump 1 stuck on", TripCause.PUMP_STUCK_ON, Diagnosis(stuck_on=(True, False))),
    ("pump 2 stuck on", TripCause.PUMP_STUCK_ON, Diagnosis(stuck_on=(False, True))),
    ("diverged", TripCause.ESTIMATOR_DIVERGED, Diagnosis(is_diverged=True)),
)
"""Name, the cause that it trips with, and what the diagnosis says."""


def believing(diagnosis: Diagnosis = NO_FAULT, **changes: Any) -> Belief:
    """What a loop that accommodates faults would hand on."""
    return Belief(diagnosis, REST_CM, (3.0, 3.0), accommodates=True, **changes)


def config(**changes: Any) -> ControllerConfig:
    at = linearise(BENCH, equilibrium(BENCH, (3.0, 3.0)))
    design = choose_rig_design(at, RIG["control"]["output_poles"], RIG["control"]["noise_gain_max"])
    loop = LoopConfig(
        law=StateFeedbackLaw(Reconfiguration(BENCH, design, (10.0, 10.0), (3.0, 3.0)), PERIOD_S, anti_windup_s=5.0),
        detector=NoDetector(),
        level_filter=LevelFilter(BENCH, lag_s=(0.2, 0.2), filter_s=0.5),
        references=((0.0, pair(REST_V[:2])),),
        reconfigure=True,
        period_s=PERIOD_S,
    )
    return ControllerConfig(replace(loop, **changes), LIMITS, math.inf)


@dataclass(frozen=True)
class SentCommand:
    """A command frame as a node reads it."""

    at_ns: int
    voltage_V: tuple[float, float]
    enable: bool
    clear: bool
    counter: int


class RecordingPort:
    """Keeps what the loop sends, read back by the emulator's own parser."""

    def __init__(self) -> None:
        self.send_failures, self.is_up, self.last_error, self.lines_rejected = 0, True, "", ""
        self.sent: list[SentCommand] = []

    def send(self, frame_id: int, data: bytes, timestamp_s: float) -> bool:
        parsed = node.parse_command(Message(arbitration_id=frame_id, data=data, is_extended_id=False))
        assert isinstance(parsed, node.PumpCommand), parsed
        at_ns = round(timestamp_s * 1e9)
        self.sent.append(SentCommand(at_ns, parsed.command_V, parsed.enable, parsed.clear_trip, parsed.counter))
        if not self.is_up:
            self.send_failures += 1
        return self.is_up


@dataclass
class KeepingRecorder:
    """Keeps what the loop records."""

    ticks: list[TickRecord] = field(default_factory=list)
    true_levels: list[Quad | None] = field(default_factory=list)
    frames: list[tuple[float, int, bytes, bool]] = field(default_factory=list)
    messages: list[tuple[float, Message]] = field(default_factory=list)
    events: list[tuple[float, Event]] = field(default_factory=list)

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None) -> None:
        self.ticks.append(record)
        self.true_levels.append(true_level_cm)
        self.events += [(record.t_s, event) for event in record.events]

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        self.frames.append((timestamp_s, arbitration_id, bytes(data), is_rx))

    def message(self, timestamp_s: float, frame: Message) -> None:
        self.messages.append((timestamp_s, frame))

    def event(self, t_s: float, event: Event) -> None:
        self.events.append((t_s, event))


class LoopBench:
    """A ControlLoop between a port and a recorder; nodes that answer every command, until told otherwise."""

    def __init__(self, controller_config: ControllerConfig | None = None, **arguments: Any) -> None:
        self.port, self.recorder = RecordingPort(), KeepingRecorder()
        self.arguments: dict[str, Any] = {"arm_timeout_s": 1.0} | arguments
        self.loop = ControlLoop(
            controller_config or config(), CONTRACT, (0.0, 10.24), self.port, self.recorder, **self.arguments
        )
        self.now_ns = START_NS - PERIOD_NS
        self.counter = 0
        self.levels_V = REST_V
        self.statuses = (node.ChannelStatus.OK,) * 4
        self.node_tripped = False
        self.confirms = True
        self.silent: set[str] = set()
        self.boots = {"pumps": 1, "levels": 1}
        self.contract = CONTRACT.fingerprint

    @property
    def mode(self) -> Mode:
        return self.loop._state.supervision.mode

    def is_in(self, mode: Mode) -> bool:
        """For a test that sees more than one mode: a type checker takes the property to keep its value."""
        return self.mode is mode

    def ended(self) -> Outcome:
        return not_none(self.loop.outcome)

    @property
    def cause(self) -> TripCause | None:
        return self.loop._state.supervision.cause

    @property
    def last(self) -> SentCommand:
        return self.port.sent[-1]

    def codes(self) -> list[str]:
        return [event.code for _, event in self.recorder.events]

    def frames(self) -> dict[str, Message]:
        """One frame of each kind, as the nodes would send them now."""
        sent = self.port.sent
        echo = sent[-1] if sent and self.confirms else None
        runs = echo is not None and echo.enable and not self.node_tripped
        applied = echo.voltage_V if echo is not None and runs else (0.0, 0.0)
        state = node.NodeState.TRIPPED if self.node_tripped else node.NodeState.RUN if runs else node.NodeState.READY
        cause = node.TripCause.WATCHDOG if self.node_tripped else node.TripCause.NONE
        n = self.counter
        y, s = self.levels_V, self.statuses
        pump_beat = node.pack_heartbeat(node.PUMP_HEARTBEAT_ID, state, n, self.boots["pumps"], self.contract)
        level_beat = node.pack_heartbeat(node.LEVEL_HEARTBEAT_ID, state, n, self.boots["levels"], self.contract)
        packed = {
            "LowerLevels": (node.LOWER_LEVELS_ID, node.pack_levels(node.LOWER_LEVELS_ID, pair(y[:2]), pair(s[:2]), n)),
            "UpperLevels": (node.UPPER_LEVELS_ID, node.pack_levels(node.UPPER_LEVELS_ID, pair(y[2:]), pair(s[2:]), n)),
            "PumpStatus": (
                node.STATUS_ID,
                node.pack_status(applied, state, cause, echo.counter if echo else 0, n, len(sent) % 256 if echo else 0),
            ),
            "PumpHeartbeat": (node.PUMP_HEARTBEAT_ID, pump_beat),
            "LevelHeartbeat": (node.LEVEL_HEARTBEAT_ID, level_beat),
        }
        return {name: self._message(*packed[name]) for name in packed if name not in self.silent}

    @staticmethod
    def _message(can_id: int, data: bytes) -> Message:
        return Message(arbitration_id=can_id, data=data, is_extended_id=False)

    def step(self, count: int = 1, stop_reason: str = "", timing: Timing | None = None) -> None:
        """One period after another: the nodes speak, the loop ticks."""
        for _ in range(count):
            self.now_ns += PERIOD_NS
            self.counter = (self.counter + 1) % 16
            for frame in self.frames().values():
                self.loop.receive(frame, self.now_ns - 5 * MS)
            self.loop.tick(self.now_ns, timing or Timing(), stop_reason)

    def run(self) -> "LoopBench":
        """Until it runs, a few steps in."""
        self.step(8)
        assert self.mode is Mode.RUNNING
        assert self.last.enable
        assert self.last.voltage_V[0] > 2.0
        return self


def raw_command(v1: float, v2: float, *, enable: bool = True, counter: int = 0) -> Message:
    """A command frame of somebody else."""
    body = struct.pack("<HHB", round(v1 * 5000), round(v2 * 5000), enable | counter << 4)
    return Message(arbitration_id=node.COMMAND_ID, data=node.sealed(node.COMMAND_ID, body), is_extended_id=False)
