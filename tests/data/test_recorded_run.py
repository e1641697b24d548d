"""`hil.open_run`: the tables of a run folder have what its files have, with units."""

from __future__ import annotations

import builtins
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.edge.record.signals import recorded

SCENARIO = """
[scenario]
name = "fault"
duration_s = 6.0

[[fault]]
at_s = 3.0
kind = "pump_effectiveness"
target = 1
value = 0.5

[diagnosis]
method = "ideal"

[[window]]
name = "before"
from_s = 0.0
to_s = 3.0

[[window]]
name = "never"
from_s = 100.0
to_s = 200.0
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> hil.RunResult:
    folder = tmp_path_factory.mktemp("runs")
    (folder / "fault.toml").write_text(SCENARIO)
    return hil.simulate(folder / "fault.toml", out=folder / "run", rerun=False)


@pytest.fixture(scope="module")
def run(made: hil.RunResult) -> hil.RecordedRun:
    assert made.folder is not None
    return hil.open_run(made.folder)


def test_ticks_are_the_columns_of_the_file_by_run_time(run: hil.RecordedRun, made: hil.RunResult) -> None:
    assert run.ticks.index.name == "t_s"
    assert list(run.ticks.columns) == [signal.column for signal in recorded("lockstep", made.manifest.plan.shown)][1:]
    for name in run.ticks.columns:
        np.testing.assert_array_equal(run.ticks[name].to_numpy(dtype=float), made.series[name], err_msg=name)
    np.testing.assert_array_equal(run.ticks.index.to_numpy(), made.series["t_s"])
    assert run.ticks["mode"].dtype == np.int64
    assert run.ticks is run.ticks, "read once"


def test_units_stand_in_the_attributes_and_survive_a_selection(run: hil.RecordedRun) -> None:
    units = run.ticks.attrs["units"]
    assert (units["t_s"], units["h1_V"], units["true_h1_cm"], units["mode"]) == ("s", "V", "cm", "")
    assert run.ticks.loc[1.0:2.0, ["h1_V"]].attrs["units"]["h1_V"] == "V"
    assert run.columns.loc["K15", "unit"] == "1/s"
    assert "effectiveness of pump 1" in run.columns.loc["theta1", "meaning"]


def test_some_columns_alone(run: hil.RecordedRun) -> None:
    fresh = hil.open_run(run.path)
    for one in (fresh, run):
        table = one.select("v1_V", "theta1")
        assert list(table.columns) == ["v1_V", "theta1"]
        assert table.equals(run.ticks[["v1_V", "theta1"]])
    with pytest.raises(hil.RunFolderError, match=r"ticks\.csv has no column v9_V"):
        fresh.select("v9_V")


def test_frames_are_those_of_the_log_in_run_time(run: hil.RecordedRun) -> None:
    lines = (run.path / "can.log").read_text().splitlines()
    assert len(run.frames) == len(lines)
    first, commands = run.frames.iloc[0], run.frames[run.frames["message"] == "PumpCommand"]
    assert f"{first['arbitration_id']:03X}#{first['data'].hex().upper()}" == lines[0].split(" ")[2]
    assert (first["kind"], first["channel"]) == ("data", "can0")
    assert len(commands) == len((run.path / "sent.log").read_text().splitlines())
    assert commands.index[0] < run.ticks.index[0] == 0.0, "the pumps are armed before the first control step"
    is_near = np.abs(commands.index.to_numpy()[:, None] - run.ticks.index.to_numpy()).min(axis=0) < 0.01
    assert is_near.all(), "a command belongs to each control step"
    assert (commands["data"].map(len) == commands["length"]).all()


def test_signals_are_decoded_by_the_runs_own_dbc(run: hil.RecordedRun) -> None:
    assert {"PumpCommand", "PumpStatus", "LowerLevels"} <= set(run.signals)
    levels = run.signals["LowerLevels"]
    assert levels.attrs["units"]["Level1"] == "V"
    assert levels.index.name == "t_s"
    tick = run.at(2.0)
    assert tick["h1_V"] == pytest.approx(levels.loc[:2.0, "Level1"].iloc[-1], abs=2e-4)
    with pytest.raises(KeyError, match="no message 'Levels'; it has "):
        run.signals["Levels"]


def test_events_and_alarms_are_those_of_the_run(run: hil.RecordedRun, made: hil.RunResult) -> None:
    assert list(run.events["code"]) == [event.code for event in made.events]
    assert list(run.events["data"]) == [dict(event.data) for event in made.events]
    (alarm,) = run.alarms.itertuples()
    assert (alarm.kind, alarm.target, alarm.size, alarm.detected_s) == ("pump_effectiveness", 1, 0.5, 4.0)
    assert run.alarms.attrs["units"]["detected_s"] == "s"
    assert np.isnan(alarm.recovered_s)


def test_figures_and_settings_are_series_by_path(run: hil.RecordedRun, made: hil.RunResult) -> None:
    kept = json.loads((run.path / "kpi.json").read_text())
    assert run.figures == kept
    assert run.kpi["iae_Vs.before[1]"] == made.iae_Vs["before"][1]
    assert run.kpi["alarms[0].kind"] == "pump_effectiveness"
    assert run.config["scenario.fault[0].value"] == 0.5
    assert run.settings["rig"]["tanks"]["area_cm2"][3] == run.config["rig.tanks.area_cm2[3]"]


def test_windows_at_and_length(run: hil.RecordedRun, made: hil.RunResult) -> None:
    assert run.windows.loc["before", "iae1_Vs"] == made.iae_Vs["before"][0]
    assert np.isnan(run.windows.loc["never", "iae2_Vs"])
    assert run.window("before").index[-1] == 3.0
    with pytest.raises(KeyError, match="no window 'after'; it has before, never"):
        run.window("after")
    assert run.at(4.05).name == 4.0
    assert run.at(4.0).equals(run.at(4.09))
    with pytest.raises(ValueError, match=r"t_s = 9\.0: the record is from 0 to 6\.\d s"):
        run.at(9.0)
    assert len(run) == len(hil.open_run(run.path)) == len(made.series["t_s"])
    assert run, "also one without a step"


def test_what_a_notebook_shows(run: hil.RecordedRun) -> None:
    assert f"scenario fault, status complete (duration over), {len(run)} control steps, alarms 1, trips 0" in repr(run)
    assert "IAE before 0." in repr(run)
    assert "never" not in repr(run), "the window was not reached"
    assert "<th>status</th><td>complete (duration over)</td>" in run._repr_html_()
    assert (run.status, run.reason, run.seed, run.period_s) == ("complete", "duration over", 1, 0.1)
    assert run.started.tzinfo is not None


def test_an_interrupted_run_with_half_a_line_is_read(run: hil.RecordedRun, tmp_path: Path) -> None:
    cut = shutil.copytree(run.path, tmp_path / "cut")
    manifest = json.loads((cut / "run.json").read_text())
    (cut / "run.json").write_text(json.dumps(manifest | {"status": "running"}))
    (cut / "kpi.json").unlink()
    for name in ("ticks.csv", "events.jsonl", "can.log"):
        text = (cut / name).read_text()
        (cut / name).write_text(text[: len(text) - 9])
    broken = hil.open_run(cut)
    assert broken.status == "interrupted"
    assert len(broken) == len(broken.ticks) == len(run) - 1
    assert len(broken.events) == len(run.events) - 1
    assert len(broken.frames) == len(run.frames) - 1
    assert broken.kpi["iae_Vs.before[0]"] == pytest.approx(run.kpi["iae_Vs.before[0]"], rel=1e-9)


def test_what_can_t_be_read_is_an_error_with_the_file(run: hil.RecordedRun, tmp_path: Path) -> None:
    with pytest.raises(hil.RunFolderError, match=r"none is not a run folder: it has no run\.json"):
        hil.open_run(tmp_path / "none")
    damaged = shutil.copytree(run.path, tmp_path / "damaged")
    (damaged / "kpi.json").write_text("[")
    (damaged / "ticks.csv").write_text("t_s,mode\n1.0,x\n")
    with pytest.raises(hil.RunFolderError, match=r"kpi\.json can't be read"):
        hil.open_run(damaged).kpi  # noqa: B018 - the access is the test
    with pytest.raises(hil.RunFolderError, match=r"ticks\.csv is damaged"):
        hil.open_run(damaged).ticks  # noqa: B018


def test_polars_tables_have_the_same_rows(run: hil.RecordedRun) -> None:
    polars = pytest.importorskip("polars")
    ticks = run.polars.ticks
    assert isinstance(ticks, polars.DataFrame)
    assert ticks.columns[:2] == ["t_s", "mode"]
    assert ticks["v1_V"].to_list() == run.ticks["v1_V"].to_list()
    assert run.polars.frames["data"][0] == run.frames["data"].iloc[0]
    assert run.polars.alarms["candidates"].to_list() == [list(run.alarms["candidates"][0])]
    assert len(run.polars.events) == len(run.events)
    assert set(run.polars.signals) == set(run.signals)
    assert run.polars.windows["window"].to_list() == ["before", "never"]


def test_without_polars_the_error_says_what_to_install(run: hil.RecordedRun, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name == "polars":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(hil.HilError, match="polars is not installed: `pip install polars`"):
        run.polars  # noqa: B018


def test_runs_lists_the_folders_below(run: hil.RecordedRun, tmp_path: Path) -> None:
    table = hil.runs(run.path.parent)
    assert list(table.index) == ["run"]
    assert table.loc["run", ["status", "scenario", "seed", "alarms"]].tolist() == ["complete", "fault", 1, 1]
    assert table.loc["run", "iae_Vs.before[0]"] == run.figures["iae_Vs"]["before"][0]
    assert table.loc["run", "started"] == run.started
    assert hil.open_run(table.loc["run", "path"]).scenario == "fault"
    with pytest.raises(hil.RunFolderError, match="no such folder"):
        hil.runs(tmp_path / "none")
    assert len(hil.runs(tmp_path)) == 0
