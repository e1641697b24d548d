"""Each fault of the nodes."""

import json
from pathlib import Path

import can

from firmware_sim.change_record import ChangeRecord
from firmware_sim.frames import NodeState
from firmware_sim.pump_node import Change
from tests.firmware_sim.fault_bench import SECOND, as_bytes, drive, fault, named, rig_with, run_s


def boot_counts(frames: list[can.Message], name: str) -> list[int]:
    return [int.from_bytes(f.data[1:3], "little") for f in named(frames, name)]


def test_node_reboot_of_the_pump_node_forgets_everything_at_zero_volts() -> None:
    changes: list[Change] = []
    rig = rig_with(fault("node_reboot", "pump"), observer=changes.append)
    frames = drive(rig, 1.0)
    assert rig.truth().applied_V == (0.0, 0.0)
    assert (rig.truth().pump_state, rig.pump.accepted) == (NodeState.BOOT, 0)
    frames += rig.advance(rig.now_ns + SECOND)
    assert rig.truth().pump_state is NodeState.READY
    assert sorted(set(boot_counts(frames, "PumpHeartbeat"))) == [1, 2]
    assert set(boot_counts(frames, "LevelHeartbeat")) == {1}
    assert [c.cause for c in changes if c.node == "pump"][-2:] == ["reboot", "booted"]


def test_node_reboot_of_the_level_node_stops_levels_while_it_boots() -> None:
    frames = drive(rig_with(fault("node_reboot", "level")), 3.0)
    assert not named(frames, "LowerLevels", 1.0, 1.2)
    first = named(frames, "LowerLevels", 1.2)[0]
    assert (run_s(first), first.data[5]) == (1.2, 0)
    assert sorted(set(boot_counts(frames, "LevelHeartbeat"))) == [1, 2]


def test_node_reboot_with_an_end_is_a_node_without_power_until_then() -> None:
    rig = rig_with(fault("node_reboot", "pump", until_s=2.0))
    frames = drive(rig, 2.15)
    assert not named(frames, "PumpStatus", 1.0, 2.0)
    assert rig.truth().pump_state is NodeState.BOOT
    frames += rig.advance(rig.now_ns + SECOND)
    assert set(boot_counts(frames, "PumpHeartbeat")) == {1, 2}
    assert rig.truth().pump_state is NodeState.READY


def test_node_silent_pump_sends_nothing_hears_nothing_and_trips() -> None:
    rig = rig_with(fault("node_silent", "pump", until_s=2.0))
    frames = drive(rig, 3.0)
    assert not named(frames, "PumpStatus", 1.0, 2.0) + named(frames, "PumpHeartbeat", 1.0, 2.0)
    assert len(named(frames, "LowerLevels", 1.0, 2.0)) == 50
    assert rig.truth().pump_state is NodeState.TRIPPED


def test_node_silent_level_sends_nothing() -> None:
    rig = rig_with(fault("node_silent", "level"))
    frames = drive(rig, 3.0)
    assert {f.arbitration_id for f in frames if run_s(f) >= 1.0} == {0x181, 0x701}
    assert rig.truth().pump_state is NodeState.RUN


def test_heartbeat_stop_stops_nothing_else() -> None:
    frames, healthy = drive(rig_with(fault("heartbeat_stop", "level")), 3.0), drive(rig_with(), 3.0)
    assert as_bytes(frames) == [f for f in as_bytes(healthy) if f[1] != 0x702 or f[0] < 1.2]


def test_clock_jump_shows_in_the_record_only(tmp_path: Path) -> None:
    record = ChangeRecord(tmp_path / "changes.jsonl")
    jumped = rig_with(fault("clock_jump", "pump", -3600.0), observer=record)
    frames = drive(jumped, 3.0)
    healthy = rig_with()
    assert as_bytes(frames) == as_bytes(drive(healthy, 3.0))
    assert jumped.truth().levels_cm == healthy.truth().levels_cm
    jumped.advance(10 * SECOND)
    record.close()
    lines = [json.loads(line) for line in (tmp_path / "changes.jsonl").read_text().splitlines()]
    assert (lines[-1]["t_s"], lines[-1]["wall_s"]) == (3.45, 3.45 - 3600.0)
    assert lines[0]["t_s"] == lines[0]["wall_s"]
