"""Faults by command: the grammar, its refusals, what a command does to a running rig."""

from typing import Any

import pytest

from firmware_sim.failure_command import COMPONENTS, Component, execute
from firmware_sim.faults.base import Fault
from firmware_sim.faults.catalogue import KINDS, value_of
from firmware_sim.frames import NodeState
from firmware_sim.setting_types import accepts
from tests.firmware_sim.fault_bench import as_bytes, drive, fault, named, rig_with, run_s
from tests.firmware_sim.sim_bench import ROOT, SECOND
from tests.narrowing import not_none
from tools.reference.fault_kinds import fault_kinds_page


class Recorder:
    """Notes what it is told to do."""

    def __init__(self) -> None:
        self.faults: list[Any] = []
        self.recoveries: list[tuple[set[str], set[int | str] | None]] = []

    def inject(self, fault: Fault, now_ns: int) -> None:
        assert now_ns == 7
        self.faults.append(fault)

    def recover(self, kinds: set[str], targets: set[int | str] | None, now_ns: int) -> int:
        assert now_ns == 7
        self.recoveries.append((kinds, targets))
        return 2


def done(line: str) -> tuple[str, Recorder]:
    recorder = Recorder()
    answer = execute(line, recorder, 7)
    assert "\n" not in answer
    return answer, recorder


COMMANDS: list[tuple[str, list[tuple[str, str | int, float | None]]]] = [
    ("failure pump off -i 1", [("pump_dead", 1, None)]),
    ("failure pump off", [("pump_dead", 1, None), ("pump_dead", 2, None)]),
    ("failure pump off -i 0", [("pump_dead", 1, None), ("pump_dead", 2, None)]),
    ("failure pump stuck -i 2 -v 4.5", [("pump_stuck_on", 2, 4.5)]),
    ("failure pump slow -v 3 -i 2", [("pump_lag", 2, 3.0)]),
    ("failure pump wrong -v 0.4 -i 1", [("pump_effectiveness", 1, 0.4)]),
    ("failure pump pump_effectiveness -v 0.4 -i 1", [("pump_effectiveness", 1, 0.4)]),
    ("failure valve wrong -v 0.5 -i 1", [("valve_split", 1, 0.5)]),
    ("failure reservoir off", [("reservoir_low", 0, None)]),
    ("failure tank leak -v 0.2 -i 3", [("leak", 3, 0.2)]),
    ("failure tank blocked -v 1 -i 4", [("outlet_block", 4, 1.0)]),
    ("failure level off -i 4", [("sensor_open", 4, None)]),
    ("failure level stuck -i 2", [("sensor_stuck", 2, None)]),
    ("failure level garbage -i 1", [("sensor_garbage", 1, None)]),
    ("failure level wrong -i 1 -v -0.3", [("sensor_bias", 1, -0.3)]),
    ("failure level drift -i 1 -v -0.01", [("sensor_drift", 1, -0.01)]),
    ("failure level noise -i 1 -v 0.1", [("sensor_noise", 1, 0.1)]),
    ("failure lower_levels off", [("frame_loss", "LowerLevels", 1.0)]),
    ("failure upper_levels intermittent -v 0.05", [("frame_loss", "UpperLevels", 0.05)]),
    ("failure frames burst -v 16", [("frame_burst", "all", 16)]),
    ("failure pump_status delayed -v 0.2", [("frame_delay", "PumpStatus", 0.2)]),
    ("failure pump_command duplicate", [("frame_duplicate", "PumpCommand", None)]),
    ("failure pump_heartbeat reorder", [("frame_reorder", "PumpHeartbeat", None)]),
    ("failure level_heartbeat garbage", [("frame_corrupt", "LevelHeartbeat", 1.0)]),
    ("failure frames stuck", [("counter_stuck", "all", None)]),
    ("failure frames short", [("wrong_length", "all", None)]),
    ("failure frames wrong -v 291", [("wrong_id", "all", 291)]),
    ("failure frames extended", [("extended_id", "all", None)]),
    ("failure frames remote", [("remote_frame", "all", None)]),
    ("failure bus off", [("bus_off", "all", None)]),
    ("failure bus errors -v 10", [("error_frames", "all", 10.0)]),
    ("failure bus babble -v 1000", [("babble", "foreign", 1000.0)]),
    ("failure bus flood -v 4000", [("babble", "top", 4000.0)]),
    ("failure bus command -v 5", [("foreign_command", "PumpCommand", 5.0)]),
    ("failure node off -i 1", [("node_silent", "pump", None)]),
    ("failure node reboot -i 2", [("node_reboot", "level", None)]),
    ("failure node no_heartbeat -i 1", [("heartbeat_stop", "pump", None)]),
    ("failure node clock -i 2 -v 3600", [("clock_jump", "level", 3600.0)]),
]


@pytest.mark.parametrize(("line", "expected"), COMMANDS, ids=[line for line, _ in COMMANDS])
def test_a_command_becomes_faults(line: str, expected: list[tuple[str, str | int, float | None]]) -> None:
    answer, recorder = done(line)
    assert answer == f"ok {expected[0][0]} {', '.join(str(target) for _, target, _ in expected)}"
    seen = [(fault.kind, fault.target, getattr(fault, "value", None)) for fault in recorder.faults]
    assert seen == expected
    assert {(fault.at_s, fault.until_s) for fault in recorder.faults} == {(0.0, None)}


def test_every_kind_can_be_commanded() -> None:
    assert {word.kind for component in COMPONENTS.values() for word in component.types.values()} == set(KINDS)
    assert {expected[0][0] for _, expected in COMMANDS} == set(KINDS)


@pytest.mark.parametrize("name", COMPONENTS)
def test_every_failure_type_acts_on_every_instance_of_its_component(name: str) -> None:
    """Instances that no fault accepts as a target, or that name the same target twice, went unnoticed."""
    component = COMPONENTS[name]
    assert len(set(component.targets)) == len(component.targets)
    for word, failure_type in component.types.items():
        fields = KINDS[failure_type.kind].model_fields
        value = f" -v {not_none(accepts(fields['value']).numbers)[1]}" if "value" in fields else ""
        answer, recorder = done(f"failure {name} {word}{value}")
        assert answer.startswith("ok"), answer
        targets = component.targets if failure_type.target is None else (failure_type.target,)
        assert [fault.target for fault in recorder.faults] == list(targets)


def test_a_command_may_say_how_long() -> None:
    assert done("failure pump off -i 1 -t 2.5")[1].faults[0].until_s == 2.5


def test_a_command_may_let_a_fault_grow_and_come_and_go() -> None:
    (leak,) = done("failure tank leak -i 1 -v 0.4 -r 50 -p 10 -d 0.25")[1].faults
    assert (leak.ramp_s, leak.period_s, leak.duty, leak.until_s) == (50.0, 10.0, 0.25, None)
    rig = rig_with()
    drive(rig, 1.0)
    assert execute("failure pump wrong -i 1 -v 0.2 -r 10", rig, rig.now_ns) == "ok pump_effectiveness 1"
    seen = []
    for until_s in (1.0, 6.0, 11.0, 20.0):
        drive(rig, until_s)
        seen.append(rig.truth().effectiveness[0])
    assert seen == pytest.approx([1.0, 0.6, 0.2, 0.2])


def test_ok_also_ends_an_intermittent_fault_that_is_away() -> None:
    rig = rig_with()
    drive(rig, 1.0)
    execute("failure pump off -i 1 -p 10 -d 0.1", rig, rig.now_ns)
    drive(rig, 5.0)
    assert rig.truth().faults == ()
    assert execute("failure pump ok", rig, rig.now_ns) == "ok pump: 1 ended"
    drive(rig, 11.5)
    assert rig.truth().faults == ()


@pytest.mark.parametrize(
    ("line", "kinds", "targets"),
    [
        ("failure pump ok", {"pump_dead", "pump_stuck_on", "pump_lag", "pump_effectiveness"}, None),
        ("failure pump ok -i 2", {"pump_dead", "pump_stuck_on", "pump_lag", "pump_effectiveness"}, {2}),
        ("failure valve ok -i 0", {"valve_split"}, None),
        ("failure bus ok", {"bus_off", "error_frames", "babble", "foreign_command"}, None),
    ],
)
def test_ok_ends_what_acts_on_the_component(line: str, kinds: set[str], targets: set[int] | None) -> None:
    answer, recorder = done(line)
    assert answer == f"ok {line.split()[1]}: 2 ended"
    assert recorder.recoveries == [(kinds, targets)]


def test_ok_of_one_frame_is_not_that_of_all() -> None:
    assert done("failure lower_levels ok")[1].recoveries[0][1] == {"LowerLevels"}
    assert done("failure frames ok")[1].recoveries[0][1] is None


REFUSALS = [
    ("", "empty"),
    ("fail pump off", "unknown command 'fail'"),
    ("failure", "component is missing: one of pump, valve"),
    ("failure gps off", "unknown component 'gps': one of pump, valve"),
    ("failure Pump off", "unknown component 'Pump'"),
    ("failure pump", "failure type of pump is missing: one of ok, wrong, off"),
    ("failure pump garbage", "pump has no failure type 'garbage': one of ok, wrong, off, stuck, slow"),
    ("failure tank off", "tank has no failure type 'off': one of ok, leak, blocked"),
    ("failure pump sensor_open", "pump has no failure type 'sensor_open'"),
    ("failure pump off -i 3", "-i 3: pump has instances 1 .. 2, and 0 for all"),
    ("failure pump off -i -1", "-i -1: pump has instances 1 .. 2"),
    ("failure pump off -i 1.5", "-i 1.5: must be a whole number"),
    ("failure level off -i 5", "-i 5: level has instances 1 .. 4"),
    ("failure reservoir off -i 2", "-i 2: reservoir has instances 1 .. 1"),
    ("failure pump off -i", "-i needs a number"),
    ("failure pump off -i one", "-i one: must be a number"),
    ("failure pump off -i inf", "-i inf: must be a number"),
    ("failure pump off -i 1 -i 2", "-i is given twice"),
    ("failure pump off 1", "unknown option '1'"),
    ("failure pump off --instance 1", "unknown option '--instance'"),
    ("failure pump off -v 1", "pump off takes no -v"),
    ("failure pump slow -i 1", "pump slow needs -v VALUE: 0 .. 60 s"),
    ("failure pump slow -i 1 -v nan", "-v nan: must be a number"),
    ("failure pump slow -i 1 -v 61", "-v 61: is outside 0 .. 60"),
    ("failure pump wrong -i 1 -v 1.1", "-v 1.1: is outside 0 .. 1"),
    ("failure frames burst -v 1.5", "-v 1.5: must be a whole number in 1 .. 100000"),
    ("failure frames wrong -v 2048", "-v 2048: is outside 0 .. 2047"),
    ("failure pump off -t 0", "-t 0: must be later than at_s = 0"),
    ("failure pump off -t -1", "-t -1: is outside 0 .. 1e+07"),
    ("failure pump ok -v 1", "pump ok takes neither -v nor -t"),
    ("failure pump ok -t 1", "pump ok takes neither -v nor -t"),
    ("failure pump ok -r 1", "pump ok takes neither -v nor -t, -r"),
    ("failure pump wrong -i 1 -v 0.4 -r -1", "-r -1: is outside 0 .. 1e+07"),
    ("failure pump stuck -i 1 -v 4 -r 5", "-r 5: must be 0: pump_stuck_on has no size that grows"),
    ("failure pump off -i 1 -r 5", "-r 5: must be 0: pump_dead has no size that grows"),
    ("failure pump off -i 1 -p 5", "-d: must be given with -p"),
    ("failure pump off -i 1 -d 0.5", "-d 0.5: needs -p, too"),
    ("failure pump off -i 1 -p 5 -d 1", "-d 1: is outside 0.001 .. 0.999"),
    ("failure pump off -i 1 -p 0 -d 0.5", "-p 0: is outside 0.01 .. 1e+07"),
    ("failure pump off -i 1 -r 1 -r 2", "-r is given twice"),
    ("failure pump ok -i 3", "-i 3: pump has instances 1 .. 2"),
]


@pytest.mark.parametrize(("line", "expected"), REFUSALS, ids=[line for line, _ in REFUSALS])
def test_a_refusal_says_why_and_does_nothing(line: str, expected: str) -> None:
    answer, recorder = done(line)
    assert answer.startswith(f"error: {expected}")
    assert recorder.faults == recorder.recoveries == []


def test_help_names_the_components() -> None:
    answer, _ = done("failure help")
    assert answer.startswith("ok failure <component>")
    assert all(name in answer for name in COMPONENTS)


@pytest.mark.parametrize(("name", "component"), COMPONENTS.items(), ids=COMPONENTS)
def test_help_of_a_component_has_each_failure_type_with_what_it_takes(name: str, component: Component) -> None:
    answer, recorder = done(f"failure help {name}")
    assert answer.startswith(f"ok {name} -i 1 .. {len(component.targets)}: ok, ")
    assert recorder.faults == recorder.recoveries == []
    for failure_type, made in component.types.items():
        table = KINDS[made.kind]
        value, growth = value_of(table), "; -r" if table.grows_from else ""
        assert f", {failure_type}{f' (-v {value}{growth})' if value else ''}" in answer


def test_help_of_an_unknown_component_is_refused() -> None:
    assert done("failure help gps")[0].startswith("error: unknown component 'gps': one of pump, valve")


def test_a_command_acts_at_once_and_ok_ends_it() -> None:
    rig = rig_with()
    drive(rig, 1.0)
    assert execute("failure pump off -i 1", rig, rig.now_ns) == "ok pump_dead 1"
    assert rig.truth().effectiveness == (0.0, 1.0)
    drive(rig, 2.0)
    assert execute("failure pump ok -i 2", rig, rig.now_ns) == "ok pump: 0 ended"
    assert execute("failure pump ok -i 1", rig, rig.now_ns) == "ok pump: 1 ended"
    assert rig.truth().effectiveness == (1.0, 1.0)
    assert rig.truth().faults == ()


def test_a_command_works_before_the_scenario_starts() -> None:
    rig = rig_with()
    rig.advance(150_000_000)
    execute("failure lower_levels off -t 0.5", rig, rig.now_ns)
    frames = drive(rig, 1.0)
    assert run_s(named(frames, "LowerLevels")[0]) == 0.46


def test_a_commanded_fault_is_the_same_as_a_scheduled_one() -> None:
    scheduled, commanded = rig_with(fault("sensor_garbage", 2, at_s=1.01)), rig_with()
    expected = drive(scheduled, 1.01) + drive(scheduled, 2.0)
    frames = drive(commanded, 1.01)
    execute("failure level garbage -i 2", commanded, commanded.now_ns)
    assert as_bytes(frames + drive(commanded, 2.0)) == as_bytes(expected)


def test_reboot_by_command_twice_counts_twice() -> None:
    rig = rig_with()
    drive(rig, 1.0)
    for _ in range(2):
        execute("failure node reboot -i 1", rig, rig.now_ns + SECOND)
        assert rig.truth().pump_state is NodeState.BOOT
    heartbeat = rig.pump.heartbeat()
    assert int.from_bytes(heartbeat[1:3], "little") == 3


def test_the_page_of_fault_kinds_has_every_kind_and_word_and_the_page_of_faults_every_component() -> None:
    page = fault_kinds_page()
    for kind, table in KINDS.items():
        assert f"| `{kind}` |" in page
        assert all(f"`{call.component} {call.word}`" in page for call in table.words)
    text = (ROOT / "docs/reference/faults.md").read_text()
    assert all(f"`{name}`" in text for name in COMPONENTS)
