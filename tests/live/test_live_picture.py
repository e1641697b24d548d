"""A run that is shown while it goes on: no viewer, whatever it does, costs a step or a part of the record."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

from hil.review.viewer import free_port
from tests.live.live_bench import Controller, controller, emulator, write_scenario
from tests.waiting import wait_for

pytestmark = [pytest.mark.live, pytest.mark.timing]


@contextmanager
def reader(port: int, copy: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A viewer's program without a window, which writes what it is sent to a file."""
    command = [sys.executable, "-m", "rerun_cli", f"rerun+http://127.0.0.1:{port}/proxy", "--save", str(copy)]
    process = subprocess.Popen(
        [*command, "--bind", "127.0.0.1", "--port", str(free_port())],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def data_port(run: Controller) -> int:
    """Where the run is served: the second port of the address that it has said."""
    assert run.process.stderr is not None
    line = run.process.stderr.readline()
    found = re.search(r"live: http://127\.0\.0\.1:\d+/\?url=rerun%2Bhttp%3A%2F%2F127\.0\.0\.1%3A(\d+)%2Fproxy", line)
    assert found, line
    return int(found[1])


def test_viewers_that_are_late_stopped_or_killed_cost_nothing(tmp_path: Path) -> None:
    """One gets the run from its start though it came late; one is stopped and never reads again; one is killed."""
    scenario = write_scenario(tmp_path, duration=14.0)
    copy = tmp_path / "copy.rrd"
    with (
        emulator(tmp_path / "node.jsonl", scenario=scenario, is_forked=False) as rig,
        controller(scenario, rig.channel, tmp_path / "run", "--live-web", is_forked=False) as run,
    ):
        port = data_port(run)
        rig.wait_until_it_runs(20)
        with reader(port, tmp_path / "stopped.rrd") as stopped, reader(port, tmp_path / "killed.rrd") as killed:
            wait_for(lambda: (tmp_path / "stopped.rrd").exists() and (tmp_path / "killed.rrd").exists(), timeout_s=8.0)
            os.killpg(stopped.pid, signal.SIGSTOP)
            os.killpg(killed.pid, signal.SIGKILL)
            with reader(port, copy):
                assert run.wait(60.0) == 0, (run.out, run.err)
    manifest, kpi = run.json("run.json"), run.json("kpi.json")
    assert manifest["recorder"] == {"errors": [], "dropped": 0}
    assert kpi["skipped"] <= 1, "as in a run without viewers: other processes of the machine may hold it up"
    assert kpi["ticks"] == pytest.approx(140, abs=2)
    times = times_of(copy, "/levels/tank1")
    assert min(times) == 0.0
    assert max(times) > 10.0
    assert max(times_of(tmp_path / "run" / "run.rrd", "/levels/tank1")) > 13.5


def times_of(path: Path, entity: str) -> list[float]:
    """Run times of an entity's rows, s."""
    found: list[float] = []
    for chunk in RrdReader(path).stream().to_chunks():
        if chunk.entity_path == entity and not chunk.is_static:
            found += [cell.value * 1e-9 for cell in chunk.to_record_batch().column("run_time")]
    return found
