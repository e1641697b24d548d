"""Each fault of frames and of the bus, by what is on the wire and what the pump node takes."""

from itertools import pairwise

import can
import pytest

from firmware_sim.frames import COMMAND_ID, FRAME_IDS, NodeState, Rejection, crc8
from tests.firmware_sim.fault_bench import MS, SECOND, as_bytes, drive, fault, named, rig_with, run_s
from tests.firmware_sim.sim_bench import command, frame_of

OUTWARD = [name for name in FRAME_IDS if name != "PumpCommand"]


def is_intact(frame: can.Message, can_id: int) -> bool:
    return crc8(can_id, bytes(frame.data[:-1])) == frame.data[-1]


def counters(frames: list[can.Message], name: str) -> list[int]:
    at, shift = {"LowerLevels": (5, 0), "UpperLevels": (5, 0), "PumpStatus": (5, 4)}.get(name, (0, 4))
    return [f.data[at] >> shift & 0x0F for f in frames]


@pytest.mark.parametrize("name", OUTWARD)
def test_frame_loss_of_everything_leaves_the_other_frames_alone(name: str) -> None:
    frames, healthy = drive(rig_with(fault("frame_loss", name, 1.0, until_s=2.0)), 3.0), drive(rig_with(), 3.0)
    assert named(frames, name, 1.0, 2.0) == []
    assert as_bytes(frames) == [f for f in as_bytes(healthy) if not (f[1] == FRAME_IDS[name] and 1.2 <= f[0] < 2.2)]


def test_frame_loss_has_its_probability_in_both_directions() -> None:
    rig = rig_with(fault("frame_loss", "all", 0.2, at_s=0.0))
    frames = drive(rig, 40.0, period_ns=20 * MS)
    assert len(named(frames, "LowerLevels")) == pytest.approx(0.8 * 2000, rel=0.03)
    assert rig.pump.lost + rig.pump.accepted == pytest.approx(2000, abs=9)
    assert rig.pump.lost == pytest.approx(400, abs=60)


def test_frame_burst_loses_just_so_many_of_each() -> None:
    rig = rig_with(fault("frame_burst", "LowerLevels", 16))
    frames = named(drive(rig, 3.0), "LowerLevels", 0.9, 3.0)
    times_s = [run_s(f) for f in frames]
    gaps = [b - a for a, b in pairwise(times_s)]
    assert max(gaps) == pytest.approx(17 * 0.02)
    assert sum(gap > 0.021 for gap in gaps) == 1


def test_frame_delay_keeps_order_and_content() -> None:
    healthy = drive(rig_with(), 3.0)
    frames = drive(rig_with(fault("frame_delay", "LowerLevels", 0.123, at_s=0.0)), 3.0)
    late = named(frames, "LowerLevels")[1:]
    there = [f for f in named(healthy, "LowerLevels") if run_s(f) > 0.0][: len(late)]
    assert [bytes(f.data) for f in late[: len(there)]] == [bytes(f.data) for f in there][: len(late)]
    assert run_s(late[5]) == pytest.approx(run_s(there[5]) + 0.123)
    assert [f.timestamp for f in frames] == sorted(f.timestamp for f in frames)


def test_frame_delay_of_commands_reaches_the_pump_node_later() -> None:
    rig = rig_with(fault("frame_delay", "PumpCommand", 0.1, at_s=0.0))
    drive(rig, 1.0)
    assert rig.receive(command(7.0, 7.0, counter=11), rig.now_ns) is Rejection.LOST
    rig.advance(rig.now_ns + 100 * MS - 1)
    assert rig.truth().applied_V == (3.0, 3.0)
    rig.advance(rig.now_ns + 1)
    assert rig.truth().applied_V == (7.0, 7.0)


def test_frame_delay_comes_out_though_nobody_commands() -> None:
    """Delayed frames used to wait for the next command, however long that took."""
    rig = rig_with()
    rig.advance(SECOND)
    rig.inject(fault("frame_delay", "PumpStatus", 0.1, at_s=0.0), rig.now_ns)
    times_s = [f.timestamp for f in named(rig.advance(2 * SECOND), "PumpStatus")]
    assert times_s == pytest.approx([1.15 + 0.05 * k for k in range(18)])


def test_frame_duplicate() -> None:
    frames = named(drive(rig_with(fault("frame_duplicate", "PumpStatus")), 2.0), "PumpStatus", 1.0, 2.0)
    assert len(frames) == 40
    assert all(bytes(a.data) == bytes(b.data) for a, b in zip(frames[::2], frames[1::2], strict=True))


def test_frame_duplicate_of_commands_is_refused_by_the_node() -> None:
    rig = rig_with(fault("frame_duplicate", "PumpCommand", at_s=0.0))
    drive(rig, 2.0)
    assert rig.pump.rejected[Rejection.DUPLICATE] == 20
    assert rig.pump.lost == 0


def test_frame_reorder_swaps_neighbours_and_gives_back_the_last() -> None:
    healthy = named(drive(rig_with(), 3.0), "LowerLevels", 1.0, 1.1)
    frames = named(drive(rig_with(fault("frame_reorder", "LowerLevels", until_s=1.1)), 3.0), "LowerLevels", 1.0, 1.11)
    first = counters(healthy, "LowerLevels")[0]
    assert [(c - first) % 16 for c in counters(frames, "LowerLevels")] == [1, 0, 3, 2, 4, 5]
    assert [run_s(f) for f in frames] == [1.02, 1.02, 1.06, 1.06, 1.1, 1.1]


@pytest.mark.parametrize("name", ["LowerLevels", "PumpStatus", "PumpHeartbeat"])
def test_frame_corrupt_is_never_intact(name: str) -> None:
    frames = named(drive(rig_with(fault("frame_corrupt", name, 1.0, at_s=0.0)), 20.0), name)[2:]
    assert not any(is_intact(f, FRAME_IDS[name]) for f in frames)


def test_frame_corrupt_of_commands_is_refused_and_trips_the_node() -> None:
    rig = rig_with(fault("frame_corrupt", "PumpCommand", 1.0))
    drive(rig, 2.0)
    assert rig.pump.rejected[Rejection.CRC] >= 9
    assert rig.truth().pump_state is NodeState.TRIPPED


@pytest.mark.parametrize("name", OUTWARD)
def test_counter_stuck_leaves_data_fresh_and_the_crc_right(name: str) -> None:
    frames = named(drive(rig_with(fault("counter_stuck", name)), 3.0, v=(5.0, 5.0)), name, 1.0)
    assert len(set(counters(frames, name))) == 1
    assert all(is_intact(f, FRAME_IDS[name]) for f in frames)


def test_counter_stuck_of_commands_is_a_row_of_duplicates() -> None:
    rig = rig_with(fault("counter_stuck", "PumpCommand"))
    drive(rig, 1.2)
    assert rig.pump.rejected[Rejection.DUPLICATE] >= 1


@pytest.mark.parametrize("length", [None, 0, 3, 7, 8])
def test_wrong_length(length: int | None) -> None:
    frames = named(drive(rig_with(fault("wrong_length", "LowerLevels", length)), 2.0), "LowerLevels", 1.0)
    expected = 6 if length in (None, 7) else length
    assert {(len(f.data), f.dlc) for f in frames} == {(expected, expected)}


def test_wrong_length_of_commands_is_refused() -> None:
    rig = rig_with(fault("wrong_length", "PumpCommand"))
    drive(rig, 2.0)
    assert rig.pump.rejected[Rejection.LENGTH] >= 9


@pytest.mark.parametrize(("value", "can_id"), [(None, 0x18A), (0x282, 0x282)])
def test_wrong_id(value: int | None, can_id: int) -> None:
    frames = drive(rig_with(fault("wrong_id", "LowerLevels", value)), 2.0)
    assert named(frames, "LowerLevels", 1.0) == []
    strange = [f for f in frames if f.arbitration_id == can_id and run_s(f) >= 1.0 and is_intact(f, 0x182)]
    assert len(strange) >= 49


def test_extended_id() -> None:
    frames = named(drive(rig_with(fault("extended_id", "PumpHeartbeat")), 2.0), "PumpHeartbeat", 1.0)
    assert all(f.is_extended_id for f in frames)
    rig = rig_with(fault("extended_id", "PumpCommand"))
    drive(rig, 2.0)
    assert rig.pump.rejected[Rejection.EXTENDED] >= 9


def test_remote_frame() -> None:
    frames = named(drive(rig_with(fault("remote_frame", "UpperLevels")), 2.0), "UpperLevels", 1.0)
    assert {(f.is_remote_frame, f.dlc, bytes(f.data)) for f in frames} == {(True, 7, b"")}
    rig = rig_with(fault("remote_frame", "PumpCommand"))
    drive(rig, 2.0)
    assert rig.pump.rejected[Rejection.REMOTE] >= 9


@pytest.mark.parametrize(("target", "can_id"), [(None, 0x7A5), ("top", 0x000)])
def test_babble_comes_at_its_rate_beside_everything_else(target: str | None, can_id: int) -> None:
    frames, healthy = drive(rig_with(fault("babble", target, 500.0, until_s=2.0)), 3.0), drive(rig_with(), 3.0)
    strange = [f for f in frames if f.arbitration_id == can_id]
    assert len(strange) == 500
    assert len({bytes(f.data) for f in strange}) == 500
    assert as_bytes([f for f in frames if f.arbitration_id != can_id]) == as_bytes(healthy)


def test_babble_of_top_priority_at_full_load_starves_both_directions() -> None:
    rig = rig_with(fault("babble", "top", 4000.0, until_s=2.0))
    frames = drive(rig, 3.0)
    assert {f.arbitration_id for f in frames if 1.0 <= run_s(f) < 2.0} == {0}
    assert rig.truth().pump_state is NodeState.TRIPPED
    assert len(named(frames, "LowerLevels", 2.0, 3.0)) == 50


def test_foreign_command_is_seen_on_the_bus_and_obeyed() -> None:
    rig = rig_with(fault("foreign_command", None, 8.0, at_s=1.05))
    frames = drive(rig, 1.06)
    assert rig.truth().applied_V == (8.0, 8.0)
    assert len(named(frames, "PumpCommand")) == 1
    assert rig.receive(command(3.0, 3.0, counter=11), rig.now_ns) is Rejection.DUPLICATE


def test_error_frames() -> None:
    frames = drive(rig_with(fault("error_frames", None, 50.0, until_s=2.0)), 3.0)
    assert sum(f.is_error_frame for f in frames) == 50


def test_bus_off_cuts_both_directions_until_its_end() -> None:
    rig = rig_with(fault("bus_off", until_s=2.0))
    frames = drive(rig, 3.0)
    assert not [f for f in frames if 1.0 <= run_s(f) < 2.0]
    assert rig.truth().pump_state is NodeState.TRIPPED
    assert len(named(frames, "LowerLevels", 2.0, 3.0)) == 50


def test_bus_off_swallows_what_others_say_too() -> None:
    rig = rig_with(fault("bus_off"), fault("babble", None, 100.0))
    frames = drive(rig, 2.0)
    assert not [f for f in frames if run_s(f) >= 1.0]
    before = rig.pump.rejected.total()
    assert rig.receive(frame_of(b"\1", can_id=0x123), rig.now_ns) is Rejection.LOST
    assert rig.pump.rejected.total() == before


def test_frames_of_others_reach_the_node_past_a_faulty_wire() -> None:
    rig = rig_with(fault("frame_loss", "LowerLevels", 1.0, at_s=0.0))
    drive(rig, 1.0)
    assert rig.receive(frame_of(b"\1", can_id=0x123), rig.now_ns) is Rejection.FOREIGN
    assert rig.advance(rig.now_ns) is not None
    assert rig.receive(command(4.0, 4.0, counter=11), rig.now_ns) is None
    assert COMMAND_ID not in {f.arbitration_id for f in rig.advance(rig.now_ns + SECOND)}


def test_kinds_that_differ_act_together_and_of_one_kind_the_later_holds() -> None:
    faults = [
        fault("frame_loss", "all", 1.0),
        fault("frame_loss", "LowerLevels", 0.0, at_s=2.0, until_s=3.0),
        fault("extended_id", "LowerLevels"),
    ]
    frames = drive(rig_with(*faults), 4.0)
    assert {f.arbitration_id for f in frames if run_s(f) >= 1.0} == {FRAME_IDS["LowerLevels"]}
    assert {2.0 <= run_s(f) < 3.0 and f.is_extended_id for f in frames if run_s(f) >= 1.0} == {True}
