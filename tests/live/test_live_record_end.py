"""The end of a run in real time when its record can't be closed: the pumps are off before anything can wait or fail."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest

from hil.cli.exit_codes import INCOMPLETE
from tests.live.live_bench import BIN, PLAIN, Controller, Emulator, child, controller, emulator, hil, write_scenario
from tests.waiting import wait_for

pytestmark = pytest.mark.live


def recorder_of(run: Controller) -> int:
    """Process id of the run's recorder."""
    return child(run, "recorder_process")


def is_at_rest(rig: Emulator) -> bool:
    """Whether the node has been told 0 V, disabled; not by its watchdog."""
    last = rig.pump()[-1]
    return (last["state"], last["applied_V"], last["cause"]) == ("ready", [0.0, 0.0], "disabled")


def test_a_recorder_that_is_stuck_does_not_keep_the_pumps_on(tmp_path: Path) -> None:
    """Its disk answers no more, so that closing it waits; 0 V was sent and confirmed before."""
    scenario = write_scenario(tmp_path, duration=3.0)
    with (
        emulator(tmp_path / "node.jsonl") as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=10)
        recorder = recorder_of(run)
        os.kill(recorder, signal.SIGSTOP)
        try:
            wait_for(lambda: is_at_rest(rig), timeout_s=20.0)
            assert run.process.poll() is None, "the record is still to be closed"
            assert run.json("run.json")["status"] == "running"
        finally:
            os.kill(recorder, signal.SIGCONT)
        assert run.wait(40.0) == 0, (run.out, run.err)
        assert is_at_rest(rig)
    manifest = run.json("run.json")
    assert (manifest["status"], manifest["recorder"]) == ("complete", {"errors": [], "dropped": 0})


def test_ctrl_c_again_does_not_wait_for_the_recorder(tmp_path: Path) -> None:
    """The first stops the run, the second waits for the record, the third doesn't.

    The recorder has been told how the run ended, and writes it when its disk answers again.
    """
    scenario = write_scenario(tmp_path)
    with (
        emulator(tmp_path / "node.jsonl") as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=10)
        recorder = recorder_of(run)
        os.kill(recorder, signal.SIGSTOP)
        try:
            run.process.send_signal(signal.SIGINT)
            wait_for(lambda: is_at_rest(rig), timeout_s=20.0)
            while run.process.poll() is None:
                run.process.send_signal(signal.SIGINT)
                with suppress(subprocess.TimeoutExpired):
                    run.process.wait(0.5)
            assert is_at_rest(rig)
        finally:
            os.kill(recorder, signal.SIGCONT)
        assert run.wait(10.0) == 130, (run.out, run.err)
        assert run.err.splitlines()[-1] == "hil: interrupted"
    wait_for(lambda: not Path(f"/proc/{recorder}").exists(), timeout_s=20.0)
    assert run.json("run.json")["status"] in ("stopped", "running"), "true, or unfinished if it came too early"
    assert hil("report", run.folder).returncode == 0


def test_standard_output_on_a_full_device_does_not_touch_the_run(tmp_path: Path) -> None:
    """The status table and the results can't be shown: one line at the end, a whole record, pumps off."""
    scenario, folder = write_scenario(tmp_path, duration=2.0), tmp_path / "run"
    with emulator(tmp_path / "node.jsonl") as rig, Path("/dev/full").open("w") as full:
        command: list[str | Path] = [
            BIN / "hil",
            "run",
            scenario,
            "-i",
            "slcan",
            "-c",
            rig.channel,
            "--out",
            folder,
            *PLAIN,
        ]
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, timeout=60.0, start_new_session=True
        )
        assert (done.returncode, done.stderr.splitlines()[-1]) == (
            INCOMPLETE,
            "hil: standard output: No space left on device",
        )
        assert "Traceback" not in done.stderr
        assert is_at_rest(rig)
    assert json.loads((folder / "run.json").read_text())["status"] == "complete"
    assert json.loads((folder / "kpi.json").read_text())["trips"] == []
