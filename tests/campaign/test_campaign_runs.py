from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from hil.bench import assembly, campaign_pool, campaign_run, lockstep_run, run_options
from hil.bench.campaign_case import run_case
from hil.campaigns.cases import Case
from hil.campaigns.row import Row
from hil.campaigns.store import Store
from hil.campaigns.toml_text import toml_text
from hil.cli import campaign_command
from hil.edge.config.settings_file import SettingsError
from hil.edge.record.record_errors import RunFolderError
from tests.campaign.campaign_bench import CONFIG, GRID, campaign_file, cases_of, without_times

FEW = GRID.replace("[1, 2, [1, 2]]", "[1]").replace("[0.4, 0.8]", "[0.4]")


@pytest.fixture(scope="module")
def row(case: Case) -> Row:
    return run_case(case, CONFIG)


def run(file: Path, out: Path, **options: Any) -> int:
    return campaign_command.run(Console(quiet=True), str(file), campaign_run.CampaignOptions(out=out, **options))


def test_a_run_without_a_record_comes_to_what_the_recorded_one_comes_to(case: Case, row: Row, tmp_path: Path) -> None:
    """The same but for the digits of the record; the recorded run goes over python-can's virtual bus."""
    scenario = tmp_path / "case.toml"
    scenario.write_text(toml_text(case.scenario_data))
    kpi = lockstep_run.simulate(
        assembly.load(scenario), run_options.RunOptions(tmp_path / "run", seed=case.seed, rerun=False)
    )
    assert json.loads(row.iae_windows_json)["loss"] == pytest.approx(kpi.iae_Vs["loss"], rel=1e-3)
    assert (row.iae_after_fault_1_Vs, row.iae_after_fault_2_Vs) == pytest.approx(kpi.iae_after_fault_Vs, rel=1e-3)
    assert row.level_max_cm == pytest.approx(max(level for level in kpi.level_max_cm if level is not None))
    assert row.applied_max_V == pytest.approx(max(volts for volts in kpi.applied_max_V if volts is not None), abs=1e-4)
    assert json.loads(row.alarms_json)[0]["detected_s"] == pytest.approx(kpi.alarms[0]["detected_s"])
    assert (row.status, row.reason, row.commands_lost) == (kpi.status, kpi.reason, kpi.commands["commands_lost"])


def test_the_ideal_diagnosis_is_right_after_its_delay(row: Row) -> None:
    assert (row.detected, row.right, row.candidates_hold, row.flips) == (True, True, True, 0)
    assert row.detection_s == pytest.approx(1.05, abs=1e-6), "the step after the onset off the steps, and one second"
    assert (row.isolation_s, row.size_error_1s, row.size_error_5s) == (row.detection_s, 0.0, 0.0)
    assert (row.declared, row.kind, row.target, row.value) == (
        "pump_effectiveness 1", "pump_effectiveness", "1", 0.4,
    )  # fmt: skip
    assert (row.false_alarms, row.spurious_alarms, row.breaks, row.trip_cause) == (0, 0, (), "")
    assert row.healthy_h == pytest.approx(4.05 / 3600)
    assert row.hours == pytest.approx(12.2 / 3600, abs=0.3 / 3600)


def test_a_run_depends_on_nothing_but_its_case(case: Case, row: Row) -> None:
    assert without_times([run_case(case, CONFIG)]) == without_times([row])
    other = run_case(replace(case, seed=2), CONFIG)
    assert other.iae_1_Vs != row.iae_1_Vs


def test_nobody_to_say_anything_misses_the_fault(case: Case) -> None:
    silent = run_case(replace(case, scenario_data={**case.scenario_data, "diagnosis": {"method": "none"}}), CONFIG)
    assert (silent.detected, silent.right, silent.detection_s, silent.declared) == (False, False, None, "")


def test_the_bound_goes_into_the_row(case: Case) -> None:
    assert run_case(case, CONFIG, lambda asked: 0.25 if asked is case else None).bound_s == 0.25


HIGH = {"at_s": 1.0, "kind": "outlet_block", "target": 1, "value": 1.0}


def test_a_fault_that_begins_after_a_trip_is_not_judged(case: Case) -> None:
    """It used to count as one that was not found."""
    late = {"at_s": 150.0, "kind": "pump_effectiveness", "target": 1, "value": 0.4}
    changes = {"scenario": {"name": "high", "duration_s": 200.0}, "diagnosis": {"method": "none"}}
    data = {**case.scenario_data, **changes, "control": {"reconfigure": False}, "fault": [HIGH, late]}
    row = run_case(replace(case, scenario_data=data), CONFIG)
    assert row.trip_s is not None
    assert row.trip_s < 150.0
    assert (row.not_played, row.detected) == (1, False), "the blocked outlet was played, and not found"
    stopped = {**case.scenario_data, "request": [{"at_s": 2.0, "action": "stop"}]}
    row = run_case(replace(case, scenario_data=stopped), CONFIG)
    assert (row.not_played, row.detected, row.right, row.detection_s) == (1, None, None, None)


def test_faults_that_would_begin_after_the_end_are_refused_before_the_first_run(tmp_path: Path) -> None:
    """`--duration 200` with onsets drawn up to 300 s used to report faults that never began as not found, 0.0 %."""
    file = campaign_file(tmp_path, FEW)
    with pytest.raises(SettingsError, match=r"seed 5: pump_effectiveness begins at 3\.\d+ s.*ends at 2 s.*--duration"):
        run(file, tmp_path / "out", duration_s=2.0)
    with pytest.raises(SettingsError, match=r"begins at 4\.05 s, but the run ends at 4 s"):
        run(tmp_path / "short.toml", tmp_path / "out", duration_s=4.0, seeds=1)
    assert not (tmp_path / "out").exists()


def test_the_shipped_pump_losses_with_a_short_duration_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"pump_losses\.toml.*it would not be played"):
        run(CONFIG / "campaigns" / "pump_losses.toml", tmp_path / "out", duration_s=200.0)


def test_a_run_that_raises_is_a_row_that_says_so(case: Case) -> None:
    broken = run_case(
        replace(case, scenario_data={**case.scenario_data, "fault": [{"at_s": 1.0, "kind": "earthquake"}]}), CONFIG
    )
    assert broken.breaks == ("crashed",)
    assert "earthquake" in broken.reason


def test_a_trip_is_in_the_row_and_leaves_the_pumps_at_rest(case: Case) -> None:
    blocked = {"at_s": 1.0, "kind": "outlet_block", "target": 1, "value": 1.0}
    scenario_data = {
        **case.scenario_data,
        "diagnosis": {"method": "none"},
        "control": {"reconfigure": False},
        "fault": [blocked],
    }
    tripped = run_case(
        replace(case, scenario_data={**scenario_data, "scenario": {"name": "high", "duration_s": 200.0}}), CONFIG
    )
    assert (tripped.status, tripped.trip_cause) == ("tripped", "high_level")
    assert tripped.trip_s is not None
    assert tripped.breaks == ()


@pytest.mark.long
def test_a_campaign_that_was_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    file = campaign_file(tmp_path, FEW.replace("seeds = 3", "seeds = 12"))
    store = Store(tmp_path / "out")
    command: list[str | Path] = [sys.executable, "-c", "from hil.cli.app import main; main()", "campaign", file]
    process = subprocess.Popen([*command, "--processes", "1", "--out", store.path], stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60.0
    while len(store.rows()) < 2 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    left = store.rows()
    assert 2 <= len(left) < 12
    assert not store.table_path.exists()
    with store.rows_path.open("a") as rows:
        rows.write('{"key": "half a li')
    assert run(file, store.path, processes=1) == 0
    done = store.rows()
    assert len(done) == 12
    assert {key: done[key] for key in left} == left, "not run again"
    assert without_times(list(done.values())) == without_times(
        [run_case(c, CONFIG) for c in cases_in_order(file, done)]
    )


def cases_in_order(file: Path, done: dict[str, Row]) -> list[Case]:
    """The cases under the keys that the command gave them, which know of the bench's files."""
    _, cases = campaign_run.load(file, CONFIG, campaign_run.CampaignOptions())
    assert {case.key for case in cases} == set(done)
    return list(cases)


@pytest.mark.long
def test_dask_gives_the_same_rows_as_one_process(tmp_path: Path) -> None:
    file = campaign_file(tmp_path, FEW)
    assert run(file, tmp_path / "one", processes=1, report=False) == 0
    assert run(file, tmp_path / "two", processes=2, report=False) == 0
    one, two = (list(Store(tmp_path / name).rows().values()) for name in ("one", "two"))
    assert len(one) == 3
    assert without_times(one) == without_times(two)


def test_without_dask_one_process_does_it_and_more_are_refused_with_the_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(campaign_pool, "find_spec", lambda _: None)
    file = campaign_file(tmp_path, FEW)
    options = campaign_run.CampaignOptions(out=tmp_path / "out", seeds=1, duration_s=4.5, report=False)
    assert campaign_command.run(Console(width=200), str(file), options) == 0
    assert "pip install 'fourtank-hil[campaign]'" in capsys.readouterr().out
    with pytest.raises(SettingsError, match=r"--processes 2 needs Dask.*pip install"):
        run(file, tmp_path / "no", processes=2)
    with pytest.raises(SettingsError, match="--scheduler needs Dask"):
        run(file, tmp_path / "no", scheduler="tcp://127.0.0.1:1")


def test_broken_invariants_are_the_exit_code_and_leave_their_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = campaign_file(tmp_path, FEW)
    monkeypatch.setattr(
        campaign_pool, "run_case", lambda case, config: replace(run_case(case, config), overflow=case.seed == 6)
    )
    assert run(file, tmp_path / "out", processes=1, duration_s=4.5) == 3
    (kept,) = (tmp_path / "out" / "cases").iterdir()
    assert assembly.load(kept).scenario.scenario.duration_s == 4.5
    assert "broken in 1 run" in (tmp_path / "out" / "report.html").read_text()


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    file = campaign_file(tmp_path, FEW)
    with pytest.raises(RunFolderError, match="no campaign's folder"):
        run(file, tmp_path)
    Store.open(tmp_path / "other", {"name": "other"})
    with pytest.raises(RunFolderError, match="belongs to the campaign 'other'"):
        run(file, tmp_path / "other")


def test_the_same_case_twice_is_refused(tmp_path: Path) -> None:
    file = campaign_file(tmp_path, FEW.replace("values = [0.4]", "values = [0.4, 0.4]"))
    with pytest.raises(SettingsError, match="same case twice"):
        run(file, tmp_path / "out")
    assert len(cases_of(file)) == 6
