"""The real-time loop with the emulated rig behind its port, on a clock that is handed in."""

import dataclasses
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from can import Message

from firmware_sim.frames import parse_command
from firmware_sim.pump_node import Change
from firmware_sim.rig import Rig as Emulator
from firmware_sim.settings import EmulatorSettings
from hil import runtime
from hil.bench import assembly
from hil.core.control_law import ControlLaw
from hil.core.types import Event, Quad, TickRecord
from hil.edge.can.bus import BusPort
from hil.edge.config.settings_file import default_config_dir
from hil.loop import ControlLoop, Outcome, Recorder
from tests.narrowing import not_none

MS = 1_000_000
PERIOD_NS = 100 * MS
SCENARIO = '[scenario]\nname = "short"\nduration_s = 3.0\n[rig]\nsafety.arm_timeout_s = 1.0\n'


class ManualClock:
    """Time that passes only when somebody waits, or when the script says that a call has stalled."""

    def __init__(self) -> None:
        self.now = 5_000 * MS

    def now_ns(self) -> int:
        return self.now

    def sleep_until(self, deadline_ns: int) -> None:
        self.now = max(self.now, deadline_ns)


class RigPort:
    """The emulated rig as a port on the manual clock; notes every command with its time.

    stalls : time -> length. slowest_s : the longest that a step may take until its command is sent.
    """

    def __init__(self, clock: ManualClock, fingerprint: int, stalls: dict[int, int] | None = None) -> None:
        settings = tomllib.loads((default_config_dir() / "emulator.toml").read_text())
        self.trips_ms: list[float] = []
        self.rig = Emulator(EmulatorSettings.model_validate(settings), (), 1, fingerprint, self._watch)
        self.clock = clock
        self.stalls = dict(stalls or {})
        self.sent: list[tuple[int, Any]] = []
        self.inbox: list[Message] = []
        self.send_failures = 0
        self.is_up = True
        self.last_error = self.lines_rejected = ""
        self.start_ns = clock.now
        self.slowest_s = 0.0

    def _watch(self, change: Change) -> None:
        if change.cause == "watchdog":
            self.trips_ms.append(change.t_ns / MS)

    def _rig_ns(self) -> int:
        return self.clock.now - self.start_ns

    def receive(self, timeout_s: float) -> Message | None:
        for at_ns in [at for at in self.stalls if at <= self._rig_ns()]:
            self.clock.now += self.stalls.pop(at_ns)
        due_ns = self.start_ns + self.rig.next_event_ns
        if not self.inbox and due_ns <= self.clock.now + round(timeout_s * 1e9):
            self.clock.now = max(self.clock.now, due_ns)
            self.inbox += self.rig.advance(self._rig_ns())
        elif not self.inbox:
            self.clock.now += round(timeout_s * 1e9)
        return self.inbox.pop(0) if self.inbox else None

    def arrived_ns(self, message: Message, now_ns: int) -> int:  # noqa: ARG002 - a port whose frames bear no stamp
        return now_ns

    def take_events(self) -> list[Event]:
        return []

    def waiting(self) -> list[Message]:
        self.inbox += self.rig.advance(self._rig_ns())
        frames, self.inbox = self.inbox, []
        return frames

    def send(self, frame_id: int, data: bytes, timestamp_s: float) -> bool:
        age_s = self.clock.now * 1e-9 - timestamp_s
        assert -1e-6 < age_s < self.slowest_s + 1e-6, "a command bears the time of its step"
        message = Message(timestamp_s, frame_id, is_extended_id=False, data=data)
        self.sent.append((self.clock.now, parse_command(message)))
        if self.is_up:
            self.rig.receive(message, self._rig_ns())
        return self.is_up


class Ticks:
    """A recorder that keeps the steps, and may raise at one of them."""

    def __init__(self, error_at: int | None = None, error: Exception | None = None) -> None:
        self.records: list[TickRecord] = []
        self.events: list[tuple[float, Event]] = []
        self.error_at, self.error = error_at, error

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None) -> None:  # noqa: ARG002 - the recorder's signature
        self.records.append(record)
        if len(self.records) == self.error_at:
            raise not_none(self.error)

    def frame(self, *_: float) -> None:
        pass

    def event(self, t_s: float, event: Event) -> None:
        self.events.append((t_s, event))


@dataclasses.dataclass
class Bench:
    clock: ManualClock
    port: RigPort
    ticks: Ticks
    loop: ControlLoop

    def run(self, stop_reason: Callable[[], str] = lambda: "") -> Outcome:
        return runtime.run(self.loop, cast(BusPort, self.port), self.clock, 0.1, stop_reason)

    def times_ms(self) -> list[float]:
        return [(at - self.port.start_ns) / MS for at, _ in self.port.sent]

    def assert_ended_at_rest(self) -> None:
        _, last = self.port.sent[-1]
        assert (last.enable, last.command_V) == (False, (0.0, 0.0))
        assert self.port.rig.truth().applied_V == (0.0, 0.0)


def bench_in(
    folder: Path,
    stalls: dict[int, int] | None = None,
    law: Callable[[ControlLaw, ManualClock], ControlLaw] | None = None,
    **recorder: Any,
) -> Bench:
    """A bench of the short scenario. stalls : rig time in ns -> how long the process then stalls.

    law : makes a law around the scenario's.
    """
    scenario = folder / "short.toml"
    scenario.write_text(SCENARIO)
    loaded = assembly.load(scenario)
    clock, ticks = ManualClock(), Ticks(**recorder)
    port = RigPort(clock, loaded.contract.fingerprint, stalls)
    config = assembly.controller_config(loaded)
    if law is not None:
        config = dataclasses.replace(config, loop=dataclasses.replace(config.loop, law=law(config.loop.law, clock)))
    recorder_ = cast(Recorder, ticks)
    loop = ControlLoop(config, loaded.contract, loaded.rig.sensors.range_V, port, recorder_, arm_timeout_s=1.0)
    return Bench(clock, port, ticks, loop)
