"""What happens when one of the two processes is killed, stopped or told to end in the midst of a run."""

import json
import signal
import time
from itertools import pairwise
from pathlib import Path

import pytest

from firmware_sim.frames import parse_command
from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import read
from tests.live.live_bench import (
    HEARTBEAT_AGE_MAX_S,
    LEVELS_AGE_MAX_S,
    PERIOD_S,
    PLAIN,
    WATCHDOG_S,
    Controller,
    controller,
    emulator,
    hil,
    lone_adapter,
    sent_s,
    wait_for,
    write_scenario,
)

pytestmark = pytest.mark.live

OFF = [0.0, 0.0]
TCP, PTY = ("--slcan", "0"), ("--pty",)


def trip_of(run: Controller):
    """The one trip in kpi.json; run.json must tell the same story."""
    kpi, manifest = run.json("kpi.json"), run.json("run.json")
    assert (kpi["status"], manifest["status"]) == ("tripped", "tripped")
    (trip,) = kpi["trips"]
    assert manifest["reason"].startswith(trip["cause"])
    return trip


over_both = pytest.mark.parametrize("transport", [TCP, PTY], ids=["tcp", "pty"])


@over_both
def test_case_24_a_killed_emulator_ends_the_run_by_itself(tmp_path: Path, transport: tuple[str, ...]) -> None:
    scenario = write_scenario(tmp_path)
    with (
        emulator(tmp_path / "node.jsonl", transport=transport) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs()
        rig.process.kill()
        started_s = time.monotonic()
        assert run.wait(10.0) == 3, (run.out, run.err)
        assert time.monotonic() - started_s < 8.0
    assert trip_of(run)["cause"] == "bus_failed"
    assert "has not confirmed 0 V" in run.json("run.json")["reason"]
    if transport is TCP:  # once is enough
        assert hil("report", run.folder).returncode == 0
        assert "bus_failed" in (run.folder / "report.html").read_text()


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory):
    """A controller killed in the midst of a run: its folder, the rig it left, and the node's record up to the trip."""
    folder = tmp_path_factory.mktemp("killed")
    scenario = write_scenario(folder, arm_timeout=1.0)
    with emulator(folder / "node.jsonl") as rig:
        with controller(scenario, rig.channel, folder / "run", is_forked=False) as run:
            rig.wait_until_it_runs(changes=25)
            run.process.kill()
            wait_for(lambda: rig.pump()[-1]["cause"] == "watchdog", timeout_s=2.0)
        yield run.folder, rig, rig.pump(), scenario


def test_case_49_a_killed_controller_leaves_the_pumps_at_zero_volts_within_the_watchdog_time(killed) -> None:
    """Lines are written when the output changes; noise changes it at almost every command."""
    *_, last, trip = killed[2]
    assert (trip["state"], trip["applied_V"], trip["cause"]) == ("tripped", OFF, "watchdog")
    assert (last["state"], last["cause"]) == ("run", "command")
    assert WATCHDOG_S - 1e-6 <= trip["t_s"] - last["t_s"] <= WATCHDOG_S + 2.5 * PERIOD_S


def test_case_49_a_killed_controller_over_a_pseudo_terminal_is_no_different(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, arm_timeout=1.0)
    with (
        emulator(tmp_path / "node.jsonl", transport=PTY) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=10)
        run.process.kill()
        wait_for(lambda: rig.pump()[-1]["cause"] == "watchdog", timeout_s=2.0)
        *_, last, trip = rig.pump()
    assert (trip["state"], trip["applied_V"]) == ("tripped", OFF)
    assert WATCHDOG_S - 1e-6 <= trip["t_s"] - last["t_s"] <= WATCHDOG_S + 2.5 * PERIOD_S


def test_case_49_a_killed_run_can_be_read_up_to_its_last_moments(killed) -> None:
    """The node's record tells when the last command came: the watchdog time before the trip."""
    folder, _, pump, _ = killed
    ticks, _ = read(RunFolder.open(folder))
    first_s = next(change["t_s"] for change in pump if change["cause"] == "command")
    ran_s = pump[-1]["t_s"] - WATCHDOG_S - first_s
    assert ran_s > 2.0
    assert ran_s - ticks["t_s"][-1] <= 0.3
    logged = sent_s(folder)
    assert len(logged) >= len(ticks)
    assert ran_s - (logged[-1] - logged[0]) <= 0.3 + PERIOD_S


def test_a_killed_run_is_reported_as_interrupted(killed) -> None:
    folder = killed[0]
    assert json.loads((folder / "run.json").read_text())["status"] == "running"
    done = hil("report", folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads((folder / "kpi.json").read_text())["status"] == "interrupted"
    assert "interrupted" in (folder / "report.html").read_text()


def test_after_a_kill_the_trip_stays_until_it_is_cleared_on_purpose(killed, tmp_path: Path) -> None:
    _, rig, pump, scenario = killed
    with controller(scenario, rig.channel, tmp_path / "refused", *PLAIN) as run:
        assert run.wait() == 4
        assert "not ready" in run.out
        assert "tripped" in run.out
    assert rig.pump()[len(pump) :] == [], "the node must not even have changed its state"
    with controller(scenario, rig.channel, tmp_path / "cleared", "--clear-trip", "--duration", 1, *PLAIN) as run:
        assert run.wait() == 0, (run.out, run.err)
        assert run.json("run.json")["status"] == "complete"
    causes = [change["cause"] for change in rig.pump()[len(pump) :]]
    assert causes[0] == "cleared"
    assert "command" in causes
    assert rig.pump()[-1]["applied_V"] == OFF


@pytest.mark.parametrize(
    ("number", "code", "transport"),
    [(signal.SIGTERM, 143, TCP), (signal.SIGINT, 130, TCP), (signal.SIGTERM, 143, PTY)],
    ids=["SIGTERM-tcp", "SIGINT-tcp", "SIGTERM-pty"],
)
def test_case_50_asked_to_end_it_ramps_down_and_closes_its_record(
    tmp_path: Path, number: signal.Signals, code: int, transport: tuple[str, ...]
) -> None:
    scenario = write_scenario(tmp_path)
    with (
        emulator(tmp_path / "node.jsonl", transport=transport) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=10)
        before = len(rig.pump())
        run.process.send_signal(number)
        assert run.wait(10.0) == code, (run.out, run.err)
        *ramp, last = rig.pump()[before - 1 :]
    assert (last["state"], last["applied_V"], last["cause"]) == ("ready", OFF, "disabled")
    assert last["t_s"] - ramp[0]["t_s"] <= 1.0
    first_volts = [change["applied_V"][0] for change in ramp]
    steps = [a - b for a, b in pairwise([*first_volts, 0.0])]
    assert max(steps) <= 20.0 * PERIOD_S + 0.01, "stop_ramp_V_s of the rig file"
    assert len([step for step in steps if step > 0.5]) >= 2, "a ramp, not a jump"
    manifest = run.json("run.json")
    assert (manifest["status"], manifest["reason"]) == ("stopped", number.name)
    assert run.json("kpi.json")["trips"] == []
    _, events = read(RunFolder.open(run.folder))
    assert events[-1].code == "end"


def test_asked_to_end_before_it_is_armed_it_ends_at_once(tmp_path: Path) -> None:
    """Nobody speaks on the bus, so that it waits for the rig until the signal comes."""
    scenario = write_scenario(tmp_path, arm_timeout=30.0)
    with lone_adapter() as (channel, sent), controller(scenario, channel, tmp_path / "run", *PLAIN) as run:
        wait_for(lambda: len(sent) >= 5, timeout_s=40.0)
        run.process.send_signal(signal.SIGTERM)
        assert run.wait(5.0) == 143, (run.out, run.err)
        assert run.json("run.json")["status"] == "stopped"
    assert not any(parse_command(frame).enable for frame in sent)


@over_both
def test_case_48_a_stopped_controller_trips_and_sends_no_burst_afterwards(
    tmp_path: Path, transport: tuple[str, ...]
) -> None:
    scenario = write_scenario(tmp_path)
    with (
        emulator(tmp_path / "node.jsonl", transport=transport) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=10)
        run.process.send_signal(signal.SIGSTOP)
        time.sleep(1.0)
        pump = rig.pump()
        assert (pump[-1]["state"], pump[-1]["applied_V"], pump[-1]["cause"]) == ("tripped", OFF, "watchdog")
        run.process.send_signal(signal.SIGCONT)
        assert run.wait(10.0) == 3, (run.out, run.err)
        assert rig.pump() == pump, "nothing moves a tripped node"
    times = sent_s(run.folder)
    gaps = [b - a for a, b in pairwise(times)]
    stall = max(range(len(gaps)), key=gaps.__getitem__)
    assert gaps[stall] > 0.9
    assert all(gap > 0.01 for gap in gaps[stall + 1 : -1]), "the last one is the very last 0 V, at once"
    assert len(gaps) - stall < 10
    assert run.json("kpi.json")["skipped"] >= 8
    assert trip_of(run)["cause"] == "node_tripped"


@over_both
def test_case_28_a_node_that_reads_nothing_trips_the_controller_and_refuses_the_backlog(
    tmp_path: Path, transport: tuple[str, ...]
) -> None:
    scenario = write_scenario(tmp_path)
    with (
        emulator(tmp_path / "node.jsonl", transport=transport) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=10)
        rig.process.send_signal(signal.SIGSTOP)
        assert run.wait(10.0) == 3, (run.out, run.err)
        rig.process.send_signal(signal.SIGCONT)
        wait_for(lambda: rig.pump()[-1]["cause"] == "watchdog")
        time.sleep(0.3)
        assert rig.pump()[-1]["cause"] == "watchdog", "the commands that waited in the line move nothing"
    trip = trip_of(run)
    assert trip["cause"] in ("stale_levels", "stale_status", "node_lost"), "all three fall silent together"
    ticks, _ = read(RunFolder.open(run.folder))
    at = ticks["t_s"].searchsorted(trip["t_s"] - 1e-6)
    # a heartbeat may have come a whole period before the stall and then runs out first
    assert HEARTBEAT_AGE_MAX_S - 0.1 - 0.02 < ticks["levels_age_s"][at] <= LEVELS_AGE_MAX_S + 2.0 * PERIOD_S
    assert ticks["v1_V"][at] == 0.0, "0 V in the very step that trips"
    assert "has not confirmed 0 V" in run.json("run.json")["reason"]
