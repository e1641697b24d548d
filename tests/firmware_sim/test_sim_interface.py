"""The emulator on an interface that goes down, is unplugged, and comes back: on buses that fail as the kernel's do."""

import errno
from collections.abc import Iterator
from typing import cast

import can
import pytest

from firmware_sim.kernel_port import RETRY_NS, InterfacePort
from firmware_sim.rig import Rig
from tests.firmware_sim.sim_bench import MS, shipped

DOWN, GONE, NO_DEVICE = errno.ENETDOWN, errno.ENODEV, errno.ENXIO


class Interface:
    """A bus whose next receive and all sends fail with these errors, if any."""

    def __init__(self, receive: int | None = None, send: int | None = None) -> None:
        self.receive_error, self.send_error = receive, send
        self.sent: list[can.Message] = []
        self.is_open = True

    def fileno(self) -> int:
        return 7

    def recv(self, timeout: float | None = None) -> None:
        del timeout
        if self.receive_error is not None:
            number, self.receive_error = self.receive_error, None
            raise can.CanOperationError("gone", number)

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        del timeout
        if self.send_error is not None:
            raise can.CanOperationError("gone", self.send_error)
        self.sent.append(message)

    def shutdown(self) -> None:
        self.is_open = False


class Bench:
    def __init__(self) -> None:
        self.bus, self.next_bus, self.is_back = Interface(), Interface(), False
        self.error: OSError | None = None
        bus = cast(can.BusABC, self.bus)
        self.port = InterfacePort(Rig(shipped(), (), 1, 0), bus, lambda: self.is_back, self._open)

    def _open(self) -> can.BusABC:
        if self.error is not None:
            raise self.error
        return cast(can.BusABC, self.next_bus)


@pytest.fixture
def bench() -> Iterator[Bench]:
    one = Bench()
    yield one
    one.port.close()


def test_down_and_up_it_is_the_same_interface(bench: Bench) -> None:
    bench.bus.receive_error = bench.bus.send_error = DOWN
    bench.port.step(100 * MS)
    assert bench.port.errors["receive"] == 1
    assert bench.port.errors["send"] > 0
    bench.bus.send_error = None
    bench.port.step(200 * MS)
    assert bench.bus.sent
    assert bench.port.filenos() == [7]
    assert bench.port.reopened == 0


@pytest.mark.parametrize("number", [GONE, NO_DEVICE])
@pytest.mark.parametrize("first", ["receive_error", "send_error"])
def test_unplugged_it_waits_for_ever_and_opens_the_next_one_of_that_name(bench: Bench, number: int, first: str) -> None:
    setattr(bench.bus, first, number)
    bench.port.step(100 * MS)
    assert not bench.bus.is_open
    assert bench.port.filenos() not in ([], [7]), "waited on, or the service would spin"
    for second in (10, 20, 30):
        assert bench.port.read(second * 1000 * MS) is True, "no failure of the rig's"
        bench.port.send(bench.port.rig.advance(second * 1000 * MS))
    assert bench.next_bus.sent == []
    bench.is_back = True
    bench.port.step(30_000 * MS + RETRY_NS)
    assert bench.next_bus.sent
    assert (bench.port.reopened, bench.port.filenos()) == (1, [7])


def test_an_interface_that_can_not_be_opened_yet_is_tried_again(bench: Bench) -> None:
    bench.bus.receive_error = GONE
    bench.port.step(100 * MS)
    bench.is_back, bench.error = True, OSError(errno.ENODEV, "not yet")
    bench.port.step(100 * MS + RETRY_NS)
    assert bench.port.reopened == 0
    bench.error = None
    bench.port.step(100 * MS + 2 * RETRY_NS)
    assert bench.port.reopened == 1
