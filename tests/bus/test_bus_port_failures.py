"""The port's own rules, on buses that fail in every way python-can's buses do."""

import can
import pytest

from hil.edge.can.bus import MAX_BATCH, SEND_FAILURES_IN_A_ROW, BusPort
from tests.bus.bus_bench import COMMAND_ID, VirtualFar, closing, frame, next_frame, port_on


class FailingBus:
    """Raises what it is told to, as often as it is told to; otherwise a quiet bus. Notes what was sent, and how."""

    def __init__(self, error: Exception, times: int = 10**9) -> None:
        self.error, self.times = error, times
        self.sent: list[can.Message] = []
        self.timeouts: list[float | None] = []

    def _fail(self) -> None:
        if self.times > 0:
            self.times -= 1
            raise self.error

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        self.timeouts.append(timeout)
        self._fail()
        self.sent.append(message)

    def recv(self, timeout: float | None = None) -> None:
        self.timeouts.append(timeout)
        self._fail()

    def shutdown(self) -> None:
        self._fail()


ERRORS = [can.CanOperationError("full"), OSError(105, "No buffer space"), ValueError("bad"), IndexError("short")]


def send(port: BusPort) -> bool:
    return port.send(COMMAND_ID, bytes(6), 0.0)


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_the_third_failed_send_in_a_row_takes_the_bus_down(error: Exception) -> None:
    port = port_on(FailingBus(error))
    ups = []
    for _ in range(SEND_FAILURES_IN_A_ROW + 2):
        assert send(port) is False
        ups.append(port.is_up)
    assert ups == [True, True, False, False, False]
    assert port.send_failures == 5
    assert str(error) in port.last_error


def test_two_failed_sends_and_a_good_one_leave_it_up() -> None:
    bus = FailingBus(OSError(105, "No buffer space"))
    port = port_on(bus)
    for _ in range(4):
        bus.times = SEND_FAILURES_IN_A_ROW - 1
        assert [send(port), send(port), send(port)] == [False, False, True]
    assert port.is_up
    assert port.send_failures == 8


def test_a_failed_command_is_never_sent_again() -> None:
    bus = FailingBus(OSError(105, "No buffer space"), times=2)
    port = port_on(bus)
    for number in range(4):
        port.send(COMMAND_ID, bytes([number] * 6), 0.0)
    assert [bytes(m.data)[0] for m in bus.sent] == [2, 3]


def test_a_send_never_asks_the_bus_to_wait() -> None:
    bus = FailingBus(OSError(), times=0)
    send(port_on(bus))
    assert bus.timeouts == [0]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_a_failed_receive_takes_the_bus_down_at_once(error: Exception) -> None:
    port = port_on(FailingBus(error, times=1))
    assert port.receive(0.0) is None
    assert not port.is_up
    assert port.receive_failures == 1


def test_a_bus_once_down_stays_down() -> None:
    bus = FailingBus(OSError(100, "Network is down"), times=1)
    port = port_on(bus)
    port.receive(0.0)
    assert send(port) is True
    assert not port.is_up


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_close_never_raises(error: Exception) -> None:
    bus = FailingBus(error, times=1)
    port_on(bus).close()
    assert bus.times == 0, "it was shut down, and that failed"


def test_what_is_not_the_buss_fault_is_not_swallowed() -> None:
    """A bug must reach the loop, which then sends 0 V."""
    with pytest.raises(ZeroDivisionError):
        port_on(FailingBus(ZeroDivisionError())).receive(0.0)


def test_waiting_takes_a_bounded_batch_of_a_babbling_bus() -> None:
    with closing(VirtualFar("babble")) as far:
        far.send(*[frame() for _ in range(MAX_BATCH + 500)])
        assert len(far.port.waiting()) == MAX_BATCH
        assert len(far.port.waiting()) == 500


def test_a_virtual_bus_keeps_the_time_it_is_given() -> None:
    ours, theirs = (
        can.Bus(interface="virtual", channel="stamped", preserve_timestamps=True, ignore_config=True) for _ in range(2)
    )
    try:
        BusPort(ours).send(COMMAND_ID, bytes(6), 12.5)
        message = next_frame(BusPort(theirs))
        assert message is not None
        assert (message.timestamp, message.is_extended_id, bytes(message.data)) == (12.5, False, bytes(6))
    finally:
        ours.shutdown()
        theirs.shutdown()
