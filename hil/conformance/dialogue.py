"""One question to the pump node at a time: frames go out, the status frames that follow tell what became of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hil.core.types import NodeState, Pair
from hil.probe.bus_probe import OFF_V, PATIENCE_S, Probe, ProbeError
from hil.probe.observation import COMMAND, STATUS, Arrival
from hil.wire.contract import crc8

GAP_S = 0.002
"""Between frames: a node's mailboxes are few."""


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """A payload under PumpCommand's identifier, valid or not."""

    data: bytes
    is_extended: bool = False
    is_remote: bool = False


@dataclass(frozen=True, slots=True)
class Reply:
    """What the node made of some frames. accepted : how many it counted. highest_V : of all status frames since."""

    accepted: int
    echo: int
    state: NodeState
    cause: int
    applied_V: Pair
    highest_V: float


class Dialogue:
    """Talks to the pump node through a probe. Every frame is of 0 V unless a voltage is given."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.spec = probe.contract.frames[COMMAND]
        self.cycle_s = probe.contract.frames[STATUS].cycle_s

    def valid(
        self, voltage_V: Pair = OFF_V, *, enable: bool = False, clear: bool = False, counter: int | None = None
    ) -> CommandFrame:
        """A command that the node has to take. counter : another step than 1; the count goes on from there."""
        if counter is not None:
            self.probe.counter = counter % 16
        return CommandFrame(self.probe.payload(voltage_V, enable=enable, clear=clear, counter=self._counter(counter)))

    def stale(self, step: int) -> CommandFrame:
        """Enabled, 0 V, with a counter so many steps on from the last one; that one stays the last."""
        last = self.probe.counter or 0
        return CommandFrame(self.probe.payload(enable=True, counter=(last + step) % 16))

    def sealed(self, body: bytes, crc_start: int | None = None) -> CommandFrame:
        """A payload's bytes with their CRC, PumpCommand's or one that starts otherwise."""
        start = self.spec.crc_start if crc_start is None else crc_start
        return CommandFrame(body + bytes((crc8(body, start),)))

    def body(self, raw: tuple[int, int] = (0, 0), *, enable: bool = True, spare: int = 0, ahead: int = 0) -> bytes:
        """The bytes before the CRC. raw : multiples of 0.2 mV.

        The counter is the next one, or one so many steps ahead of it; it does not become the last one.
        """
        flags = int(enable) | spare << 2 | (self.probe.next_counter + ahead) % 16 << 4
        return b"".join(value.to_bytes(2, "little") for value in raw) + bytes((flags,))

    def status(self) -> Arrival:
        """The next status frame; raises ProbeError when none comes."""
        status = self.probe.await_status(PATIENCE_S)
        if status is None:
            raise ProbeError("no PumpStatus")
        return status

    def say(self, *frames: CommandFrame, gap_s: float = GAP_S) -> Reply:
        """Send frames one after the other and see what the node made of them.

        The first status after the last frame may have been on its way already; the second can't have been.
        """
        before, begin_ns = self.status(), self.probe.now_ns
        for frame in frames:
            self.probe.send(frame.data, is_extended=frame.is_extended, is_remote=frame.is_remote)
            self.probe.listen(gap_s)
        self.status()
        return self._reply(before, self.status(), begin_ns)

    def silence(self, for_s: float) -> Reply:
        """Send nothing and see what the node does by itself."""
        before, begin_ns = self.status(), self.probe.now_ns
        self.probe.listen(for_s)
        return self._reply(before, self.status(), begin_ns)

    def settle(self) -> bool:
        """Bring the node to ready, at 0 V, a trip cleared; whether that went."""
        self.say(self.valid())
        return self.say(self.valid(clear=True)).state is NodeState.READY

    def trip(self) -> Reply:
        """Let the watchdog trip after an enabled command of 0 V."""
        self.say(self.valid(enable=True))
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


Question = Callable[[Dialogue], str]
"""Returns "" when the node does as it must, otherwise what it did."""


def differences(reply: Reply, **wanted: object) -> str:
    """How a reply differs from what is wanted, by its fields; "" when it doesn't."""
    parts = []
    for name, value in wanted.items():
        seen = getattr(reply, name)
        if seen != value:
            parts.append(f"{name} {_word(seen)}, must be {_word(value)}")
    return "; ".join(parts)


def _word(value: object) -> str:
    return value.name.lower() if isinstance(value, NodeState) else f"{value}"
