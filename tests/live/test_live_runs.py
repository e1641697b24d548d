"""Runs in real time over slcan, by TCP and by pseudo-terminal, and the record that they leave."""

import json
import os
import signal
from pathlib import Path

import pytest

from hil.cli.exit_codes import INCOMPLETE
from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import read
from tests.live.live_bench import (
    CONFIG,
    PLAIN,
    child,
    controller,
    emulator,
    hil,
    write_scenario,
)

pytestmark = pytest.mark.live
FILES = {"run.json", "can.log", "sent.log", "ticks.csv", "events.jsonl", "run.rrd", "kpi.json", "report.html"}


def test_a_run_over_a_pseudo_terminal_is_no_different(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, duration=3.0)
    with (
        emulator(tmp_path / "node.jsonl", scenario=scenario, transport=("--pty",)) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        assert run.wait() == 0, (run.out, run.err)
        kpi = run.json("kpi.json")
        assert (kpi["status"], kpi["commands"]["commands_lost"], kpi["trips"]) == ("complete", 0, [])
        assert kpi["ticks"] == pytest.approx(30, abs=2)
        last = rig.pump()[-1]
        assert (last["state"], last["applied_V"]) == ("ready", [0.0, 0.0])


ROUNDED_S = 1e-8
"""Times in ticks.csv have so many digits; the last step written and the event may be of the same step."""


def test_a_recorder_that_is_killed_does_not_stop_the_run(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, duration=5.0)
    with (
        emulator(tmp_path / "node.jsonl", scenario=scenario) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=15)
        os.kill(child(run, "recorder_process"), signal.SIGKILL)
        assert run.wait(40.0) == INCOMPLETE, (run.out, run.err)
        last = rig.pump()[-1]
    assert (last["state"], last["applied_V"], last["cause"]) == ("ready", [0.0, 0.0], "disabled")
    assert rig.pump()[-1]["t_s"] > 4.0
    assert run.err.splitlines()[-1] == (
        f"hil: {run.folder}: the record is incomplete: {run.json('run.json')['recorder']['errors'][0]} (and 1 more); "
        "the run: complete, duration over"
    )
    manifest = run.json("run.json")
    assert manifest["status"] == "complete"
    assert "the recorder is lost" in manifest["recorder"]["errors"][0]
    ticks, events = read(RunFolder.open(run.folder))
    assert events[-1].code == "recorder_lost"
    assert 1.0 < ticks["t_s"][-1] <= events[-1].t_s + ROUNDED_S, "what it had written is there"
    assert hil("report", run.folder).returncode == 0


def test_a_node_built_for_another_dbc_is_never_armed(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, arm_timeout=1.0)
    config = tmp_path / "config"
    config.mkdir()
    for name in ("rig.toml", "emulator.toml", "bench.dbc"):
        (config / name).write_text((CONFIG / name).read_text())
    (config / "bench.dbc").write_text((CONFIG / "bench.dbc").read_text().replace("Voltage of pump 1", "Volts, pump 1"))
    with (
        emulator(tmp_path / "node.jsonl", "--config", config) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        assert run.wait() == 4
        assert "a node was built for another DBC" in run.out
        assert run.json("run.json")["status"] == "failed"
        assert run.json("run.json")["reason"] == "not ready within 1 s: a node was built for another DBC"
        assert not rig.has_ever_applied()
        assert rig.commanded() == []


BAD = {
    "bad scenario": ("[rig]\npumps.range_V = [10.0, 0.0]", ()),
    "folder that can't be made": ("", ("--out", "/proc/here/x")),
}


def test_bad_input_moves_nothing_on_a_rig_that_is_there(tmp_path: Path) -> None:
    with emulator(tmp_path / "node.jsonl") as rig:
        for name, (more, options) in BAD.items():
            scenario = tmp_path / f"{name.replace(' ', '_')}.toml"
            scenario.write_text(f'[scenario]\nname = "x"\nduration_s = 5.0\n{more}')
            out = () if "--out" in options else ("--out", tmp_path / "run")
            done = hil("run", scenario, "-i", "slcan", "-c", rig.channel, *out, *options)
            assert done.returncode == 2, (name, done)
            assert done.stderr.count("\n") == 1, (name, done)
            assert not (tmp_path / "run").exists(), name
        assert [json.dumps(change["applied_V"]) for change in rig.pump()] == ["[0.0, 0.0]"] * 2  # boot, booted
