"""A whole run by the console scripts, one with real-time scheduling, the start of the timeline: timed, alone."""

import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hil.edge.record.rerun_log import RerunLog, RunCard
from hil.edge.record.run_folder import RunFolder
from hil.review.blueprint import blueprint
from hil.review.ticks import read
from tests.live.live_bench import (
    PERIOD_S,
    PLAIN,
    Controller,
    Emulator,
    controller,
    emulator,
    sent_s,
    write_scenario,
)

pytestmark = [pytest.mark.live, pytest.mark.timing]
FILES = {"run.json", "can.log", "sent.log", "ticks.csv", "events.jsonl", "run.rrd", "kpi.json", "report.html"}


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Controller, Emulator]]:
    """10 s over TCP with a reference step and a fault, by the console scripts: the controller and the node's record."""
    folder = tmp_path_factory.mktemp("live")
    scenario = write_scenario(folder, duration=10.0)
    with (
        emulator(folder / "node.jsonl", scenario=scenario, is_forked=False) as rig,
        controller(scenario, rig.channel, folder / "run", is_forked=False) as run,
    ):
        assert run.wait(60.0) == 0, (run.out, run.err)
        yield run, rig


def test_a_whole_run_leaves_every_file(whole_run: tuple[Controller, Emulator]) -> None:
    run, _ = whole_run
    assert {path.name for path in run.folder.iterdir()} == FILES
    assert all(path.stat().st_size > 0 for path in run.folder.iterdir())
    manifest = run.json("run.json")
    assert (manifest["status"], manifest["reason"], manifest["mode"]) == ("complete", "duration over", "live")
    assert manifest["recorder"] == {"errors": [], "dropped": 0}
    assert "live: complete" in run.out


def test_a_whole_run_loses_no_command_and_no_frame(whole_run: tuple[Controller, Emulator]) -> None:
    run, rig = whole_run
    kpi = run.json("kpi.json")
    assert (kpi["commands"]["commands_lost"], kpi["commands"]["frames_lost"]) == (0, 0)
    assert {name: n for name, n in kpi["commands"].items() if name.startswith("line_")} == {
        "line_refused": 0,
        "line_dropped": 0,
    }
    assert len(sent_s(run.folder)) - kpi["commands"]["commands_sent"] in (0, 1), (
        "the very last 0 V is sent after the count"
    )
    assert (kpi["rejected"], kpi["trips"]) == (0, [])
    assert rig.commanded()


def test_a_whole_run_keeps_its_time(whole_run: tuple[Controller, Emulator]) -> None:
    """One step in a hundred may be skipped: where tests run, other processes may hold the processor for 0.1 s."""
    kpi = whole_run[0].json("kpi.json")
    assert kpi["skipped"] <= 1
    assert kpi["ticks"] == pytest.approx(100, abs=2)
    assert kpi["lateness_s"]["p50"] < 0.005
    assert kpi["speed_x"] == pytest.approx(1.0, abs=0.2)


def test_commands_go_out_once_a_period(whole_run: tuple[Controller, Emulator]) -> None:
    times = sent_s(whole_run[0].folder)
    gaps = sorted(b - a for a, b in pairwise(times[:-1]))
    assert gaps[len(gaps) // 2] == pytest.approx(PERIOD_S, abs=0.005)
    assert gaps[1] > 0.3 * PERIOD_S, "a burst"


def test_the_node_ends_ready_at_zero_volts(whole_run: tuple[Controller, Emulator]) -> None:
    last = whole_run[1].pump()[-1]
    assert (last["state"], last["applied_V"], last["cause"]) == ("ready", [0.0, 0.0], "disabled")


def test_the_controller_follows_the_reference_and_notices_the_fault(whole_run: tuple[Controller, Emulator]) -> None:
    run, _ = whole_run
    ticks, events = read(RunFolder.open(run.folder))
    kpi = run.json("kpi.json")
    assert [(alarm["target"], alarm["size"]) for alarm in kpi["alarms"]] == [(1, 0.7)]
    assert set(kpi["iae_Vs"]) == {"after_the_step"}
    assert kpi["iae_source"] == "estimate"
    assert ticks["r1_V"][-1] - ticks["r1_V"][0] == pytest.approx(0.2)
    assert 3.0 < kpi["applied_max_V"][0] < 10.0
    assert events[-1].code == "end"


def test_applied_voltages_in_the_record_are_the_nodes_own(whole_run: tuple[Controller, Emulator]) -> None:
    run, rig = whole_run
    ticks, _ = read(RunFolder.open(run.folder))
    own = np.array([change["applied_V"][0] for change in rig.pump()])
    far_V = [np.min(np.abs(own - seen)) for seen in ticks["v1_applied_V"]]
    assert max(far_V) <= 0.0001 + 1e-9, "half a step of the wire's 0.2 mV"


def test_a_run_in_real_time_completes_with_whatever_is_granted(tmp_path: Path) -> None:
    """Where the tests may not use SCHED_FIFO, the refusal is said and recorded, and the run goes on."""
    scenario = write_scenario(tmp_path, duration=3.0)
    with (
        emulator(tmp_path / "node.jsonl", scenario=scenario, is_forked=False) as rig,
        controller(scenario, rig.channel, tmp_path / "run", "--realtime", *PLAIN, is_forked=False) as run,
    ):
        assert run.wait(40.0) == 0, (run.out, run.err)
    _, events = read(RunFolder.open(run.folder))
    said = [event.text for event in events if event.code in ("ideal_live", "realtime")]
    assert run.err.splitlines() == [f"hil: {text}" for text in said], "what the scenario warns of, and what is refused"
    assert "READY -> RUNNING" in run.out, "events are lines"
    kpi = run.json("kpi.json")
    assert set(kpi["lateness_s"]) == {"p50", "p99", "p99_9", "max"}
    assert 0.0 < kpi["latency_s"]["p50"] <= kpi["latency_s"]["max"] < 2 * PERIOD_S
    assert kpi["recorder_queue_max"] < 1000


def test_case_54_no_viewer_at_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """There is no viewer, no screen and nothing to start one with: the timeline opens within 0.5 s all the same."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", "")
    began_s = time.perf_counter()
    card, layout = RunCard("t", {}, ""), blueprint("live", 10.0)
    log = RerunLog(tmp_path / "run.rrd", card, level_gain_V_cm=0.5, mode="live", blueprint=layout)
    assert time.perf_counter() - began_s < 0.5
    log.close()
    assert (tmp_path / "run.rrd").stat().st_size > 0
