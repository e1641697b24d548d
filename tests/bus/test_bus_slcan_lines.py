"""The pure part of slcan: any bytes, cut anywhere, give the same frames and counts, and nothing ever raises."""

import pytest
from can import Message
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.edge.can.slcan_lines import MAX_LINE_BYTES, LineReader, Reject, frame_line, parse_frame
from tests.any_frame import frames
from tests.bus.bus_bench import GARBAGE
from tools.fuzz import targets

GOOD = b"t18271122334455667F\r"
REJECTED = {
    Reject.GARBLED: [b"t18\xff7", b"\x00", b"t1820\x0b", b"t18\t", b"\x7f"],
    Reject.UNKNOWN: [b"x182", b"u18271122334455667F", b" t1820", b"-", b"OK", b"z1"],
    Reject.IDENTIFIER: [b"t", b"t18", b"t8000", b"t-110", b"t+110", b"t0x10", b"t 820", b"T2000000000", b"T0001820"],
    Reject.LENGTH: [b"t182", b"t1829", b"t182F11", b"t182-", b"R00000182", b"T00000182A"],
    Reject.PAYLOAD: [
        b"t1821",
        b"t18211",
        b"t1821111",
        b"t1821111111111",
        b"t18211_",
        b"t1821+1",
        b"t1821 1",
        b"t1820F",
        b"r182411",
        b"T00000182711",
    ],
    Reject.FD: [b"d18281122334455667788", b"D0000018281122334455667788", b"b1828", b"B000001828"],
    Reject.ENDLESS: [b"t" * (MAX_LINE_BYTES + 1), b"V" + b"1" * MAX_LINE_BYTES],
}
BITS = st.binary(max_size=40) | st.sampled_from(
    [
        GOOD,
        b"\r",
        b"\a",
        b"z\r",
        b"t",
        b"t1821",
        b"11\r",
        b"A" * 700,
        *(line + b"\r" for line in REJECTED[Reject.LENGTH]),
    ]
)
STREAMS = st.lists(BITS, max_size=40).map(b"".join)


def told(frame: Message | None) -> tuple[int, bool, bool, int, bytes]:
    assert frame is not None
    return (frame.arbitration_id, frame.is_extended_id, frame.is_remote_frame, frame.dlc, bytes(frame.data))


@pytest.mark.parametrize(("cause", "line"), [(cause, line) for cause, lines in REJECTED.items() for line in lines])
def test_what_is_no_frame_is_dropped_by_its_cause_and_the_next_one_taken(cause: Reject, line: bytes) -> None:
    reader = LineReader()
    assert [told(frame) for frame in reader.feed(line + b"\r" + GOOD)] == [told(parse_frame(GOOD[:-1]))]
    assert dict(reader.rejected) == {cause: 1}


@pytest.mark.parametrize("garbage", GARBAGE.values(), ids=GARBAGE.keys())
def test_garbage_costs_neither_the_frame_before_nor_the_one_after(garbage: bytes) -> None:
    assert len(LineReader().feed(GOOD + garbage + GOOD)) == 2


def test_answers_and_refusals_are_counted() -> None:
    reader = LineReader()
    assert reader.feed(b"\rz\rZ\r\a\a\a\rV1013\rNFT01\rF00\r") == []
    assert (reader.done, reader.refused, reader.texts, dict(reader.rejected)) == (4, 3, 3, {})
    reader.reset_counts()
    assert (reader.done, reader.refused, reader.texts) == (0, 0, 0)


def test_a_refusal_between_two_frames_costs_neither() -> None:
    reader = LineReader()
    assert len(reader.feed(GOOD + b"\a" + GOOD)) == 2
    assert (reader.refused, dict(reader.rejected)) == (1, {})


def test_a_refusal_within_a_line_cuts_it_off() -> None:
    reader = LineReader()
    assert reader.feed(GOOD[:6] + b"\a" + GOOD[6:]) == []
    assert reader.refused == 1
    assert reader.rejected == {Reject.GARBLED: 1, Reject.UNKNOWN: 1}


@pytest.mark.parametrize("size", [1, 100, 5000])
@pytest.mark.parametrize("end", [b"\r", b"\a"])
def test_an_endless_line_ends_at_either_end_and_costs_no_other(size: int, end: bytes) -> None:
    stream, reader, got = GOOD + b"A" * 3000 + end + GOOD + GOOD, LineReader(), []
    for start in range(0, len(stream), size):
        got += reader.feed(stream[start : start + size])
    assert len(got) == 3
    assert (dict(reader.rejected), reader.refused) == ({Reject.ENDLESS: 1}, end == b"\a")


@pytest.mark.parametrize("stamp", [b"0000", b"EA5f"])
def test_an_adapters_time_stamp_is_not_looked_at(stamp: bytes) -> None:
    for line in (GOOD[:-1], b"r1824", b"T1FFFFFFF0"):
        assert told(parse_frame(line + stamp)) == told(parse_frame(line))
        assert parse_frame(line + stamp + b"00") is None
        assert parse_frame(line + stamp[:3]) is None


@given(frames())
def test_frames_round_trip_in_either_case(frame: Message) -> None:
    line = frame_line(frame)
    assert told(parse_frame(line[:-1])) == told(frame)
    assert told(parse_frame(line[:1] + line[1:-1].lower())) == told(frame)


@given(frames())
def test_what_the_emulators_adapter_says_is_understood(frame: Message) -> None:
    """The twins have nothing in common but the protocol."""
    from firmware_sim.slcan_port import SlcanPort

    adapter = SlcanPort()
    adapter.feed(b"O\r")
    (got,) = LineReader().feed(adapter.frame_line(frame))
    assert told(got) == told(frame)
    _, (sent,) = adapter.feed(frame_line(frame))
    assert told(sent) == told(frame)


@pytest.mark.parametrize("frame", [Message(is_fd=True), Message(is_error_frame=True)])
def test_what_the_protocol_has_no_words_for_is_not_sent(frame: Message) -> None:
    with pytest.raises(ValueError, match="slcan has neither"):
        frame_line(frame)


@given(STREAMS, st.integers(0, 255))
def test_any_stream_in_any_cut_gives_the_same_frames_and_counts(stream: bytes, size: int) -> None:
    """Also: at most 1 kB is kept, every refusal is counted, and each accepted frame comes back as it was."""
    targets.slcan(bytes((size,)) + stream)


ENDS = st.sampled_from([b"\r", b"\n", b"\r\n"])
LINES = st.binary(max_size=30).filter(lambda line: not {10, 13} & set(line)) | st.sampled_from(
    [
        b"",
        b"z",
        b"Z",
        b"\a",
        b"V1013",
        GOOD[:-1],
        b"t1821",
        b"T000001232AABB",
        *(bad for bad in REJECTED[Reject.PAYLOAD]),
    ]
)


def counts(reader: LineReader) -> tuple[int, int, int, dict[Reject, int], int]:
    return (reader.done, reader.refused, reader.texts, dict(reader.rejected), reader.kept)


@given(st.lists(st.tuples(LINES, ENDS), max_size=40), st.data())
def test_any_end_of_line_in_any_cut_gives_the_same_frames_and_counts(
    lines: list[tuple[bytes, bytes]], data: st.DataObject
) -> None:
    """An adapter that ends received frames with CR LF, or all lines with LF, used to have every frame rejected.

    Each line has an end of its own. CR before an empty line with LF is the one stream that has two meanings, and is
    CR LF by the rule; such a line gets CR LF as its end instead.
    """
    stream, before = b"", b""
    for line, end in lines:
        is_ambiguous = before == b"\r" and line == b"" and end == b"\n"
        before = b"\r\n" if is_ambiguous else end
        stream += line + before
    plain, cut = LineReader(), LineReader()
    expected = [told(frame) for line, _ in lines for frame in plain.feed(line + b"\r")]
    got, rest = [], stream
    while rest:
        size = data.draw(st.integers(1, len(rest)), label="bytes of the next read")
        got += [told(frame) for frame in cut.feed(rest[:size])]
        rest = rest[size:]
    assert got == expected
    assert counts(cut) == counts(plain)


@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n"])
@pytest.mark.parametrize("size", [1, 2, 3, 1000])
def test_each_acknowledgement_counts_once_whatever_its_end(end: bytes, size: int) -> None:
    stream = end.join([b"z", b"", b"Z", b"", b"", b""])
    reader = LineReader()
    for start in range(0, len(stream), size):
        reader.feed(stream[start : start + size])
    assert (reader.done, reader.texts, dict(reader.rejected)) == (5, 0, {})


@given(st.binary(max_size=3000))
@settings(max_examples=50)
def test_any_bytes_at_all_give_the_same_frames_in_any_cut(data: bytes) -> None:
    targets.slcan(data)


@given(st.lists(st.tuples(BITS, st.lists(frames(), max_size=3))))
def test_good_lines_are_taken_wherever_garbage_ends(parts: list[tuple[bytes, list[Message]]]) -> None:
    """Each piece of garbage is followed by an end of line, as the adapter's next answer would bring it."""
    reader = LineReader()
    for garbage, good in parts:
        reader.feed(garbage + b"\r")
        got = reader.feed(b"".join(frame_line(frame) for frame in good))
        assert [told(frame) for frame in got] == [told(frame) for frame in good]


def test_a_line_of_just_the_longest_length_is_kept_and_one_byte_more_is_not() -> None:
    for length, is_kept in ((MAX_LINE_BYTES, True), (MAX_LINE_BYTES + 1, False)):
        reader = LineReader()
        reader.feed(b"A" * length)
        assert (reader.kept == length) is is_kept
        assert reader.rejected.total() == (not is_kept)


@given(st.lists(st.tuples(st.integers(0, 255), st.integers(0, 255), st.integers(0, 255), st.binary(max_size=8))))
def test_any_frames_leave_the_receiver_sane(parts: list[tuple[int, int, int, bytes]]) -> None:
    """Never an exception, each frame counted once, no level said to be valid that isn't in range."""
    targets.wire(b"".join(bytes((which, how, wait, len(data))) + data for which, how, wait, data in parts))


@given(STREAMS, st.integers(0, 255))
def test_any_stream_gets_an_answer_a_line_from_the_emulators_adapter(stream: bytes, size: int) -> None:
    targets.adapter(bytes((size,)) + stream)
