"""The probe: listens to a bench and sends it single commands. Leaving its context sends "disabled, 0 V".

It sends nothing automatically and repeats nothing; while it only listens, no frame is sent. See
docs/decisions/0016-doctor.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from hil.core.types import Pair
from hil.probe.observation import COMMAND, STATUS, Arrival, Listener, Observation
from hil.wire.contract import Contract
from hil.wire.frame_check import Frame

POLL_S = 0.05
STATUS_WAIT_S = 1.0
"""How long to wait for a status frame, sent every 50 ms: the computer may be busy for a while."""
STALL_NS = 10_000_000
CATCH_UP_S = 0.005
MAX_BATCH = 1000
OFF_V: Pair = (0.0, 0.0)


class Port(Protocol):
    """The bus that the probe needs."""

    is_up: bool
    last_error: str

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None after timeout_s or a failure."""
        ...

    def arrived_ns(self, message: Any, now_ns: int) -> int:
        """When a frame arrived, on the monotonic clock: the kernel's time stamp if there is one, else now."""
        ...

    def send(
        self, frame_id: int, data: bytes, timestamp_s: float, *, is_extended: bool = False, is_remote: bool = False
    ) -> bool:
        """Send a frame now or not at all; return whether it was sent."""
        ...


class Clock(Protocol):
    """The clock that the probe needs."""

    def now_ns(self) -> int:
        """Monotonic time."""
        ...


class ProbeError(Exception):
    """The bus has failed or accepts no frames, or another sender commands the pump node at the same time."""


class InterruptedByUserError(Exception):
    """A stop was requested; the message is the signal's name."""


class Probe:
    """Listens and commands through a port. stop_reason : returns "" until a stop is requested.

    The counter of commands continues after the last one that the node echoed.
    """

    def __init__(
        self, contract: Contract, port: Port, clock: Clock, stop_reason: Callable[[], str] = lambda: ""
    ) -> None:
        self.contract = contract
        self.counter: int | None = None
        self.listener = Listener(contract)
        self._command = contract.frames[COMMAND]
        self._port = port
        self._clock = clock
        self._stop_reason = stop_reason
        self._has_sent = False

    def __enter__(self) -> Probe:
        return self

    def __exit__(self, *exc: object) -> None:
        """Send 0 V, disabled, if any command was sent."""
        if self._has_sent:
            self._port.send(self._command.frame_id, self.payload(), self._clock.now_ns() * 1e-9)

    @property
    def now_ns(self) -> int:
        """Monotonic time."""
        return self._clock.now_ns()

    def listen(self, for_s: float) -> Observation:
        """Observe the bus for for_s seconds. Raises ProbeError, InterruptedByUserError."""
        begin_ns = self.now_ns
        self.listen_until(begin_ns + round(for_s * 1e9))
        return self.listener.observed(begin_ns, self.now_ns)

    def listen_until(self, deadline_ns: int, is_wanted: Callable[[Arrival], bool] | None = None) -> Arrival | None:
        """Receive frames until the deadline, or until a wanted one; return that one, otherwise None.

        Frames that arrived before the deadline while this process was not running are received too.
        """
        while (remaining_ns := deadline_ns - self.now_ns) > 0:
            arrival = self._take(min(remaining_ns * 1e-9, POLL_S))[1]
            if arrival is not None and is_wanted is not None and is_wanted(arrival):
                return arrival
        if -remaining_ns > STALL_NS:
            for _ in range(MAX_BATCH):
                came, arrival = self._take(CATCH_UP_S)
                if not came:
                    break
                if arrival is not None and is_wanted is not None and is_wanted(arrival):
                    return arrival
        return None

    def _take(self, timeout_s: float) -> tuple[bool, Arrival | None]:
        """Whether a frame arrived, and the frame; None if it was refused."""
        if reason := self._stop_reason():
            raise InterruptedByUserError(reason)
        frame = self._port.receive(timeout_s)
        if frame is None:
            if not self._port.is_up:
                raise ProbeError(self._port.last_error or "the bus has failed")
            return False, None
        arrival = self.listener.take(frame, self._port.arrived_ns(frame, self.now_ns))
        if arrival is not None and arrival.name == COMMAND and self._has_sent:
            raise ProbeError("another sender commands the pump node")
        return True, arrival

    def await_status(self, within_s: float, is_wanted: Callable[[Arrival], bool] = lambda _: True) -> Arrival | None:
        """The next wanted PumpStatus within within_s seconds, or None."""
        deadline_ns = self.now_ns + round(within_s * 1e9)
        return self.listen_until(deadline_ns, lambda arrival: arrival.name == STATUS and is_wanted(arrival))

    def payload(
        self, voltage_V: Pair = OFF_V, *, enable: bool = False, clear: bool = False, counter: int | None = None
    ) -> bytes:
        """A PumpCommand with its CRC. counter : instead of the next one, which then stays the next."""
        if counter is None:
            counter = self.next_counter
            self.counter = counter
        values = {
            "Command1": voltage_V[0],
            "Command2": voltage_V[1],
            "Enable": int(enable),
            "ClearTrip": int(clear),
            "StartPhase": 0,
            "Counter": counter,
        }
        return self._command.encode(values)

    @property
    def next_counter(self) -> int:
        """One more than that of the last command; before the first one, than the node's echo."""
        if self.counter is not None:
            return (self.counter + 1) % 16
        status = self.listener.newest(STATUS)
        return 0 if status is None else (int(status.values["Echo"]) + 1) % 16

    def send(self, data: bytes, *, is_extended: bool = False, is_remote: bool = False) -> int:
        """Send one frame with PumpCommand's identifier; return the time just before. Raises ProbeError."""
        self._has_sent = True
        sent_ns = self.now_ns
        if not self._port.send(
            self._command.frame_id, data, sent_ns * 1e-9, is_extended=is_extended, is_remote=is_remote
        ):
            raise ProbeError(f"a frame could not be sent: {self._port.last_error}")
        return sent_ns

    def command(self, voltage_V: Pair = OFF_V, *, enable: bool = False, clear: bool = False) -> int:
        """Send the next command; return the time just before."""
        return self.send(self.payload(voltage_V, enable=enable, clear=clear))

    def drive(self, voltage_V: Callable[[float], Pair], for_s: float, period_s: float = 0.05) -> Observation:
        """Command enabled voltages, as a function of time, once a period at absolute deadlines; skip late ones."""
        begin_ns = self.now_ns
        end_ns, period_ns = begin_ns + round(for_s * 1e9), round(period_s * 1e9)
        deadline_ns = begin_ns
        while (now_ns := self.now_ns) < end_ns:
            self.command(voltage_V((now_ns - begin_ns) * 1e-9), enable=True)
            deadline_ns += period_ns * ((self.now_ns - deadline_ns) // period_ns + 1)
            self.listen_until(min(deadline_ns, end_ns))
        return self.listener.observed(begin_ns, self.now_ns)
