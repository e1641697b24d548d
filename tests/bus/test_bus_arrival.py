"""When a frame has arrived, by the kernel's stamp on a wall clock that may jump; what a port tells of error frames."""

from collections.abc import Callable
from typing import Any

import can
import pytest

from hil.edge.host.clock import ArrivalClock
from tests.bus.bus_bench import COMMAND_ID, port_on
from tests.narrowing import not_none

S = 1_000_000_000
WALL_NS = 1_790_000_000 * S


class Wall:
    """A wall clock beside a monotonic one that began at 0, and an offset between them that may jump."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.ahead_ns = WALL_NS
        self.arrival = ArrivalClock(lambda: self.now_ns + self.ahead_ns)

    def stamp_s(self) -> float:
        return (self.now_ns + self.ahead_ns) * 1e-9

    def arrived_s(self, stamp_s: float) -> float:
        return self.arrival.arrived_ns(stamp_s, self.now_ns) / S


@pytest.fixture
def wall() -> Wall:
    return Wall()


def test_a_frame_that_waited_has_arrived_when_it_was_stamped(wall: Wall) -> None:
    stamps_s = []
    for at_ns in (1 * S, 2 * S):
        wall.now_ns = at_ns
        stamps_s.append(wall.stamp_s())
    wall.now_ns = 5 * S
    assert [wall.arrived_s(stamp_s) for stamp_s in stamps_s] == pytest.approx([1.0, 2.0], abs=1e-6)


@pytest.mark.parametrize("jump_s", [3600, -3600])
def test_a_wall_clock_that_jumps_moves_no_arrival_out_of_the_gap_before_it(wall: Wall, jump_s: int) -> None:
    wall.now_ns = 1 * S
    wall.arrived_s(wall.stamp_s())
    wall.now_ns = round(1.02 * S)
    stamp_s = wall.stamp_s()
    wall.ahead_ns += jump_s * S
    wall.now_ns = round(1.03 * S)
    assert 1.0 <= wall.arrived_s(stamp_s) <= 1.03
    wall.now_ns = round(1.04 * S)
    assert wall.arrived_s(wall.stamp_s()) == pytest.approx(1.04, abs=1e-6), "the next frame is right again"


def test_arrivals_never_run_backwards(wall: Wall) -> None:
    wall.now_ns = 3 * S
    assert wall.arrived_s(wall.stamp_s()) == pytest.approx(3.0, abs=1e-6)
    assert wall.arrived_s(wall.stamp_s() - 1.0) == pytest.approx(3.0, abs=1e-6)


class Saying:
    """A bus that has these frames to say."""

    def __init__(self, *frames: can.Message, **settings: Any) -> None:
        self._frames = list(frames)
        self._error: Exception = settings.pop("error", RuntimeError("nothing is to be sent"))
        self.__dict__.update(settings)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        del timeout
        return self._frames.pop(0) if self._frames else None

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        del message, timeout
        raise self._error


def error(classes: int) -> can.Message:
    return can.Message(arbitration_id=classes, is_error_frame=True, data=bytes(8))


def test_each_kind_of_error_is_told_once_and_counted_each_time() -> None:
    port = port_on(Saying(error(0x20), error(0x20), error(0x22)))
    for _ in range(3):
        assert not_none(port.receive(0.0)).is_error_frame
    assert [event.data["kind"] for event in port.take_events()] == ["no_ack", "lost_arbitration"]
    assert port.bus_errors == {"no_ack": 3, "lost_arbitration": 1}
    assert (port.take_events(), port.is_up) == ([], True)


def test_bus_off_takes_the_bus_down_and_is_its_reason() -> None:
    port = port_on(Saying(error(0x40 | 0x8)))
    port.receive(0.0)
    assert (port.is_up, port.last_error) == (False, "the CAN controller is bus-off")


def test_warnings_of_a_bus_are_its_first_events() -> None:
    port = port_on(Saying(warnings=("can0 restarts by itself",)))
    assert [(event.code, event.text) for event in port.take_events()] == [("bus_setting", "can0 restarts by itself")]


@pytest.mark.parametrize("number", [100, 19, 6])
@pytest.mark.parametrize("kind", [OSError, lambda number, text: can.CanOperationError(text, number)])
def test_a_send_to_an_interface_that_is_gone_takes_the_bus_down_at_once(
    number: int, kind: Callable[[int, str], Exception]
) -> None:
    port = port_on(Saying(error=kind(number, "gone")))
    assert port.send(COMMAND_ID, bytes(6), 0.0) is False
    assert not port.is_up


def test_a_bus_without_stamps_has_its_frames_arrive_when_they_are_read() -> None:
    assert port_on(Saying()).arrived_ns(error(0), 123) == 123
