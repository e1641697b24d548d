"""What a controller that was killed in the middle of a run leaves behind: the pumps off, and a record."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import read
from tests.live.live_bench import (
    PERIOD_S,
    PLAIN,
    WATCHDOG_S,
    Emulator,
    controller,
    emulator,
    hil,
    sent_s,
    write_scenario,
)
from tests.waiting import wait_for

pytestmark = pytest.mark.live

OFF = [0.0, 0.0]


Killed = tuple[Path, Emulator, list[dict[str, Any]], Path]


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Killed]:
    """A controller killed in the midst of a run: its folder, the rig it left, and the node's record up to the trip."""
    folder = tmp_path_factory.mktemp("killed")
    scenario = write_scenario(folder, arm_timeout=1.0)
    with emulator(folder / "node.jsonl") as rig:
        with controller(scenario, rig.channel, folder / "run", is_forked=False) as run:
            rig.wait_until_it_runs(changes=25)
            run.process.kill()
            wait_for(lambda: rig.pump()[-1]["cause"] == "watchdog", timeout_s=2.0)
        yield run.folder, rig, rig.pump(), scenario


def test_case_49_a_killed_controller_leaves_the_pumps_at_zero_volts_within_the_watchdog_time(killed: Killed) -> None:
    """Lines are written when the output changes; noise changes it at almost every command."""
    *_, last, trip = killed[2]
    assert (trip["state"], trip["applied_V"], trip["cause"]) == ("tripped", OFF, "watchdog")
    assert (last["state"], last["cause"]) == ("run", "command")
    assert WATCHDOG_S - 1e-6 <= trip["t_s"] - last["t_s"] <= WATCHDOG_S + 2.5 * PERIOD_S


def test_case_49_a_killed_run_can_be_read_up_to_its_last_moments(killed: Killed) -> None:
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


def test_a_killed_run_is_reported_as_interrupted(killed: Killed) -> None:
    folder = killed[0]
    assert json.loads((folder / "run.json").read_text())["status"] == "running"
    done = hil("report", folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads((folder / "kpi.json").read_text())["status"] == "interrupted"
    assert "interrupted" in (folder / "report.html").read_text()


def test_after_a_kill_the_trip_stays_until_it_is_cleared_on_purpose(killed: Killed, tmp_path: Path) -> None:
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
