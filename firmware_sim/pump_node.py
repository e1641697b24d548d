"""Pump node: owns the two pump voltages and keeps them safe on its own clock.

Rules
- boot     0 V. Commands are rejected (cause: boot). After boot_s: ready.
- ready    0 V. An accepted command with Enable = 1: run. Enable = 0: stays.
- run      puts out the commands of every accepted frame with Enable = 1. Enable = 0: 0 V, ready, no trip.
           No accepted command for watchdog_s: 0 V and tripped, cause watchdog, exactly at the
           deadline.
- tripped  0 V, latched. Commands are accepted and echoed but change nothing, until one with ClearTrip = 1,
           Enable = 0 and both commands at 0 V: ready.
- reboot (from any state): 0 V, boot, all state reset.
- power-off (from any state): 0 V; run becomes ready, tripped stays tripped.

A command is accepted if it is intact and in range (see wire.parse_command) and its counter is 1 to 8 steps
after the last accepted one. If none was accepted yet, or for longer than watchdog_s, any counter is accepted. A
rejected frame changes nothing and is counted by cause.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from can import Message

from firmware_sim.faults import NS_PER_S
from firmware_sim.frames import (
    COUNTER_MODULUS,
    PUMP_HEARTBEAT_ID,
    NodeState,
    PumpCommand,
    Rejection,
    TripCause,
    counter_verdict,
    pack_heartbeat,
    pack_status,
    parse_command,
)
from firmware_sim.settings import EmulatorSettings

DAC_RANGE_V = 10.0
BOOT_COUNT = 1
BOOT_COUNT_MODULUS = 65536
OFF_V = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Change:
    """A node's new state or new output voltages; t_ns on the emulator's clock, wall_ahead_ns to the node's own."""

    t_ns: int
    node: str
    state: NodeState
    applied_V: tuple[float, ...]
    cause: str
    wall_ahead_ns: int = 0


Observer = Callable[[Change], None]


def quantised(voltage_V: float, bits: int) -> float:
    """Nearest output of a converter over 0 .. 10 V whose highest code gives 10 V; 0 bits: no steps."""
    if bits == 0:
        return voltage_V
    top = (1 << bits) - 1
    return round(voltage_V / DAC_RANGE_V * top) * DAC_RANGE_V / top


class PumpNode:
    """State machine of the pump node; powered up at time 0 of the clock given by the caller."""

    def __init__(self, settings: EmulatorSettings, fingerprint: int, observer: Observer) -> None:
        self._dac_bits = settings.pumps.dac_bits
        self._watchdog_ns = round(settings.nodes.watchdog_s * NS_PER_S)
        self._boot_ns = self._boot_end_ns = round(settings.nodes.boot_s * NS_PER_S)
        self._boot_count = BOOT_COUNT
        self._fingerprint = fingerprint
        self._observer = observer
        self._last: tuple[int, int] | None = None  # counter and time of the last accepted command
        self._status_counter = 0
        self._heartbeat_counter = 0
        self.state = NodeState.BOOT
        self.trip_cause = TripCause.NONE
        self.applied_V = OFF_V
        self.accepted = 0
        self.lost = 0
        self.rejected: Counter[Rejection] = Counter()
        self.wall_ahead_ns = 0
        self.is_start_phase = False  # of the last accepted command; the node itself ignores it
        self._report(0, "boot")

    @property
    def next_event_ns(self) -> int | None:
        """When the node next changes its state without a frame, or None."""
        if self.state is NodeState.BOOT:
            return self._boot_end_ns
        if self.state is NodeState.RUN and self._last is not None:
            return self._last[1] + self._watchdog_ns
        return None

    def run_event(self, now_ns: int) -> None:
        """Carry out the event of `next_event_ns` if it is due."""
        due_ns = self.next_event_ns
        if due_ns is None or due_ns > now_ns:
            return
        if self.state is NodeState.BOOT:
            self._enter(now_ns, NodeState.READY, OFF_V, "booted")
        else:
            self.trip_cause = TripCause.WATCHDOG
            self._enter(now_ns, NodeState.TRIPPED, OFF_V, "watchdog")

    def receive(self, frame: Message, now_ns: int) -> Rejection | None:
        """Take a frame from the bus; None if it was accepted as a command."""
        verdict = parse_command(frame)
        if isinstance(verdict, Rejection):
            return self._reject(verdict)
        if self.state is NodeState.BOOT:
            return self._reject(Rejection.BOOT)
        lost = self._check_counter(verdict.counter, now_ns)
        if isinstance(lost, Rejection):
            return self._reject(lost)
        self.lost += lost
        self.accepted += 1
        self._last = (verdict.counter, now_ns)
        self.is_start_phase = verdict.start_phase
        self._execute(verdict, now_ns)
        return None

    def power_off(self, now_ns: int) -> None:
        """Put the outputs at 0 V, and report it in any case."""
        self.applied_V = OFF_V
        if self.state is NodeState.RUN:
            self.state = NodeState.READY
        self._report(now_ns, "shutdown")

    @property
    def next_counter(self) -> int:
        """Counter that the next command should have."""
        return 0 if self._last is None else (self._last[0] + 1) % COUNTER_MODULUS

    def reboot(self, now_ns: int, power_ns: int) -> None:
        """Reset the node's state, put the outputs at 0 V and boot as soon as power is back at power_ns."""
        self._last = None
        self._status_counter = self._heartbeat_counter = 0
        self._boot_count = (self._boot_count + 1) % BOOT_COUNT_MODULUS
        self._boot_end_ns = power_ns + self._boot_ns
        self.accepted = self.lost = 0
        self.trip_cause = TripCause.NONE
        self.state, self.applied_V = NodeState.BOOT, OFF_V
        self._report(now_ns, "reboot")

    def status(self) -> bytes:
        """Payload of the next PumpStatus frame."""
        echo = 0 if self._last is None else self._last[0]
        counter = self._status_counter
        self._status_counter = (counter + 1) % COUNTER_MODULUS
        return pack_status(self.applied_V, self.state, self.trip_cause, echo, counter, self.accepted)

    def heartbeat(self) -> bytes:
        """Payload of the next PumpHeartbeat frame."""
        counter = self._heartbeat_counter
        self._heartbeat_counter = (counter + 1) % COUNTER_MODULUS
        return pack_heartbeat(PUMP_HEARTBEAT_ID, self.state, counter, self._boot_count, self._fingerprint)

    def _check_counter(self, counter: int, now_ns: int) -> int | Rejection:
        if self._last is None or now_ns - self._last[1] > self._watchdog_ns:
            return 0
        return counter_verdict(counter, self._last[0])

    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        asks_clear = command.clear_trip and not command.enable and command.command_V == OFF_V
        if self.state is NodeState.TRIPPED:
            if asks_clear:
                self.trip_cause = TripCause.NONE
                self._enter(now_ns, NodeState.READY, OFF_V, "cleared")
        elif command.enable:
            v1, v2 = command.command_V
            output_V = (quantised(v1, self._dac_bits), quantised(v2, self._dac_bits))
            self._enter(now_ns, NodeState.RUN, output_V, "command")
        else:
            self._enter(now_ns, NodeState.READY, OFF_V, "disabled")

    def _enter(self, now_ns: int, state: NodeState, applied_V: tuple[float, float], cause: str) -> None:
        is_change = state is not self.state or applied_V != self.applied_V
        self.state, self.applied_V = state, applied_V
        if is_change:
            self._report(now_ns, cause)

    def _reject(self, cause: Rejection) -> Rejection:
        self.rejected[cause] += 1
        return cause

    def _report(self, now_ns: int, cause: str) -> None:
        self._observer(Change(now_ns, "pump", self.state, self.applied_V, cause, self.wall_ahead_ns))
