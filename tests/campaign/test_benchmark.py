"""`hil benchmark`: which runs it has, how it goes on, and what it makes of them."""

from __future__ import annotations

import csv
import json
import math
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from hil.bench import benchmark_run
from hil.bench.benchmark_run import BenchmarkOptions
from hil.campaigns.benchmark_report import render
from hil.campaigns.benchmark_spec import load_benchmark_spec
from hil.campaigns.cases import Case
from hil.campaigns.contests import Contest, Entrant
from hil.campaigns.control_figures import of_window
from hil.campaigns.observer import COLUMNS, Observations
from hil.campaigns.row import Row
from hil.campaigns.standing import Course, Standing, Standings
from hil.campaigns.standings import standings
from hil.cli import benchmark_command
from hil.edge.config.settings_file import SettingsError
from hil.edge.record.manifest import Window
from tests.campaign.campaign_bench import CONFIG, SHORT, row

SPEC = """[benchmark]
name = "tiny"
scenarios = ["short.toml"]
seeds = 2
noise_window = "none"

[[law]]
label = "reconfigured"
control = { reconfigure = true }

[[law]]
label = "kept"
control = { reconfigure = false }

[[detector]]
label = "ideal"
diagnosis = { method = "ideal", delay_s = 0.5 }
"""


def spec_file(folder: Path, text: str = SPEC) -> Path:
    (folder / "short.toml").write_text(SHORT)
    file = folder / "tiny.toml"
    file.write_text(text)
    return file


def run(file: Path, out: Path, **options: Any) -> str:
    console = Console(record=True, width=160, file=StringIO())
    benchmark_command.run(console, file, BenchmarkOptions(out=out, processes=1, **options))
    return console.export_text()


def test_a_benchmark_runs_every_law_with_every_detector_and_seed_and_goes_on(tmp_path: Path) -> None:
    file, out = spec_file(tmp_path), tmp_path / "out"
    first = run(file, out, seeds=1, report=False)
    assert "All invariants hold in 2 runs." in first
    lines = (out / "outcomes.jsonl").read_text().splitlines()
    again = run(file, out)
    assert "Already there: 2 of 4 runs." in again
    assert (out / "outcomes.jsonl").read_text().splitlines()[:2] == lines
    assert len((out / "outcomes.jsonl").read_text().splitlines()) == 4
    found = json.loads((out / "benchmark.json").read_text())
    best = min(found["overall"], key=lambda one: one["rank"]["value"])
    assert best["entrant"]["law"] == "reconfigured", "gains rescaled for the lost pump keep the error small"
    assert (out / "report.html").read_text().count("<svg") == 3
    with (out / "runs.csv").open() as text:
        assert [(line["law"], line["seed"]) for line in csv.DictReader(text)] == [
            ("reconfigured", "50001"), ("reconfigured", "50002"), ("kept", "50001"), ("kept", "50002"),
        ]  # fmt: skip
    changed = run(spec_file(tmp_path, SPEC.replace("delay_s = 0.5", "delay_s = 1.0")), out, report=False, seeds=1)
    assert "Left out: 4 runs" in changed


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('label = "kept"', 'label = "reconfigured"', "labels ['reconfigured', 'reconfigured'] repeat"),
        ("{ reconfigure = false }", "{ reconfigure = true }", "same run twice"),
        ("{ reconfigure = false }", '{ design = "best" }', "must be one of"),
        ("{ reconfigure = false }", '{}\ndetectors = ["glr"]', "['glr'] are not among ['ideal']"),
        ("seeds = 2", "seeds = 0", "benchmark.seeds"),
        (
            "[[detector]]",
            "[[rig]]\nlabel = 'r'\nscenarios = ['long']\n[[detector]]",
            "['long'] are not among ['short']",
        ),
        ("[[detector]]", "[[rig]]\nlabel = 'r'\nfile = 'mars'\n[[detector]]", "shipped rigs"),
    ],
)
def test_a_wrong_benchmark_file_says_what_is_wrong(tmp_path: Path, old: str, new: str, words: str) -> None:
    file = spec_file(tmp_path, SPEC.replace(old, new, 1))
    with pytest.raises(SettingsError) as error:
        benchmark_run.prepare(file, BenchmarkOptions(processes=1))
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("name", "labels"),
    [("fault_tolerant_four_tank", {"rig design", "PI", "LQR", "MPC"}), ("laws_with_glr", {"rig design", "LQR", "MPC"})],
)
def test_a_shipped_benchmark_can_be_read_and_its_seeds_are_nobody_elses(name: str, labels: set[str]) -> None:
    spec, files = load_benchmark_spec(CONFIG / "benchmarks" / f"{name}.toml")
    assert spec.benchmark.first_seed > 50_000
    assert all(file.is_file() for file in files)
    assert labels <= {law.label for law in spec.law}


WINDOWS = {"window": [{"name": "step", "from_s": 0.0, "to_s": 10.0}]}


def of(law: str, seed: int, iae_Vs: float | None, noise_V: float = 0.02, **changes: Any) -> tuple[Contest, Row]:
    """A run with this IAE on each output; None: tripped before the window ended."""
    entrant = Entrant(law, "glr", "rig")
    figures = {
        "step_V": [0.3, 0.3], "settling_s": [5.0, None], "overshoot_V": [0.0, 0.01], "peak_V": [0.3, 0.3],
        "noise_V": [noise_V, 0.0], "energy_V2s": 100.0,
    }  # fmt: skip
    ended = iae_Vs is not None
    made = row(
        seed=seed,
        key=f"{law}{seed}",
        windows_json=json.dumps({"step": figures if ended else None, "rest": figures if ended else None}),
        iae_windows_json=json.dumps({"step": [iae_Vs, iae_Vs], "rest": [0.0, 0.0]}),
        trip_cause="" if ended else "high_level",
        status="complete" if ended else "tripped",
        **changes,
    )
    return Contest(entrant, "steps", Case(made.key, "", "steps", seed, WINDOWS)), made


def judged(*runs: tuple[Contest, Row]) -> tuple[Standings, dict[str, Standing]]:
    found = standings(runs, "rest")
    return found, {one.entrant.law: one for one in found.on(Course("rig", "steps", "step"))}


def test_laws_are_compared_seed_by_seed() -> None:
    """One is always twice as good as the other, though rigs differ by more than that."""
    hard = {1: 1.0, 2: 4.0, 3: 9.0, 4: 2.0}
    runs = [of(law, seed, factor * iae) for law, factor in (("a", 1.0), ("b", 2.0)) for seed, iae in hard.items()]
    _, by_law = judged(*runs)
    assert (by_law["b"].ratio.value, by_law["b"].ratio.low, by_law["b"].ratio.high) == (2.0, 2.0, 2.0)
    assert (by_law["a"].rank.value, by_law["b"].rank.value) == (1.0, 2.0)
    assert by_law["a"].iae_Vs == (3.0, 3.0)


def test_where_the_seeds_do_not_agree_the_interval_says_so() -> None:
    runs = [of("a", seed, 1.0) for seed in range(1, 9)]
    runs += [of("b", seed, 0.7 if seed % 2 else 1.5) for seed in range(1, 9)]
    found, by_law = judged(*runs)
    assert by_law["b"].ratio.low < 1.0 < by_law["b"].ratio.high
    assert by_law["a"].rank.low < 1.5 < by_law["a"].rank.high
    assert judged(*runs)[0] == found, "the draws are the same every time"


def test_a_run_that_trips_is_behind_all_others_and_in_no_median() -> None:
    """Averaged away, three trips in four runs would leave the best law of all."""
    runs = [of("a", seed, 1.0) for seed in (1, 2, 3, 4)]
    runs += [of("b", 1, 0.5), *(of("b", seed, None) for seed in (2, 3, 4))]
    found, by_law = judged(*runs)
    assert by_law["b"].iae_Vs == (0.5, 0.5)
    assert (by_law["b"].runs, by_law["b"].ended, by_law["b"].endings) == (4, 1, {"tripped: high_level": 3})
    assert by_law["b"].ratio.value == math.inf
    assert by_law["b"].rank.value == pytest.approx(1.75)
    assert [one.tripped for one in found.overall] == [0, 3]
    page = render("trial", runs, found)
    assert "1 of 4 (tripped: high_level 3)" in page
    assert "3 of 4 not ended" in page


def test_at_equal_noise_a_law_is_compared_only_with_those_that_are_as_quiet() -> None:
    runs = [of("quiet", 1, 2.0, 0.01), of("slow", 1, 3.0, 0.01), of("loud", 1, 1.0, 0.02)]
    _, by_law = judged(*runs)
    assert by_law["quiet"].quiet_ratio == 1.0, "the loud one is better, but louder"
    assert by_law["slow"].quiet_ratio == pytest.approx(1.5)
    assert by_law["slow"].ratio.value == 3.0


def test_delays_are_set_against_the_bound() -> None:
    runs = [of("a", seed, 1.0, detected=True, right=True, detection_s=0.3, bound_s=0.2) for seed in (1, 2, 3)]
    runs += [of("a", 4, 1.0, detected=False, right=False, bound_s=0.2)]
    (found,) = judged(*runs)[0].detections
    assert (found.faults, found.found, found.delay_s) == (4, 3, 0.3)
    assert found.over_bound == pytest.approx(1.5)
    assert found.over_bound_s == pytest.approx(0.1)


def seen(y_V: np.ndarray, r_V: np.ndarray, v_V: np.ndarray) -> Observations:
    steps = np.zeros((len(y_V), len(COLUMNS)))
    columns = {"t_s": 0.1 * np.arange(len(y_V)), "r1_V": r_V, "h1_cm": 2.0 * y_V, "v1_V": v_V}
    for name, values in columns.items():
        steps[:, COLUMNS.index(name)] = values
    return Observations(steps, (), "", "")


def test_figures_of_a_step() -> None:
    """A step of 0.3 V at 10 s: 0.33 V at the most, within 20 mV from 16 s on."""
    t_s = 0.1 * np.arange(600)
    y_V = np.select([t_s < 10.0, t_s < 13.0, t_s < 16.0], [0.0, 0.2, 0.33], 0.301)
    noise_V = 0.02 * np.where(np.arange(600) % 2, 1.0, -1.0)
    record = seen(y_V, np.where(t_s < 10.0 - 1e-6, 0.0, 0.3), 3.0 + 0.01 * t_s + noise_V)
    figures = of_window(record, Window("step", 10.0, 60.0), 0.5, 0.1)
    assert figures is not None
    assert figures.step_V == pytest.approx((0.3, 0.0))
    assert figures.settling_s == pytest.approx((6.0, 0.0))
    assert figures.overshoot_V[0] == pytest.approx(0.03)
    assert figures.overshoot_V[1] is None
    assert figures.noise_V[0] == pytest.approx(0.02, rel=0.01), "a slow drift of the voltage is no noise"
    assert figures.energy_V2s == pytest.approx(50.0 * 3.35**2, rel=0.01)
    assert of_window(record, Window("late", 10.0, 61.0), 0.5, 0.1) is None, "the run ended before"
    moving = of_window(record, Window("cut", 10.0, 15.0), 0.5, 0.1)
    assert moving is not None
    assert moving.settling_s[0] is None
