"""load, simulate, design and campaign of `import hil`, called as a script would."""

import json
from concurrent.futures import ThreadPoolExecutor
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.campaigns.row import Row
from hil.core.gain_design import Gains
from hil.core.tanks import LinearModel

SHORT = """
[scenario]
name = "short"
duration_s = 6.0

[[fault]]
at_s = 3.0
kind = "pump_effectiveness"
target = 1
value = 0.5

[diagnosis]
method = "ideal"

[[window]]
name = "all"
from_s = 0.0
to_s = 6.0
"""


@pytest.fixture
def scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    return path


class Halved:
    """The rig's own gains, halved: stable, and not what any name stands for."""

    follows_reference = True

    def __init__(self, scale: float = 0.5) -> None:
        self._design = hil.load("paper").rig
        self._scale = scale

    def gains(self, linear: LinearModel) -> Gains:
        from hil.bench.designs import rig_design
        from hil.core.gain_design import gain_matrix

        return hil.Gains.from_matrix(self._scale * gain_matrix(rig_design(self._design).gains(linear)))


class Fixed:
    """A detector that reports one effectiveness for ever."""

    def start(self) -> None:
        return None

    def step(self, memory: None, *_: object) -> tuple[None, hil.Diagnosis]:
        return memory, hil.Diagnosis((0.8, 1.0))


def test_a_run_in_memory_has_the_figures_of_the_recorded_one_and_leaves_no_file(scenario: Path, tmp_path: Path) -> None:
    in_memory = hil.simulate(scenario)
    assert [path.name for path in tmp_path.iterdir()] == ["short.toml"]
    recorded = hil.simulate(scenario, out="run", rerun=False)
    kept = json.loads((tmp_path / "run" / "kpi.json").read_text())
    figures = json.loads(json.dumps(in_memory.figures()))
    assert figures.pop("speed_x") is not None
    kept.pop("speed_x")
    assert figures == kept
    assert recorded.folder is not None
    assert in_memory.folder is None
    assert set(in_memory.series) == set(recorded.series)
    for name, column in in_memory.series.items():
        np.testing.assert_array_equal(column, recorded.series[name], err_msg=name)
    assert in_memory.events == recorded.events


def test_a_result_has_series_alarms_and_events(scenario: Path) -> None:
    result = hil.simulate(scenario)
    assert (result.status, result.reason) == ("complete", "duration over")
    (alarm,) = result.alarms
    assert (alarm.kind, alarm.target, alarm.size, alarm.detected_s) == ("pump_effectiveness", 1, 0.5, 4.0)
    assert result.series["t_s"][0] == 0.0
    assert not result.series["theta1"].flags.writeable
    assert any(event.code == "reconfigured" for event in result.events)
    assert "complete" in repr(result)
    assert "<html" in result.report("report.html").read_text()


def test_equal_seeds_give_equal_results_and_other_seeds_do_not(scenario: Path) -> None:
    first, again, other = (hil.simulate(scenario, seed=seed, duration_s=2.0) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.series["h1_V"], again.series["h1_V"])
    assert not np.array_equal(first.series["h1_V"], other.series["h1_V"])


def test_a_design_and_a_detector_of_ones_own_are_used_and_named_in_the_record(scenario: Path) -> None:
    result = hil.simulate(scenario, design=Halved(), detector=Fixed())
    settings = result.manifest.plan.settings["scenario"]
    assert (settings["control"]["design"], settings["diagnosis"]["method"]) == ("Halved", "Fixed")
    assert result.series["theta1"][0] == 0.8
    rig = hil.simulate(scenario, detector=Fixed())
    assert result.series["K11"][0] == pytest.approx(0.5 * rig.series["K11"][0], rel=1e-5)


def test_a_design_of_ones_own_that_does_not_stabilise_the_rig_is_refused(scenario: Path) -> None:
    with pytest.raises(hil.SettingsError, match=r"design 'Halved'.*does not stabilise this rig.*must be negative"):
        hil.load(scenario, design=Halved(-0.1))


def test_names_choose_a_design_and_a_detector(scenario: Path) -> None:
    bench = hil.load(scenario, design="calibrated", detector="none")
    assert (bench.scenario.control.design, bench.scenario.diagnosis.method) == ("calibrated", "none")
    with pytest.raises(hil.SettingsError, match=r"control\.design = 'pid': must be one of rig, calibrated"):
        hil.load(scenario, design="pid")
    with pytest.raises(hil.SettingsError, match=r"diagnosis\.method = 'oracle': must be one of glr, ideal, none"):
        hil.load(scenario, detector="oracle")


def test_what_was_loaded_is_not_chosen_again(scenario: Path) -> None:
    with pytest.raises(TypeError, match=r"hil\.load"):
        hil.simulate(hil.load(scenario), design="rig")


def test_a_rig_file_by_path_takes_the_place_of_the_configurations(scenario: Path, tmp_path: Path) -> None:
    text = (hil.load("paper").config_dir / "rig.toml").read_text()
    (tmp_path / "slow.toml").write_text(text.replace("period_s = 0.1", "period_s = 0.15"))
    bench = hil.load(scenario, rig="slow.toml")
    assert bench.rig.control.period_s == 0.15
    result = hil.simulate(bench)
    assert result.series["t_s"][1] == pytest.approx(0.15)


def test_what_the_emulator_refuses_is_an_error_of_hil(scenario: Path) -> None:
    scenario.write_text(SHORT + "[emulator]\npumps.colour = 1\n")
    with pytest.raises(hil.SettingsError, match=r"emulator\.pumps\.colour"):
        hil.simulate(scenario)


def test_design_gives_the_figures_of_a_name_and_of_an_object() -> None:
    figures = hil.design()
    assert figures.name == "rig"
    assert figures.is_stable
    assert figures.achieved_poles == pytest.approx(figures.requested_poles, abs=1e-9)
    assert set(figures.slowest_poles) == {"both healthy", "pump 1 -60 %", "pump 2 -60 %", "both -60 %"}
    own = hil.design(Halved())
    assert own.requested_poles is None
    assert own.noise_gain == pytest.approx(figures.noise_gain / 2)
    unstable = hil.design("calibrated").slowest_poles["pump 1 -60 %"]
    assert unstable.real > 0.0, "the paper's gain with pump 1 at 40 %"


def test_a_campaign_in_memory_and_one_in_a_folder_have_the_same_rows(scenario: Path, tmp_path: Path) -> None:
    seen: list[Row] = []
    in_memory = hil.campaign(scenario, seeds=2, on_row=seen.append)
    assert [row.seed for row in in_memory.rows] == [1, 2]
    assert tuple(seen) == in_memory.rows
    assert not (tmp_path / "runs").exists()
    kept = hil.campaign(scenario, seeds=2, out="campaign", report=False)
    assert [row.iae_1_Vs for row in kept.rows] == [row.iae_1_Vs for row in in_memory.rows]
    assert (tmp_path / "campaign" / "outcomes.parquet").is_file()
    (faults,) = in_memory.classes()
    assert (faults.runs, faults.detected, in_memory.broken) == (2, 1.0, ())


def test_simulate_may_be_called_from_any_thread_and_run_from_the_main_one_only(scenario: Path) -> None:
    """Closing the record takes signals over, which Python allows in the main thread only."""
    with ThreadPoolExecutor(1) as pool:
        result = pool.submit(hil.simulate, scenario, duration_s=1.0).result()
        assert result.status == "complete"
        with pytest.raises(RuntimeError, match="main thread"):
            pool.submit(hil.run, scenario, out="run").result()
    assert not Path("run").exists()


@pytest.mark.parametrize("duration_s", [float("nan"), float("inf"), -1.0, "5", True], ids=str)
def test_a_duration_that_is_none_is_refused(duration_s: Any) -> None:
    """A simulation of NaN seconds never ended; one of "5" seconds tripped in its first step."""
    with pytest.raises(hil.SettingsError, match=r"duration_s = .*must be a number of seconds"):
        hil.simulate("paper_quick", duration_s=duration_s)
    with pytest.raises(hil.SettingsError, match="duration_s = "):
        hil.campaign("paper_quick", duration_s=duration_s)


@pytest.mark.parametrize("seed", [-1, 1.5, "1", True], ids=str)
def test_a_seed_that_is_no_whole_number_is_refused(seed: Any) -> None:
    with pytest.raises(hil.SettingsError, match=r"seed = .*must be a whole number, at least 0"):
        hil.simulate("paper_quick", seed=seed)


@pytest.mark.parametrize(("name", "value"), [("seeds", 0), ("first_seed", -1), ("processes", 0), ("seeds", 2.0)])
def test_a_campaign_s_numbers_are_checked(name: str, value: Any) -> None:
    with pytest.raises(hil.SettingsError, match=f"{name} = "):
        hil.campaign("paper_quick", **{name: value})


def test_a_design_that_returns_something_else_is_refused_with_what_it_raised() -> None:
    """It used to end in a traceback from inside of the controller."""

    class NoGains:
        follows_reference = True

        def gains(self, linear: hil.LinearModel) -> Any:
            return linear.B

    with pytest.raises(hil.SettingsError, match=r"the design fails .*AttributeError"):
        hil.load("paper", design=NoGains())


def test_a_window_that_was_not_reached_has_no_iae(tmp_path: Path) -> None:
    """0.0 V s would be a perfect score."""
    result = hil.simulate("paper", duration_s=3.0)
    assert all(isnan(first) and isnan(second) for first, second in result.iae_Vs.values())
    assert "gain_fall not reached" in repr(result)
    assert "not reached" in result.report(tmp_path / "report.html").read_text(encoding="utf-8")
