"""Encodes commands, and finds which of them the pump node echoed and which were lost.

See docs/decisions/0001-wire.md for the counter and the echo.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import islice

from hil.core.types import Command, Pair
from hil.wire.contract import Contract

MAX_DISTINCT_ECHOES = 15
"""A 4-bit echo alone can identify one of so many commands; with the count of accepted ones, one of more."""

MAX_PENDING = 1024
"""Commands that may wait for their echo; waiting half a second trips, at any control period."""


@dataclass(frozen=True, slots=True)
class Sent:
    """A command that was sent: its number since the start, its counter, its time, and its content."""

    number: int
    counter: int
    sent_ns: int
    voltage_V: Pair
    enable: bool


class CommandSender:
    """Encodes commands with counter and CRC, and matches the node's echoes with them."""

    def __init__(self, contract: Contract) -> None:
        """Use the PumpCommand frame of this contract."""
        self._spec = contract.frames["PumpCommand"]
        self._pending: deque[Sent] = deque(maxlen=MAX_PENDING)
        self._echoed: Sent | None = None
        self._base: tuple[int, int] | None = None
        self.sent = 0
        self.lost = 0

    @property
    def frame_id(self) -> int:
        """Identifier of PumpCommand."""
        return self._spec.frame_id

    def encode(self, command: Command, now_ns: int) -> bytes:
        """Payload of the next frame. Raises ValueError out of range, which the supervisor should prevent."""
        counter = self.sent % 16
        values = {
            "Command1": command.voltage_V[0],
            "Command2": command.voltage_V[1],
            "Enable": int(command.enable),
            "ClearTrip": int(command.clear_trip),
            "StartPhase": int(command.start_phase),
            "Counter": counter,
        }
        payload = self._spec.encode(values)
        self._pending.append(Sent(self.sent, counter, now_ns, command.voltage_V, command.enable))
        self.sent += 1
        return payload

    def replace_last(self, voltage_V: Pair, *, enable: bool) -> None:
        """Expect the echo of this command instead of the last one: for a replay, in which another one was sent."""
        last = self._pending.pop()
        self._pending.append(Sent(last.number, last.counter, last.sent_ns, voltage_V, enable))

    def echo(self, counter: int, accepted: int) -> Sent | None:
        """The command that an echo belongs to. accepted : the node's count of accepted commands, modulo 256.

        Older commands are settled too: accepted or lost, as the count shows.
        """
        if self._base is None and accepted == 0:
            return None  # it has accepted nothing since its boot
        match = self._match(counter, accepted)
        if match is None:
            return self._echoed if self._echoed is not None and self._echoed.counter == counter else None
        while self._pending and self._pending[0].number <= match.number:
            self._pending.popleft()
        self._echoed = match
        if self._base is not None:
            missing = (match.number - self._base[0] - (accepted - self._base[1])) % 256
            if missing < 128:  # otherwise the echo belonged to an earlier run
                self.lost += missing
        self._base = match.number, accepted
        return match

    def _match(self, counter: int, accepted: int) -> Sent | None:
        """The command that an echo belongs to: if none was lost, as many after the last one as were accepted since."""
        pending = self._pending
        if self._base is not None and pending:
            number, count = self._base
            gained = (accepted - count) % 256
            if gained == 0:
                return None
            index = number + gained - pending[0].number
            if index < len(pending) and pending[index].counter == counter:
                return pending[index]
        newest = islice(pending, max(len(pending) - MAX_DISTINCT_ECHOES, 0), None)
        return next((sent for sent in newest if sent.counter == counter), None)

    def unechoed_s(self, now_ns: int) -> float:
        """Time in s since the oldest unsettled command was sent; 0 if there is none."""
        return (now_ns - self._pending[0].sent_ns) * 1e-9 if self._pending else 0.0
