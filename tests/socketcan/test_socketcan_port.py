"""The port on the kernel's own buses: what reaches it, what it says of the link, what it refuses to begin on."""

import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can
import pytest

from hil.edge.can.bus import BusAddress, BusError, BusPort
from hil.edge.can.socketcan import Link, SocketCan
from tests.bus.bus_bench import COMMAND_ID, FOREIGN_ID, IDS, LEVELS_ID, STATUS_ID, frame, next_frame
from tests.narrowing import not_none
from tests.socketcan.kernel_links import BITRATE, Cable, Loop, ip

pytestmark = pytest.mark.socketcan
GOOD = b"\x2a" * 7
W_S = 0.25


def open_port(channel: str) -> BusPort:
    return BusPort(BusAddress("socketcan", channel, BITRATE).open(IDS))


@contextmanager
def ends(links: Loop | Cable) -> Iterator[tuple[BusPort, can.BusABC]]:
    port, far = open_port(links.near), can.Bus(links.far, "socketcan", ignore_config=True)
    try:
        yield port, far
    finally:
        port.close()
        far.shutdown()
        links.plug()


@pytest.fixture
def on_loop(loop: Loop) -> Iterator[tuple[BusPort, can.BusABC]]:
    with ends(loop) as both:
        yield both


def cansend(channel: str, text: str) -> None:
    subprocess.run(["cansend", channel, text], check=True)


def send_error(channel: str, classes: int, detail: int = 0) -> None:
    """An error frame as a driver would report it: class bits, and data[1]."""
    cansend(channel, f"{0x20000000 | classes:08X}#00{detail:02X}000000000000")


def assert_only_ours_comes(port: BusPort) -> None:
    """What was sent before is not let in; a frame of ours is, at once."""
    assert bytes(not_none(next_frame(port)).data) == GOOD
    assert port.receive(0.05) is None
    assert port.is_up


def test_case_12_a_thousand_foreign_frames_are_kept_out_by_the_kernel(on_loop: tuple[BusPort, can.BusABC]) -> None:
    port, far = on_loop
    for _ in range(1000):
        far.send(frame(FOREIGN_ID, bytes(8)))
    far.send(frame(data=GOOD))
    assert_only_ours_comes(port)


@pytest.mark.parametrize("odd", ["extended", "fd"])
def test_case_18_frames_that_are_not_classic_with_11_bits_are_kept_out_by_the_kernel(
    loop: Loop, on_loop: tuple[BusPort, can.BusABC], odd: str
) -> None:
    """The extended frame and the CAN FD frame have the number of one of ours."""
    port, far = on_loop
    if odd == "extended":
        far.send(frame(LEVELS_ID, is_extended_id=True))
    else:
        loop.down()
        ip("link", "set", loop.near, "mtu", 72)
        loop.up()
        port.close()
        port = open_port(loop.near)
        cansend(loop.near, f"{LEVELS_ID:03X}##0{'11' * 7}")
    cansend(loop.near, f"{LEVELS_ID:03X}#{GOOD.hex()}")
    assert_only_ours_comes(port)
    port.close()


def test_case_20_error_frames_are_counted_by_class_each_told_once(
    loop: Loop, on_loop: tuple[BusPort, can.BusABC]
) -> None:
    port, far = on_loop
    for classes, detail in ((0x2, 0), (0x20, 0), (0x4, 0x20), (0x20, 0), (0x88, 0)):
        send_error(loop.near, classes, detail)
    far.send(frame(data=GOOD))
    got = [next_frame(port) for _ in range(6)]
    assert [not_none(one).is_error_frame for one in got] == [True] * 5 + [False], (
        "past filters that name our identifiers only"
    )
    counts = {"lost_arbitration": 1, "no_ack": 2, "error_passive": 1, "protocol_violation": 1, "bus_error": 1}
    assert port.bus_errors == counts
    assert [event.data["kind"] for event in port.take_events()] == list(counts)
    assert port.take_events() == []
    assert port.is_up, "none of them is the end"


def test_case_21_bus_off_is_the_end_of_the_link_and_its_name(loop: Loop, on_loop: tuple[BusPort, can.BusABC]) -> None:
    port, _ = on_loop
    send_error(loop.near, 0x40)
    assert not_none(next_frame(port)).is_error_frame
    assert (port.is_up, port.last_error) == (False, "the CAN controller is bus-off")


def test_case_22_a_link_taken_down_is_noticed_at_once_by_listening(
    loop: Loop, on_loop: tuple[BusPort, can.BusABC]
) -> None:
    port, _ = on_loop
    loop.down()
    started_s = time.monotonic()
    while port.is_up:
        port.receive(0.05)
        assert time.monotonic() - started_s < W_S
    loop.up()
    assert port.receive(0.05) is None
    assert not port.is_up, "stays down until a new run opens it"


def test_case_22_a_link_taken_down_is_noticed_by_the_first_command(
    loop: Loop, on_loop: tuple[BusPort, can.BusABC]
) -> None:
    """Nobody has listened meanwhile; python-can would have to fail three times."""
    port, _ = on_loop
    loop.down()
    assert port.send(COMMAND_ID, bytes(6), 0.0) is False
    assert not port.is_up
    assert port.last_error == f"{loop.near} was taken down"


def test_case_22_a_link_that_was_down_and_up_between_two_commands_is_noticed(
    loop: Loop, on_loop: tuple[BusPort, can.BusABC]
) -> None:
    port, _ = on_loop
    loop.down()
    loop.up()
    assert port.send(COMMAND_ID, bytes(6), 0.0) is False
    assert not port.is_up


def test_case_24_an_interface_that_is_gone_takes_no_command_and_is_no_other_when_it_is_back(
    cable: Cable,
) -> None:
    with ends(cable) as (port, _):
        cable.unplug(cable.near)
        assert port.send(COMMAND_ID, bytes(6), 0.0) is False
        assert not port.is_up
        cable.plug()
        assert port.send(COMMAND_ID, bytes(6), 0.0) is False
        assert port.receive(0.0) is None


@pytest.fixture
def jam(loop: Loop) -> Iterator[Callable[[], subprocess.CompletedProcess[bytes]]]:
    """Lets one frame through and no more: like a bus on which nobody acknowledges."""
    ip_words = f"qdisc replace dev {loop.near} root tbf rate 8bit burst 16b limit 1600b"
    subprocess.run(["tc", *ip_words.split()], check=True)
    yield lambda: subprocess.run(["tc", "qdisc", "replace", "dev", loop.near, "root", "pfifo"], check=True)
    subprocess.run(["tc", "qdisc", "del", "dev", loop.near, "root"], check=False, stderr=subprocess.DEVNULL)


def test_case_23_the_kernels_queue_never_holds_more_than_one_command(
    jam: Callable[[], subprocess.CompletedProcess[bytes]], on_loop: tuple[BusPort, can.BusABC]
) -> None:
    """There is room for a hundred: the second that waits is refused at once, three in a row are a failed bus."""
    port, far = on_loop
    sent = []
    for number in range(8):
        started_s = time.monotonic()
        sent.append(port.send(COMMAND_ID, bytes([number] * 6), 0.0))
        assert time.monotonic() - started_s < 0.1, "a send never waits"
    assert sent == [True, True] + [False] * 6
    assert port.send_failures == 6
    assert not port.is_up
    assert "the last command still waits" in port.last_error
    jam()
    arrived = []
    while (one := far.recv(0.1)) is not None:
        arrived.append(one.data[0])
    assert arrived in ([0], [0, 1]), "no stale command follows"


@pytest.mark.parametrize("bad", ["15 length", "17 identifier", "19 remote"])
def test_case_15_17_19_what_gets_past_the_kernel_is_marked_for_the_receiver(
    loop: Loop, on_loop: tuple[BusPort, can.BusABC], bad: str
) -> None:
    port, far = on_loop
    text = {
        "15 length": f"{LEVELS_ID:03X}#01",
        "17 identifier": "183#11223344556677",
        "19 remote": f"{LEVELS_ID:03X}#R7",
    }
    cansend(loop.near, text[bad])
    far.send(frame(STATUS_ID, GOOD))
    first = not_none(next_frame(port))
    if bad == "17 identifier":
        assert bytes(first.data) == GOOD, "one bit away from ours, and kept out"
    else:
        assert (len(first.data), first.is_remote_frame) == ((1, False) if bad == "15 length" else (0, True))
    assert far.recv(0.05) is not None, "the cansend itself"
    assert far.recv(0.05) is None, "and no reply to it"


def test_frames_have_arrived_when_the_kernel_took_them_in(on_loop: tuple[BusPort, can.BusABC]) -> None:
    """They wait for 0.2 s before somebody looks; their age counts from the first moment."""
    port, far = on_loop
    before_ns = time.monotonic_ns()
    far.send(frame(data=GOOD))
    after_ns = time.monotonic_ns()
    time.sleep(0.2)
    message = not_none(port.receive(0.0))
    arrived_ns = port.arrived_ns(message, time.monotonic_ns())
    assert before_ns - 5_000_000 <= arrived_ns <= after_ns + 5_000_000


def test_case_46_a_wall_clock_that_jumps_makes_no_frame_older_than_the_gap_before_it(
    on_loop: tuple[BusPort, can.BusABC],
) -> None:
    port, far = on_loop
    ages_s = []
    try:
        for jump_s in (0.0, 3600.0, -7200.0, 3600.0):
            far.send(frame(data=GOOD))
            time.clock_settime(time.CLOCK_REALTIME, time.time() + jump_s)
            message = not_none(next_frame(port))
            now_ns = time.monotonic_ns()
            ages_s.append((now_ns - port.arrived_ns(message, now_ns)) * 1e-9)
    finally:
        time.clock_settime(time.CLOCK_REALTIME, time.time())
    assert all(0.0 <= age_s < W_S for age_s in ages_s[1:]), ages_s


def test_case_46_a_wall_clock_set_back_while_nothing_comes_holds_nobody_up(on_loop: tuple[BusPort, can.BusABC]) -> None:
    """A wait that counted on the wall clock would last for an hour."""
    port, _ = on_loop

    def set_back() -> None:
        time.clock_settime(time.CLOCK_REALTIME, time.time() - 3600.0)

    setting = threading.Timer(0.1, set_back)
    started_s = time.monotonic()
    try:
        setting.start()
        assert port.receive(0.3) is None
        assert 0.3 <= time.monotonic() - started_s < 1.3
    finally:
        setting.join()
        time.clock_settime(time.CLOCK_REALTIME, time.time() + 3600.0)


def refusal(channel: str, bitrate: int = BITRATE) -> str:
    with pytest.raises(BusError) as refused:
        BusAddress("socketcan", channel, bitrate).open(IDS)
    text = str(refused.value)
    assert "\n" not in text
    assert f"bus socketcan '{channel}' at {bitrate} bit/s can't be opened: " in text
    return text.partition("opened: ")[2]


def test_an_interface_that_is_missing_is_refused_by_name() -> None:
    assert refusal("can77") == "there is no interface can77"


def test_an_interface_that_is_no_can_is_refused() -> None:
    assert refusal("lo") == "lo is not a CAN interface"


def test_a_link_that_is_down_is_refused_with_what_to_do(loop: Loop) -> None:
    loop.down()
    try:
        assert refusal(loop.near) == f"{loop.near} is down; as root: ip link set {loop.near} up"
    finally:
        loop.up()


def real(cable: Cable) -> None:
    if not cable.is_real:
        pytest.skip("vxcan has no bit rate; the guest's controllers have")


def test_another_bit_rate_is_refused_with_what_to_do(cable: Cable) -> None:
    real(cable)
    up = f"ip link set {cable.near} up type can bitrate 250000"
    assert refusal(cable.near, 250_000) == (
        f"{cable.near} runs at 500000 bit/s; as root: ip link set {cable.near} down; {up}"
    )


def test_a_kernel_that_restarts_after_bus_off_is_told_of_and_left_as_it_is(cable: Cable) -> None:
    real(cable)
    ip("link", "set", cable.near, "down")
    ip("link", "set", cable.near, "up", "type", "can", "bitrate", BITRATE, "restart-ms", 100)
    try:
        port = open_port(cable.near)
        (event,) = port.take_events()
        port.close()
        assert "restarts a bus-off controller automatically after 100 ms" in event.text
        assert Link.read(cable.near).restart_ms == 100
    finally:
        ip("link", "set", cable.near, "down")
        ip("link", "set", cable.near, "up", "type", "can", "bitrate", BITRATE, "restart-ms", 0)


def test_the_kernels_own_receive_filter_is_in_force(on_loop: tuple[BusPort, can.BusABC]) -> None:
    """Not python-can's, which would look at each frame here."""
    port, _ = on_loop
    assert isinstance(port._bus, SocketCan)
    raw = port._bus.socket.getsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, 8 * len(IDS))
    assert {struct.unpack_from("I", raw, 8 * index)[0] for index in range(len(IDS))} == set(IDS)
    assert port._bus._is_filtered
