"""The process that serves clients gets the processors after the control thread."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from hil.edge.host.background import NICE
from tests.control.control_bench import Bench


def test_the_process_of_the_clients_steps_back_behind_the_control_thread(bench: Bench) -> None:
    """It had a nice value that counted only in its own session, where it is alone."""
    folder = Path(f"/proc/{bench.channel._process.pid}")
    nice = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[16])
    assert nice >= NICE
    if (folder / "autogroup").exists() and (group := (folder / "autogroup").read_text()):
        assert int(group.split()[-1]) == NICE


def test_without_groups_of_processes_it_is_the_nice_value_alone(tmp_path: Path) -> None:
    code = (
        "import os, pathlib, sys; from hil.edge.host.background import step_back; "
        "step_back(pathlib.Path(sys.argv[1])); print(os.nice(0), os.sched_getscheduler(0) == os.SCHED_BATCH)"
    )
    made = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "none" / "autogroup"], capture_output=True, text=True, check=True
    )
    nice, is_batch = made.stdout.split()
    assert (int(nice) >= NICE, is_batch) == (True, "True")
