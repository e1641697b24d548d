"""The cases that make sense on an slcan adapter, each over a TCP port and over a pty, in lockstep.

Where a case is the same on any bus, it is the very test of that case that is run, with its bounds. Two processes in
real time, for cases 24, 28 and 47 to 50, are in tests/live; adapters that answer oddly at the start, in tests/bus.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from functools import partial

import pytest

from firmware_sim import frames as node
from hil.edge.can.slcan_lines import MAX_LINE_BYTES, LineReader, frame_line
from hil.wire.command_sender import CommandSender
from hil.wire.receiver import Receiver
from tests.bus.bus_bench import GARBAGE
from tests.faults import slcan_bench
from tests.faults import test_faults_bus as of_bus
from tests.faults import test_faults_frames as of_frames
from tests.faults import test_faults_nodes as of_nodes
from tests.faults import test_faults_process as of_process
from tests.faults.faults_bench import (
    OFF,
    RX_S,
    T_S,
    TIME_TOLERANCE_S,
    W_S,
    Run,
    assert_no_trip,
    assert_safe,
    assert_tripped,
    contract,
    fault,
    plain,
    play,
    scenario_data,
)

OVER = {"tcp": slcan_bench.over_tcp, "pty": slcan_bench.over_pty}
AT_S = 5.0


@pytest.fixture(params=OVER, autouse=True)
def line(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[slcan_bench.Line]:
    """An slcan line, on which the tests of the other files play, too. A test that has not used it has shown nothing."""
    made = slcan_bench.Line(OVER[request.param])
    for module in (of_bus, of_frames, of_nodes, of_process):
        monkeypatch.setattr(module, "play", made.play)
    yield made
    if request.function is test_case_10_every_one_bit_flip_of_a_line:
        return  # reads lines only
    assert made.opened > 0, "the case was not played over the line"
    assert made.commands > 0, "no command went over the line"
    assert made.delivered > 0, "nothing came back over the line"


pty_every_day = pytest.mark.parametrize("line", [pytest.param("tcp", marks=pytest.mark.long), "pty"], indirect=True)
"""For cases that are the same on any bus: over TCP with the long tests, but for cases 1, 5 and 12."""


def counts(line: slcan_bench.Line) -> dict[str, int]:
    """What the line has counted, but for zeros."""
    return {name: number for name, number in line.host.counts.items() if number}


def test_a_run_over_a_line_is_the_same_to_the_bit(line: slcan_bench.Line) -> None:
    run = line.play(scenario_data(fault("frame_loss", 2.0, "LowerLevels", 0.2)))
    assert run.ticks == play(scenario_data(fault("frame_loss", 2.0, "LowerLevels", 0.2))).ticks
    assert counts(line) == {}


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
@pytest.mark.parametrize("which", ["frames", "all lines"])
def test_a_run_over_an_adapter_with_other_line_ends_is_the_same_to_the_bit(
    line: slcan_bench.Line, end: bytes, which: str
) -> None:
    """Every received frame used to be rejected, and the rig was never ready: "levels are too old"."""

    def other_end(text: bytes) -> bytes:
        return text.replace(b"\r", end)

    def on_step(t_s: float) -> None:
        del t_s
        line.far.garble = other_end
        if which == "all lines":
            line.far.answer_end = other_end

    assert line.play(scenario_data(), on_step=on_step).ticks == plain().ticks
    assert counts(line) == {}


@pytest.mark.parametrize("frame", ["LowerLevels", "PumpStatus", "PumpCommand"])
def test_case_01_one_frame_lost(frame: str) -> None:
    of_frames.test_case_01_one_frame_lost(frame)


@pty_every_day
def test_case_02_random_loss() -> None:
    of_frames.test_case_02_random_loss(1)


@pty_every_day
@pytest.mark.parametrize("count", [5, 20])
def test_case_03_burst_lost(count: int) -> None:
    of_frames.test_case_03_burst_lost("UpperLevels", count)


@pty_every_day
def test_case_03_burst_of_commands_lost() -> None:
    of_frames.test_case_03_burst_of_commands_lost(3)


@pty_every_day
@pytest.mark.parametrize("count", [15, 16, 32])
def test_case_04_burst_that_wraps_the_counter(count: int) -> None:
    of_frames.test_case_04_burst_that_wraps_the_counter("LowerLevels", count)


def test_case_05_duplicate() -> None:
    of_frames.test_case_05_duplicate()


@pty_every_day
@pytest.mark.parametrize("frame", ["LowerLevels", "PumpCommand"])
def test_case_06_reordered(frame: str) -> None:
    of_frames.test_case_06_reordered(frame)


@pty_every_day
def test_case_07_delayed_less_than_the_limit() -> None:
    of_frames.test_case_07_delayed_less_than_the_limit("LowerLevels", 0.25)


@pty_every_day
def test_case_08_delayed_more_than_the_limit() -> None:
    of_frames.test_case_08_delayed_more_than_the_limit("PumpStatus")


@pty_every_day
@pytest.mark.parametrize("frame", ["UpperLevels", "PumpCommand"])
def test_case_09_crc_wrong_once(frame: str) -> None:
    of_frames.test_case_09_crc_wrong_once(frame)


@pty_every_day
def test_case_09_crc_wrong_five_times() -> None:
    of_frames.test_case_09_crc_wrong_five_times("LowerLevels")


def test_case_10_every_one_bit_flip_of_a_line(line: slcan_bench.Line) -> None:
    """Each bit of each character: refused by line or wire, or the same frame in the other case; the next is taken."""
    del line  # of bytes alone
    payload = node.pack_levels(node.LOWER_LEVELS_ID, (6.2, 6.4), (node.ChannelStatus.OK,) * 2, 3)
    good = frame_line(node.Frame(0.0, node.LOWER_LEVELS_ID, is_extended_id=False, data=payload))
    for bit in range(8 * len(good)):
        flipped = bytearray(good)
        flipped[bit // 8] ^= 1 << bit % 8
        receiver, reader = Receiver(contract(), CommandSender(contract()), (0.0, 10.24)), LineReader()
        taken = [frame for frame in reader.feed(bytes(flipped) + good) if receiver.take(frame, 0) is None]
        assert all((frame.arbitration_id, bytes(frame.data)) == (0x182, payload) for frame in taken)
        assert receiver.rejections.total() + reader.rejected.total() + reader.refused + reader.texts >= 1
        is_end_lost = bit // 8 == len(good) - 1  # it takes the next line with it
        assert len(taken) == (0 if is_end_lost else 1), bytes(flipped)


@pty_every_day
def test_case_11_counter_stuck() -> None:
    of_frames.test_case_11_counter_stuck("LowerLevels")


@pty_every_day
def test_case_11_counter_of_commands_stuck() -> None:
    of_frames.test_case_11_counter_of_commands_stuck()


def test_case_12_babbling_node_of_a_foreign_id() -> None:
    of_bus.test_case_12_babbling_node_of_a_foreign_id()


@pty_every_day
def test_case_13_babbling_node_of_top_priority() -> None:
    of_bus.test_case_13_babbling_node_of_top_priority()


@pty_every_day
def test_case_14_foreign_command() -> None:
    of_bus.test_case_14_foreign_command(3.0)


@pty_every_day
@pytest.mark.parametrize("frame", ["LowerLevels", "PumpCommand"])
def test_case_15_wrong_length(frame: str) -> None:
    of_frames.test_case_15_wrong_length(frame)


def _without(cut: int, text: bytes) -> bytes:
    """A line whose last digits are missing."""
    return text[: -1 - cut] + b"\r"


def _with(byte: bytes, at: int, text: bytes) -> bytes:
    return text[:at] + byte + text[at:]


def play_with(line: slcan_bench.Line, changes: Iterable[Callable[[bytes], bytes]]) -> Run:
    """A run in which a level frame's line is changed every 0.3 s from AT_S on, by one change after the other."""
    left = [(AT_S + 0.3 * number, change) for number, change in enumerate(changes)]
    due: list[Callable[[bytes], bytes]] = []

    def garble(text: bytes) -> bytes:
        return due.pop()(text) if due and text.startswith(b"t1827") else text

    def on_step(t_s: float) -> None:
        line.far.garble = garble
        if left and t_s >= left[0][0]:
            due.append(left.pop(0)[1])

    run = line.play(scenario_data(), on_step=on_step)
    assert not left
    assert not due
    return run


def test_case_16_payload_shorter_than_its_length(line: slcan_bench.Line) -> None:
    """1, 2, 4, 13 or 14 digits are missing: such a frame is dropped, nothing raises, no trip."""
    cuts = (1, 2, 4, 13, 14)
    run = play_with(line, [partial(_without, cut) for cut in cuts])
    assert_no_trip(run)
    assert run.outcome.frames_lost == len(cuts)
    assert counts(line) == {"rejected_payload": len(cuts)}


@pty_every_day
def test_case_17_wrong_id_or_data_id() -> None:
    of_frames.test_case_17_wrong_id_or_data_id()


@pty_every_day
@pytest.mark.parametrize("kind", ["extended_id", "remote_frame"])
@pytest.mark.parametrize("frame", ["LowerLevels", "PumpCommand"])
def test_case_18_19_extended_and_remote_frames(frame: str, kind: str) -> None:
    of_frames.test_case_18_19_extended_and_remote_frames(frame, kind)


def test_case_20_error_frames_can_not_be_said(line: slcan_bench.Line) -> None:
    """slcan has no words for them: a storm changes nothing, and the ages still watch over what comes."""
    run = line.play(scenario_data(fault("error_frames", AT_S, None, 200.0)))
    assert_no_trip(run)
    assert counts(line) == {}


@pty_every_day
def test_case_21_bus_off() -> None:
    of_bus.test_case_21_bus_off()


def assert_stays_safe(line: slcan_bench.Line, run: Run) -> None:
    """Another run on another line is not armed by itself; only when the trip is cleared on purpose."""
    again = line.play(scenario_data(duration_s=5.0, rig={"safety": {"arm_timeout_s": 2.0}}), emulator=run.emulator)
    assert again.outcome.status == "failed"
    assert "tripped" in again.outcome.reason
    assert again.emulator.pump.applied_V == OFF
    cleared = line.play(scenario_data(duration_s=5.0), emulator=again.emulator, clear_trip=True, checks=False)
    assert cleared.outcome.status == "complete"


def test_case_22_adapter_boots_in_the_midst_of_a_run(line: slcan_bench.Line) -> None:
    """Its channel is closed then: no frame comes, each command is refused; never opened again behind our back."""
    run = line.play(scenario_data(duration_s=30.0), on_step=line.at(AT_S, lambda far: far.boot()))
    assert_tripped(run, AT_S, RX_S + T_S, "stale_levels", "stale_status", "node_lost", "node_tripped")
    assert_safe(run, AT_S)
    assert counts(line)["refused"] > 3
    assert_stays_safe(line, run)


def test_case_23_transmit_queue_full(line: slcan_bench.Line) -> None:
    """The adapter refuses (BELL) what its queue has no room for: dropped for good, trip within 3 T, safe within W."""
    run = line.play(scenario_data(duration_s=30.0), on_step=line.at(AT_S, lambda far: setattr(far, "refuses", True)))
    assert_tripped(run, AT_S, T_S + 3 * T_S, "node_tripped", "echo_missing")
    assert_safe(run, AT_S)
    commands = [t_s for t_s, _ in run.keeper.sent if t_s > run.start_s + AT_S - TIME_TOLERANCE_S]
    assert counts(line) == {"refused": len(commands) - 1}, "each but the very last, whose answer nobody waits for"


def test_case_24_adapter_unplugged_and_plugged_again(line: slcan_bench.Line) -> None:
    """The line breaks: trip in the step that sees it, safe within W; on a new line nothing moves until cleared."""
    run = line.play(scenario_data(duration_s=30.0), on_step=line.at(AT_S, lambda far: far.unplug()))
    assert_tripped(run, AT_S, T_S, "bus_failed")
    assert_safe(run, AT_S, W_S)
    assert run.outcome.t_s - AT_S <= 5.0
    assert_stays_safe(line, run)


def test_case_25_any_garbage_between_two_lines(line: slcan_bench.Line) -> None:
    """Bytes beyond ASCII and all else that a line may bring: the next frame is received, and not one is lost."""
    left = list(GARBAGE.values())

    def on_step(t_s: float) -> None:
        if left and t_s >= AT_S:
            line.far.say(left.pop())

    run = line.play(scenario_data(), on_step=on_step)
    assert_no_trip(run)
    assert not left
    assert run.outcome.frames_lost == 0
    assert run.ticks == plain().ticks


@pytest.mark.parametrize("byte", [b"\xff", b"\x00", b"\n", b"\a"])
def test_case_25_a_byte_in_the_midst_of_a_line(line: slcan_bench.Line, byte: bytes) -> None:
    """Such a frame is lost for good, the next one is received."""
    places = (1, 3, 10)
    run = play_with(line, [partial(_with, byte, at) for at in places])
    assert_no_trip(run)
    assert run.outcome.frames_lost == len(places)
    assert max(tick.levels_age_s for tick in run.ticks) <= RX_S


def test_case_25_nothing_but_garbage_trips_on_age(line: slcan_bench.Line) -> None:
    """Every line is spoilt: the link is up, nothing of ours comes, and the ages trip."""
    spoilt = line.at(AT_S, lambda far: setattr(far, "garble", lambda text: text[:2] + b"\xff" + text[3:]))
    run = line.play(scenario_data(duration_s=30.0), on_step=spoilt)
    assert_tripped(run, AT_S, RX_S + T_S, "stale_levels", "stale_status", "node_lost")
    assert counts(line)["rejected_garbled"] > 10


def test_case_26_line_without_end(line: slcan_bench.Line) -> None:
    """20 kB without CR: no more than 1 kB is kept, the line that ends it is lost, all else goes on."""

    def babble(far: slcan_bench.Far) -> None:
        for _ in range(20):
            far.say(b"A" * 1000)
            far.deliver(line.host)
            assert line.host.lines.kept <= MAX_LINE_BYTES == 1024

    run = line.play(scenario_data(), on_step=line.at(AT_S, babble))
    assert_no_trip(run)
    assert run.outcome.frames_lost == 1
    assert counts(line) == {"rejected_endless": 1}


def test_case_27_every_send_refused(line: slcan_bench.Line) -> None:
    """The adapter refuses every command: safe within W, the missing echo trips within 5 T, each refusal is counted."""
    run = line.play(scenario_data(), on_step=line.at(AT_S, lambda far: setattr(far, "refuses", True)))
    assert_tripped(run, AT_S, 5 * T_S, "echo_missing", "node_tripped")
    assert run.node_off_s(AT_S) <= AT_S + W_S
    assert counts(line)["refused"] > 3
    assert run.outcome.reason == f"{run.cause}; {of_bus.NOT_ECHOED}"
    trip = next(event.text for _, event in run.events if event.code == "trip")
    assert trip.endswith(" commands refused by the adapter"), trip


@pytest.mark.parametrize("from_s", [-2.0, AT_S])
def test_lines_that_are_rejected_are_named_when_the_rig_is_not_ready_and_when_it_trips(
    line: slcan_bench.Line, from_s: float
) -> None:
    """That 1,668 lines were rejected used to be said only at the end of a run; the text blamed old levels alone."""

    def garble(text: bytes) -> bytes:
        return text[:-3] + b"\r" if text.startswith(b"t18") else text

    run = line.play(
        scenario_data(rig={"safety": {"arm_timeout_s": 2.0}}),
        on_step=line.at(from_s, lambda far: setattr(far, "garble", garble)),
    )
    rejected = counts(line)["rejected_payload"]
    if from_s < 0.0:
        assert run.outcome.status == "failed"
        text = run.outcome.reason
        assert text == f"not ready within 2 s: levels are too old; {rejected:,} lines rejected: {rejected:,} payload"
        return
    assert_tripped(run, AT_S, RX_S + T_S, "stale_levels", "stale_status")
    text = next(event.text for _, event in run.events if event.code == "trip")
    assert re.search(r"; [\d,]+ lines rejected: [\d,]+ payload$", text), text


def test_case_27_every_send_refused_from_the_start(line: slcan_bench.Line) -> None:
    """So from the first command on: the pumps never move."""
    run = line.play(
        scenario_data(rig={"safety": {"arm_timeout_s": 2.0}}),
        on_step=line.at(-2.0, lambda far: setattr(far, "refuses", True)),
    )
    assert run.cause == "echo_missing", run.told
    assert run.trip_s <= 5 * T_S + TIME_TOLERANCE_S
    assert all(change.applied_V == OFF for change in run.keeper.changes if change.node == "pump")


def test_case_28_adapter_stops_reading(line: slcan_bench.Line) -> None:
    """The commands wait in the line: trip; when it reads again, the node refuses them all and stays at 0 V."""
    run = line.play(scenario_data(duration_s=30.0), on_step=line.at(AT_S, lambda far: setattr(far, "is_deaf", True)))
    assert_tripped(run, AT_S, RX_S + T_S, "node_tripped", "echo_missing")
    assert_safe(run, AT_S)
    backlog = run.keeper.sent[line.far.heard - len(run.keeper.sent) :]
    assert len(backlog) > 3
    for _, data in backlog:
        frame = node.Frame(0.0, node.COMMAND_ID, is_extended_id=False, data=data)
        run.emulator.receive(frame, run.emulator.now_ns)
    run.emulator.advance(run.emulator.now_ns + 100_000_000)
    assert_safe(run, AT_S)


@pty_every_day
@pytest.mark.parametrize("target", ["pump", "level"])
def test_case_29_node_reboots(target: str) -> None:
    of_nodes.test_case_29_node_reboots(target, AT_S)


@pty_every_day
@pytest.mark.parametrize("target", ["pump", "level"])
def test_case_30_heartbeat_stops(target: str) -> None:
    of_nodes.test_case_30_heartbeat_stops(target, AT_S)


@pty_every_day
@pytest.mark.parametrize("jump_s", [3600.0, -3600.0])
def test_case_46_wall_clock_jumps(monkeypatch: pytest.MonkeyPatch, jump_s: float) -> None:
    of_process.test_case_46_wall_clock_jumps(monkeypatch, jump_s)


@pty_every_day
def test_case_51_detector_raises() -> None:
    of_process.test_case_51_detector_raises(ZeroDivisionError("x"))
