"""What the control loop may rely on of a bus: a virtual one, slcan over TCP, slcan over a pty, the kernel's."""

import time
from collections.abc import Callable, Iterator

import pytest

from tests.bus.bus_bench import (
    COMMAND_ID,
    FOREIGN_ID,
    IDS,
    LEVELS_ID,
    STATUS_ID,
    SlcanFar,
    VirtualFar,
    closing,
    frame,
    next_frame,
)
from tests.narrowing import not_none
from tests.socketcan.kernel_links import KernelFar
from tests.waiting import fastest_s, wait_for

Far = VirtualFar | SlcanFar | KernelFar
FARS: dict[str, Callable[[pytest.FixtureRequest], Far]] = {
    "virtual": lambda request: VirtualFar(request.node.name),
    "slcan over TCP": lambda _: SlcanFar.on_tcp(),
    "slcan over a pty": lambda _: SlcanFar.on_pty(),
    "vcan": lambda request: KernelFar(request.getfixturevalue("loop"), IDS),
    "two controllers": lambda request: KernelFar(request.getfixturevalue("cable"), IDS),
}
KERNEL = ("vcan", "two controllers")


@pytest.fixture(
    params=[
        pytest.param(make, id=name, marks=[pytest.mark.socketcan] * (name in KERNEL)) for name, make in FARS.items()
    ]
)
def far(request: pytest.FixtureRequest) -> Iterator[Far]:
    with closing(request.param(request)) as one:
        yield one


def test_frames_come_whole_and_in_order(far: Far) -> None:
    sent = [frame(data=bytes([number, 0, 255, 13, 7, 10, 65])) for number in range(20)]
    far.send(*sent)
    got = [next_frame(far.port) for _ in sent]
    assert [(not_none(m).arbitration_id, bytes(not_none(m).data)) for m in got] == [
        (LEVELS_ID, bytes(m.data)) for m in sent
    ]
    assert not any(not_none(m).is_extended_id or not_none(m).is_remote_frame or not_none(m).is_error_frame for m in got)


@pytest.mark.parametrize("length", [0, 1, 6, 8])
def test_payloads_of_every_length_pass_both_ways(far: Far, length: int) -> None:
    data = bytes(range(200, 200 + length))
    far.send(frame(STATUS_ID, data))
    assert bytes(not_none(next_frame(far.port)).data) == data
    assert far.port.send(COMMAND_ID, data, 0.0) is True
    (arrived,) = far.received(1)
    assert arrived is not None
    assert (arrived.arbitration_id, bytes(arrived.data), arrived.is_extended_id) == (COMMAND_ID, data, False)


def test_commands_arrive_in_order_each_once(far: Far) -> None:
    payloads = [bytes([number, 1, 2, 3, 4, 5]) for number in range(30)]
    assert all(far.port.send(COMMAND_ID, data, 0.0) for data in payloads)
    assert [bytes(not_none(m).data) for m in far.received(30)] == payloads
    assert far.port.send_failures == 0


def test_a_command_does_not_come_back_to_its_sender(far: Far) -> None:
    far.port.send(COMMAND_ID, bytes(6), 0.0)
    far.received(1)
    assert far.port.receive(0.05) is None


def test_foreign_and_extended_frames_are_kept_out(far: Far) -> None:
    """The extended frame has the number of one of ours."""
    far.send(frame(FOREIGN_ID), frame(LEVELS_ID, is_extended_id=True), frame(LEVELS_ID, b"\x2a" * 7))
    assert bytes(not_none(next_frame(far.port)).data) == b"\x2a" * 7
    assert far.port.receive(0.05) is None
    assert far.port.is_up


def test_somebody_elses_command_is_let_in_so_that_it_can_be_noticed(far: Far) -> None:
    far.send(frame(COMMAND_ID, bytes(6)))
    assert not_none(next_frame(far.port)).arbitration_id == COMMAND_ID


def test_a_remote_frame_is_marked_as_one(far: Far) -> None:
    far.send(frame(LEVELS_ID, b"", is_remote_frame=True, dlc=getattr(far, "remote_length", 7)))
    assert not_none(next_frame(far.port)).is_remote_frame


def test_a_quiet_bus_is_no_failure(far: Far) -> None:
    started_s = time.monotonic()
    assert far.port.receive(0.05) is None
    assert time.monotonic() - started_s > 0.03
    assert fastest_s(lambda: far.port.receive(0.05)) < 0.5
    assert fastest_s(far.port.waiting) < 0.05
    assert far.port.waiting() == []
    assert (far.port.is_up, far.port.receive_failures, far.port.last_error) == (True, 0, "")


def test_waiting_returns_what_has_come_so_far(far: Far) -> None:
    far.send(*[frame() for _ in range(12)])
    seen = []

    def has_come() -> bool:
        seen.extend(far.port.waiting())
        return len(seen) >= 12

    wait_for(has_come)
    assert len(seen) == 12
    assert far.port.waiting() == []


def test_a_link_that_is_gone_is_down_and_nothing_raises(far: Far) -> None:
    far.send(frame())
    assert next_frame(far.port) is not None
    far.vanish()
    deadline_s = time.monotonic() + 2.0
    while far.port.is_up and time.monotonic() < deadline_s:
        far.port.receive(0.01)
        far.port.send(COMMAND_ID, bytes(6), 0.0)
    assert not far.port.is_up
    assert far.port.last_error
    assert far.port.receive(0.01) is None
    assert far.port.waiting() == []
    assert far.port.send(COMMAND_ID, bytes(6), 0.0) is False
    assert not far.port.is_up, "it must not come back by itself"
    far.port.close()
    far.port.close()


def test_a_link_that_is_gone_is_noticed_by_reading_alone(far: Far) -> None:
    far.vanish()
    deadline_s = time.monotonic() + 2.0
    while far.port.is_up and time.monotonic() < deadline_s:
        far.port.receive(0.01)
    assert not far.port.is_up
