"""Sends frames to the pump node; the status frames after them show how it reacted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hil.core.types import NodeState, Pair
from hil.probe.bus_probe import OFF_V, STATUS_WAIT_S, Probe, ProbeError
from hil.probe.observation import COMMAND, STATUS, Arrival
from hil.wire.contract import crc8

GAP_S = 0.002
"""Time between frames: a node can store only a few."""


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """A payload under PumpCommand's identifier, valid or not."""

    data: bytes
    is_extended: bool = False
    is_remote: bool = False


@dataclass(frozen=True, slots=True)
class Reply:
    """The node's reaction to frames. accepted : how many it counted. highest_V : maximum of all status frames since."""

    accepted: int
    echo: int
    state: NodeState
    cause: int
    applied_V: Pair
    highest_V: float


class Dialogue:
    """Commands the pump node through a probe. Every frame has 0 V unless a voltage is given."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.spec = probe.contract.frames[COMMAND]
        self.cycle_s = probe.contract.frames[STATUS].cycle_s

    def valid(
        self, voltage_V: Pair = OFF_V, *, enable: bool = False, clear: bool = False, counter: int | None = None
    ) -> CommandFrame:
        """A command that the node must accept. counter : instead of the next one; the next one follows it."""
        if counter is not None:
            self.probe.counter = counter % 16
        return CommandFrame(self.probe.payload(voltage_V, enable=enable, clear=clear, counter=self._counter(counter)))

    def stale(self, step: int) -> CommandFrame:
        """Enabled, 0 V, with the last counter increased by step; the last counter does not change."""
        last = self.probe.counter or 0
        return CommandFrame(self.probe.payload(enable=True, counter=(last + step) % 16))

    def sealed(self, body: bytes, crc_start: int | None = None) -> CommandFrame:
        """A payload with its CRC. crc_start : instead of PumpCommand's."""
        start = self.spec.crc_start if crc_start is None else crc_start
        return CommandFrame(body + bytes((crc8(body, start),)))

    def body(self, raw: tuple[int, int] = (0, 0), *, enable: bool = True, spare: int = 0, ahead: int = 0) -> bytes:
        """The bytes before the CRC. raw : multiples of 0.2 mV.

        The counter is the next one, increased by `ahead`; the last counter does not change.
        """
        flags = int(enable) | spare << 2 | (self.probe.next_counter + ahead) % 16 << 4
        return b"".join(value.to_bytes(2, "little") for value in raw) + bytes((flags,))

    def status(self) -> Arrival:
        """The next status frame; raises ProbeError if none comes."""
        status = self.probe.await_status(STATUS_WAIT_S)
        if status is None:
            raise ProbeError("no PumpStatus")
        return status

    def send(self, *frames: CommandFrame, gap_s: float = GAP_S) -> Reply:
        """Send frames one after the other and return the node's reaction.

        The first status after the last frame may have been sent before the node received it; the second was sent after.
        """
        before, begin_ns = self.status(), self.probe.now_ns
        for frame in frames:
            self.probe.send(frame.data, is_extended=frame.is_extended, is_remote=frame.is_remote)
            self.probe.listen(gap_s)
        self.status()
        return self._reply(before, self.status(), begin_ns)

    def silence(self, for_s: float) -> Reply:
        """Send nothing and return what the node does."""
        before, begin_ns = self.status(), self.probe.now_ns
        self.probe.listen(for_s)
        return self._reply(before, self.status(), begin_ns)

    def settle(self) -> bool:
        """Bring the node to ready, at 0 V, with its trip cleared; return whether it is ready."""
        self.send(self.valid())
        return self.send(self.valid(clear=True)).state is NodeState.READY

    def trip(self) -> Reply:
        """Let the watchdog trip after an enabled command of 0 V."""
        self.send(self.valid(enable=True))
        return self.silence(0.25 + 3 * self.cycle_s)

    def _counter(self, given: int | None) -> int | None:
        return None if given is None else given % 16

    def _reply(self, before: Arrival, after: Arrival, begin_ns: int) -> Reply:
        statuses = self.probe.listener.observed(begin_ns, self.probe.now_ns).of(STATUS)
        values = after.values
        return Reply(
            int(values["Accepted"] - before.values["Accepted"]) % 256,
            int(values["Echo"]),
            NodeState(int(values["State"])),
            int(values["TripCause"]),
            (values["Applied1"], values["Applied2"]),
            max(max(status.values["Applied1"], status.values["Applied2"]) for status in statuses),
        )


ConformanceTest = Callable[[Dialogue], str]
"""Returns "" if the node behaves correctly, otherwise what it did."""


def differences(reply: Reply, **wanted: object) -> str:
    """How the fields of a reply differ from the wanted ones; "" if they do not."""
    parts = []
    for name, value in wanted.items():
        seen = getattr(reply, name)
        if seen != value:
            parts.append(f"{name} {_word(seen)}, must be {_word(value)}")
    return "; ".join(parts)


def _word(value: object) -> str:
    return value.name.lower() if isinstance(value, NodeState) else f"{value}"
