"""Cases 1 to 11, 15, 17 to 19: single frames lost, late, twice, garbled or not ours."""

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import pytest

from firmware_sim import frames as node
from hil.core.types import Command
from hil.wire.command_sender import CommandSender
from hil.wire.frame_check import Rejection
from hil.wire.receiver import Receiver
from tests.faults.faults_bench import (
    FRAME_PERIOD_S,
    LEVEL_FRAMES,
    NODE_FRAMES,
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

ALL_FRAMES = (*NODE_FRAMES, "PumpCommand")
AT_S = 5.0
AGE_CAUSES = ("stale_levels", "stale_status", "node_lost")


def one(kind: str, at_s: float, frame: str = "LowerLevels", value: float | None = None) -> dict[str, Any]:
    """A fault that acts on a single frame."""
    return fault(kind, at_s, frame, value, until_s=at_s + 0.75 * FRAME_PERIOD_S[frame])


def refused_commands(run: Run) -> int:
    """How many the node has refused, but for those before it had booted."""
    rejected = run.emulator.pump.rejected
    return rejected.total() - rejected[node.Rejection.BOOT]


def lossy(probability: float = 0.05) -> list[dict[str, Any]]:
    return [fault("frame_loss", 0.0, frame, probability) for frame in NODE_FRAMES]


@pytest.mark.parametrize("frame", ALL_FRAMES)
def test_case_01_one_frame_lost(frame: str) -> None:
    """One frame lost: the estimate is held, the loss counted, no trip."""
    run = play(scenario_data(fault("frame_burst", AT_S, frame, 1)))
    assert_no_trip(run)
    if frame == "PumpCommand":
        assert run.outcome.commands_lost == 1
    elif "Heartbeat" not in frame:  # a heartbeat's counter is a resynchronisation time later anyway
        assert run.outcome.frames_lost == 1
    missed = run.at(AT_S)
    assert missed.levels_age_s <= 0.02 + TIME_TOLERANCE_S
    assert missed.measured_V == pytest.approx(run.at(AT_S - T_S).measured_V, abs=0.02)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_case_02_random_loss(seed: int) -> None:
    """5 % of what the nodes send is lost, for a minute: no trip; the hour is among the long tests."""
    run = play(scenario_data(*lossy(), duration_s=60.0), seed=seed)
    assert_no_trip(run)
    assert run.outcome.frames_lost > 200


@pytest.mark.long
def test_case_02_random_loss_for_an_hour() -> None:
    """5 % of what the nodes send is lost, for an hour: no trip."""
    run = play(scenario_data(*lossy(), duration_s=3600.0), seed=1)
    assert_no_trip(run)


@pytest.mark.long
def test_case_02_random_loss_both_ways_for_ten_minutes() -> None:
    """5 % of all frames, commands too, with a control period of 40 ms: six commands in a row would have to be lost.

    Ten minutes have 15 000 commands: a limit that four losses in a row reached would fail here, as it would in an hour.
    """
    rig = {"control": {"period_s": 0.04}}
    run = play(scenario_data(fault("frame_loss", 0.0, "all", 0.05), duration_s=600.0, rig=rig), seed=2, checks=False)
    assert_no_trip(run)
    assert run.outcome.commands_lost > 500
    assert (run.seen.range_broken, run.seen.latch_broken) == ("", "")


@pytest.mark.parametrize("count", [3, 5, 8, 14, 20])
@pytest.mark.parametrize("frame", NODE_FRAMES)
def test_case_03_burst_lost(frame: str, count: int) -> None:
    """Three and more in a row: a trip exactly when the age passes its limit, within Rx + T."""
    run = play(scenario_data(fault("frame_burst", AT_S, frame, count)))
    limit_s = 0.25 if "Heartbeat" in frame else RX_S
    period_s = FRAME_PERIOD_S[frame]
    oldest_s = max(
        step * T_S + period_s for step in range(100) if step * T_S < count * period_s - TIME_TOLERANCE_S
    )  # age at the last step before the first frame after the burst
    if oldest_s > limit_s + TIME_TOLERANCE_S:
        assert_tripped(run, AT_S, RX_S + T_S, *AGE_CAUSES)
    else:
        assert_no_trip(run)


@pytest.mark.parametrize("count", [3, 10, 40])
def test_case_03_burst_of_commands_lost(count: int) -> None:
    """Commands lost for longer than the watchdog: the node is safe within W of the last one, the controller trips."""
    run = play(scenario_data(fault("frame_burst", AT_S, "PumpCommand", count)))
    assert run.node_off_s(AT_S) <= AT_S + W_S
    assert_tripped(run, AT_S, RX_S + T_S, "node_tripped", "echo_missing")


@pytest.mark.parametrize("count", [15, 16, 32])
@pytest.mark.parametrize("frame", LEVEL_FRAMES)
def test_case_04_burst_that_wraps_the_counter(frame: str, count: int) -> None:
    """15 lost look like a duplicate, 16 like none lost: it is the age that counts, and nothing is refused."""
    run = play(scenario_data(fault("frame_burst", AT_S, frame, count)))
    assert run.ticks[-1].rejected == 0
    if count == 15:  # 0.3 s just not passed at any step
        assert_no_trip(run)
    else:
        assert_tripped(run, AT_S, RX_S + T_S, "stale_levels")


def test_case_05_duplicate() -> None:
    """Every frame twice, both ways: dropped, and the run is the same to the bit."""
    run = play(scenario_data(fault("frame_duplicate", AT_S, "all")))
    assert_no_trip(run)
    assert run.ticks[-1].rejected > 500
    assert run.emulator.pump.rejected[node.Rejection.DUPLICATE] > 40
    assert [tick.command_V for tick in run.ticks] == [tick.command_V for tick in plain().ticks]


@pytest.mark.parametrize("frame", ["LowerLevels", "UpperLevels", "PumpStatus", "PumpCommand"])
def test_case_06_reordered(frame: str) -> None:
    """Neighbours swapped: the older one is dropped, the newer one used, no trip."""
    run = play(scenario_data(fault("frame_reorder", AT_S, frame)))
    assert_no_trip(run)
    if frame == "PumpCommand":
        assert run.emulator.pump.rejected[node.Rejection.OLD] > 20
    else:
        assert run.ticks[-1].rejected > 40


@pytest.mark.parametrize(
    ("frame", "delay_s"), [("LowerLevels", 0.25), ("UpperLevels", 0.25), ("PumpStatus", 0.2), ("LevelHeartbeat", 0.1)]
)
def test_case_07_delayed_less_than_the_limit(frame: str, delay_s: float) -> None:
    """Late by less than the limit: what is there is used with its age, which grows meanwhile; no trip."""
    run = play(scenario_data(fault("frame_delay", AT_S, frame, delay_s, until_s=AT_S + 3.0)))
    assert_no_trip(run)
    if "Heartbeat" not in frame:
        ages = [t.status_age_s if frame == "PumpStatus" else t.levels_age_s for t in run.from_s(AT_S, AT_S + 0.5)]
        assert delay_s - T_S <= max(ages) <= RX_S


@pytest.mark.parametrize("frame", NODE_FRAMES)
def test_case_08_delayed_more_than_the_limit(frame: str) -> None:
    """Late by more than the limit: trip within Rx + T."""
    run = play(scenario_data(fault("frame_delay", AT_S, frame, 0.5)))
    assert_tripped(run, AT_S, RX_S + T_S, *AGE_CAUSES)


@pytest.mark.parametrize("frame", ALL_FRAMES)
def test_case_09_crc_wrong_once(frame: str) -> None:
    """One wrong CRC: dropped and counted, no trip."""
    run = play(scenario_data(one("frame_corrupt", AT_S, frame, 1.0)))
    assert_no_trip(run)
    assert (refused_commands(run) if frame == "PumpCommand" else run.ticks[-1].rejected) == 1


@pytest.mark.parametrize("frame", NODE_FRAMES)
def test_case_09_crc_wrong_five_times(frame: str) -> None:
    """Five wrong CRCs running: trip in the step that sees the fifth, if age has not tripped it before."""
    length_s = 4.5 * FRAME_PERIOD_S[frame]
    run = play(scenario_data(fault("frame_corrupt", AT_S, frame, 1.0, until_s=AT_S + length_s)))
    assert_tripped(run, AT_S, length_s + T_S, "frames_refused", "node_lost")
    if "Heartbeat" not in frame:
        assert run.cause == "frames_refused"


def test_case_09_crc_of_commands_wrong_four_times() -> None:
    """Commands that the node refuses: it is safe within W, and the controller trips."""
    run = play(scenario_data(fault("frame_corrupt", AT_S, "PumpCommand", 1.0, until_s=AT_S + 0.35)))
    assert_safe(run, AT_S)
    assert_tripped(run, AT_S, RX_S + T_S, "node_tripped")


def flips(data: bytes) -> Iterator[bytes]:
    """The payload with every one and every two of its bits flipped."""
    bits = range(8 * len(data))
    for hit in (*((bit,) for bit in bits), *combinations(bits, 2)):
        flipped = bytearray(data)
        for bit in hit:
            flipped[bit // 8] ^= 1 << bit % 8
        yield bytes(flipped)


def test_case_10_every_one_and_two_bit_flip() -> None:
    """Each of the 1- and 2-bit errors of each frame, both ways: all of them rejected."""
    ok = (node.ChannelStatus.OK,) * 2
    run, print_of = node.NodeState.RUN, contract().fingerprint
    payloads = {
        node.LOWER_LEVELS_ID: node.pack_levels(node.LOWER_LEVELS_ID, (6.2, 6.4), ok, 3),
        node.UPPER_LEVELS_ID: node.pack_levels(node.UPPER_LEVELS_ID, (0.8, 0.7), ok, 9),
        node.STATUS_ID: node.pack_status((3.0, 3.1), run, node.TripCause.NONE, 5, 7, 99),
        node.PUMP_HEARTBEAT_ID: node.pack_heartbeat(node.PUMP_HEARTBEAT_ID, run, 1, 1, print_of),
        node.LEVEL_HEARTBEAT_ID: node.pack_heartbeat(node.LEVEL_HEARTBEAT_ID, run, 15, 1, print_of),
    }
    for can_id, payload in payloads.items():
        receiver = Receiver(contract(), CommandSender(contract()), (0.0, 10.24))
        tried = [receiver.take(node.Frame(0.0, can_id, is_extended_id=False, data=data), 0) for data in flips(payload)]
        assert len(tried) == 8 * len(payload) * (8 * len(payload) + 1) // 2
        assert set(tried) == {Rejection.CRC}, hex(can_id)
    command = CommandSender(contract()).encode(Command((3.0, 3.0), enable=True), 0)
    for data in flips(command):
        frame = node.Frame(0.0, node.COMMAND_ID, is_extended_id=False, data=data)
        assert node.parse_command(frame) is node.Rejection.CRC


@pytest.mark.parametrize("frame", NODE_FRAMES)
def test_case_11_counter_stuck(frame: str) -> None:
    """Data fresh, CRC right, the counter stands still: trip in the step that sees the fifth refusal."""
    run = play(scenario_data(fault("counter_stuck", AT_S, frame)))
    first_and_five_s = 5 * FRAME_PERIOD_S[frame]
    assert_tripped(run, AT_S, first_and_five_s + T_S, "frames_refused", "node_lost")


def test_case_11_counter_of_commands_stuck() -> None:
    """The node takes a command whose counter stands still for a duplicate: safe within W, and the controller trips."""
    run = play(scenario_data(fault("counter_stuck", AT_S, "PumpCommand")))
    assert_safe(run, AT_S + T_S)
    assert_tripped(run, AT_S, 5 * T_S, "node_tripped")


@pytest.mark.parametrize("frame", ["LowerLevels", "PumpStatus", "LevelHeartbeat", "PumpCommand"])
def test_case_15_wrong_length(frame: str) -> None:
    """Payloads of 0 to 8 bytes, one at a time: each dropped, and the next one taken."""
    lengths = [length for length in range(9) if length != contract().frames[frame].length]
    run = play(scenario_data(*(one("wrong_length", 2.0 + 0.5 * i, frame, n) for i, n in enumerate(lengths))))
    assert_no_trip(run)
    assert (refused_commands(run) if frame == "PumpCommand" else run.ticks[-1].rejected) == len(lengths)


def test_case_17_wrong_id_or_data_id() -> None:
    """An unknown identifier, and the payload of one frame under the identifier of another: dropped."""
    others = [one("wrong_id", 3.0), *(one("wrong_id", 4.0 + i, f, 0x181) for i, f in enumerate(LEVEL_FRAMES))]
    run = play(scenario_data(*others, one("wrong_id", 7.0, "UpperLevels", 0x182)))
    assert_no_trip(run)
    assert run.ticks[-1].rejected == 4
    levels = [tick.measured_V for tick in run.from_s(2.0)]
    assert all(abs(a - b) < 0.05 for y in levels for a, b in zip(y, levels[0], strict=True))


@pytest.mark.parametrize("kind", ["extended_id", "remote_frame"])
@pytest.mark.parametrize("frame", ALL_FRAMES)
def test_case_18_19_extended_and_remote_frames(frame: str, kind: str) -> None:
    """A 29-bit identifier of the same number, or a request for the frame: dropped, no reply, no trip."""
    run = play(scenario_data(one(kind, AT_S, frame)))
    assert_no_trip(run)
    if frame != "PumpCommand":
        assert run.ticks[-1].rejected == 1
        assert len(run.keeper.odd) == 1
    assert len(run.keeper.sent) == len(plain().keeper.sent), "commands and nothing else"
