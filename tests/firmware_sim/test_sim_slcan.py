"""The slcan adapter's line protocol."""

import pytest
from can import Message
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.slcan_port import LINE_MAX, Channel, SlcanPort, parse_frame
from tests.any_frame import frames
from tests.firmware_sim.sim_bench import command

BELL, CR = b"\a", b"\r"


def port_in(state: Channel) -> SlcanPort:
    port = SlcanPort()
    if state is not Channel.CLOSED:
        assert port.feed(b"O\r" if state is Channel.OPEN else b"L\r") == (CR, [])
    assert port.channel is state
    return port


CLOSED, OPEN, LISTEN = Channel
GOOD = b"t2016983A204E1106"


@pytest.mark.parametrize(
    ("line", "replies", "states"),
    [
        (b"C", (BELL, CR, CR), (CLOSED, CLOSED, CLOSED)),
        (b"O", (CR, BELL, BELL), (OPEN, OPEN, LISTEN)),
        (b"L", (CR, BELL, BELL), (LISTEN, OPEN, LISTEN)),
        (b"S6", (CR, BELL, BELL), (CLOSED, OPEN, LISTEN)),
        (b"S0", (CR, BELL, BELL), (CLOSED, OPEN, LISTEN)),
        (b"S9", (BELL, BELL, BELL), (CLOSED, OPEN, LISTEN)),
        (b"S", (BELL, BELL, BELL), (CLOSED, OPEN, LISTEN)),
        (b"s001C", (CR, BELL, BELL), (CLOSED, OPEN, LISTEN)),
        (b"s00XY", (BELL, BELL, BELL), (CLOSED, OPEN, LISTEN)),
        (b"Z0", (CR, BELL, BELL), (CLOSED, OPEN, LISTEN)),
        (b"Z1", (CR, BELL, BELL), (CLOSED, OPEN, LISTEN)),
        (b"V", (b"V1013\r",) * 3, (CLOSED, OPEN, LISTEN)),
        (b"N", (b"NFT01\r",) * 3, (CLOSED, OPEN, LISTEN)),
        (b"F", (BELL, b"F00\r", b"F00\r"), (CLOSED, OPEN, LISTEN)),
        (b"", (CR, CR, CR), (CLOSED, OPEN, LISTEN)),
        (b"?", (BELL, BELL, BELL), (CLOSED, OPEN, LISTEN)),
        (b"OO", (BELL, BELL, BELL), (CLOSED, OPEN, LISTEN)),
        (GOOD, (BELL, b"z\r", BELL), (CLOSED, OPEN, LISTEN)),
        (b"T000002010", (BELL, b"Z\r", BELL), (CLOSED, OPEN, LISTEN)),
        (b"r2018", (BELL, b"z\r", BELL), (CLOSED, OPEN, LISTEN)),
        (b"R1FFFFFFF0", (BELL, b"Z\r", BELL), (CLOSED, OPEN, LISTEN)),
    ],
)
def test_every_command_in_every_state(
    line: bytes, replies: tuple[bytes, bytes, bytes], states: tuple[Channel, Channel, Channel]
) -> None:
    for state, reply, after in zip(Channel, replies, states, strict=True):
        port = port_in(state)
        assert port.feed(line + CR)[0] == reply
        assert port.channel is after


@pytest.mark.parametrize(
    "line",
    [
        b"t",
        b"t20",
        b"t201",
        b"t2016",
        b"t2016983A204E11",
        b"t2016983A204E110",
        b"t2016983A204E110600",
        b"t201600000000000G",
        b"t20190000000000000000000",
        b"t201F",
        b"t8000",
        b"t-010",
        b"t+1_0",
        b"t 010",
        b"T200000000",
        b"T000201",
        b"r2019",
        b"r201100",
        b"t201100\n",
        b"d2011000",
        b"t20\xb1100",
        b"\xff\xfe",
    ],
)
def test_garbage_is_refused_and_nothing_reaches_the_bus(line: bytes) -> None:
    port = port_in(OPEN)
    assert port.feed(line + CR) == (BELL, [])
    reply, frames = port.feed(GOOD + CR)
    assert reply == b"z\r"
    assert len(frames) == 1


def test_a_command_frame_arrives_as_it_was_sent() -> None:
    sent = command(3.0, 4.0, counter=1)
    _, [frame] = port_in(OPEN).feed(GOOD + CR)
    assert frame.equals(sent, timestamp_delta=None, check_direction=False)


@pytest.mark.parametrize("cut", range(1, 40))
def test_lines_may_come_split_and_joined(cut: int) -> None:
    data = b"S6\rO\r" + GOOD + b"\r\r" + GOOD + b"\rC\r" + GOOD + CR
    port = SlcanPort()
    replies, frames = b"", []
    for start in range(0, len(data), cut):
        reply, more = port.feed(data[start : start + cut])
        replies += reply
        frames += more
    assert replies == b"\r\rz\r\rz\r\r\a"
    assert len(frames) == 2


def test_a_line_without_end_is_capped_and_refused_once() -> None:
    port = port_in(OPEN)
    for _ in range(5000):
        assert port.feed(b"t" * 100) == (b"", [])
        assert len(port._line) <= LINE_MAX
    assert port.feed(CR) == (BELL, [])
    assert port.feed(GOOD + CR)[0] == b"z\r"


@pytest.mark.parametrize(("length", "is_kept"), [(LINE_MAX, True), (LINE_MAX + 1, False)])
def test_buffer_holds_exactly_its_limit(length: int, is_kept: bool) -> None:
    port = SlcanPort()
    port.feed(b"x" * length)
    assert (len(port._line) == length) is is_kept


def test_frames_reach_the_host_only_while_the_channel_is_open() -> None:
    frame = command(3.0, 4.0, counter=1)
    assert port_in(CLOSED).frame_line(frame) == b""
    for state in (OPEN, LISTEN):
        port = port_in(state)
        assert port.frame_line(frame) == GOOD + CR
        port.feed(b"C\r")
        assert port.frame_line(frame) == b""


def test_time_stamps_are_four_hex_digits_of_milliseconds_within_a_minute() -> None:
    port = SlcanPort()
    port.feed(b"Z1\rO\r")
    frame = Message(arbitration_id=0x181, is_extended_id=False, data=b"\xab", timestamp=61.234)
    assert port.frame_line(frame) == b"t1811AB04D2\r"


@pytest.mark.parametrize("state", Channel)
@given(st.lists(st.binary(max_size=80) | st.sampled_from([b"O\r", b"C\r", b"L\r", GOOD + CR, b"t201", CR])))
def test_no_bytes_ever_raise_and_the_buffer_stays_bounded(state: Channel, chunks: list[bytes]) -> None:
    """It used to begin with a closed channel alone, which next to no drawn stream opens: no frame was looked at."""
    port = port_in(state)
    for chunk in chunks:
        reply, frames = port.feed(chunk)
        assert reply.count(CR) + reply.count(BELL) == chunk.count(CR)
        assert all(frame.dlc <= 8 for frame in frames)
        assert len(port._line) <= LINE_MAX


@given(st.binary(max_size=60))
def test_no_reply_looks_like_a_frame(data: bytes) -> None:
    """python-can takes any line that begins with one of these letters for a frame."""
    reply, _ = port_in(OPEN).feed(data + CR)
    for line in reply.replace(BELL, BELL + CR).split(CR):
        assert line[:1] not in (b"t", b"T", b"r", b"R", b"d", b"D", b"b", b"B", b"x")


@given(frames())
def test_frames_round_trip(frame: Message) -> None:
    line = port_in(OPEN).frame_line(frame)
    assert line.endswith(CR)
    parsed = parse_frame(line[:-1])
    assert parsed is not None
    assert parsed.equals(frame, timestamp_delta=None, check_direction=False)
    assert parse_frame(line[:-1].lower().replace(b"t", line[:1], 1).replace(b"r", line[:1], 1)) is not None


def test_error_and_fd_frames_do_not_reach_the_host() -> None:
    port = port_in(OPEN)
    assert port.frame_line(Message(is_error_frame=True)) == b""
    assert port.frame_line(Message(is_fd=True)) == b""
