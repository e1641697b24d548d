from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from hil.bench import campaign_case
from hil.campaigns.cases import Case, expand, with_seeds
from hil.campaigns.spec import load_spec
from hil.campaigns.toml_text import toml_text
from hil.edge.config.scenario_file import Scenario
from hil.edge.config.settings_file import SettingsError, validated
from tests.campaign.campaign_bench import CONFIG, GRID, PAIRS, SHORT, campaign_file, cases_of


def test_cases_are_scenarios_times_grid_times_seeds(tmp_path: Path) -> None:
    cases = cases_of(campaign_file(tmp_path))
    assert len(cases) == 3 * 2 * 3
    assert len({case.key for case in cases}) == len(cases)
    assert {case.seed for case in cases} == {5, 6, 7}
    assert [case.label for case in cases[::3]] == [
        f"pump_effectiveness {pumps} = {value}" for pumps in ("1", "2", "1+2") for value in (0.4, 0.8)
    ]


def test_every_seed_draws_its_own_onset_within_the_range(tmp_path: Path) -> None:
    cases = cases_of(campaign_file(tmp_path))
    onsets = [float(case.faults[0]["at_s"]) for case in cases]
    assert len(set(onsets)) == len(onsets)
    assert all(3.0 <= onset <= 4.0 for onset in onsets)
    assert any(abs(onset * 10 - round(onset * 10)) > 0.01 for onset in onsets), "not on a control step"
    assert all(
        case.faults[0]["until_s"] == pytest.approx(onset + 5.0) for case, onset in zip(cases, onsets, strict=True)
    )
    both = next(case for case in cases if "1+2" in case.label)
    assert [fault["target"] for fault in both.faults] == [1, 2]
    assert both.faults[0]["at_s"] == both.faults[1]["at_s"]


def test_every_ramp_is_a_case_with_a_label_and_a_draw_of_its_own(tmp_path: Path) -> None:
    cases = cases_of(
        campaign_file(tmp_path, GRID.replace("values = [0.4, 0.8]", "values = [0.4]\nramps_s = [0.0, 2.5]"))
    )
    assert [case.label for case in cases[:6:3]] == [
        "pump_effectiveness 1 = 0.4",
        "pump_effectiveness 1 = 0.4 in 2.5 s",
    ]
    assert [case.faults[0]["ramp_s"] for case in cases[:6]] == [0.0] * 3 + [2.5] * 3
    assert len({case.key for case in cases}) == len(cases)
    own = GRID.split("[[fault]]")[0]
    (tmp_path / "short.toml").write_text(SHORT.replace("value = 0.4", "value = 0.4\nramp_s = 3.0"))
    (tmp_path / "own.toml").write_text(own)
    assert cases_of(tmp_path / "own.toml")[0].label == "pump_effectiveness 1 = 0.4 in 3 s"


def test_the_same_file_gives_the_same_cases_in_another_process(tmp_path: Path) -> None:
    file = campaign_file(tmp_path, GRID + PAIRS)
    code = (
        "import sys; sys.path.insert(0, sys.argv[2]); from campaign_bench import cases_of; from pathlib import Path;"
        "print([c.key for c in cases_of(Path(sys.argv[1]))])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, file, Path(__file__).parent], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == str([case.key for case in cases_of(file)])


def test_a_key_is_of_all_that_the_result_depends_on(tmp_path: Path) -> None:
    file = campaign_file(tmp_path)
    before = {case.key for case in cases_of(file)}
    assert before.isdisjoint({case.key for case in cases_of(file, "another rig")})
    file.write_text(GRID.replace("delay_s = 0.5", "delay_s = 0.6"))
    assert before.isdisjoint({case.key for case in cases_of(file)})
    file.write_text(GRID.replace("seeds = 3", "seeds = 4"))
    assert before < {case.key for case in cases_of(file)}, "more seeds leave those that are there as they are"


def test_pairs_are_two_different_faults_with_onsets_of_their_own(tmp_path: Path) -> None:
    text = GRID.split("[[fault]]")[0].replace("seeds = 3", "seeds = 40") + PAIRS
    cases = cases_of(campaign_file(tmp_path, text))
    assert [case.label for case in cases] == ["pairs"] * 40
    for case in cases:
        first, second = case.faults
        assert first["kind"] != second["kind"]
        assert 3.0 <= first["at_s"] < second["at_s"] <= 6.0
    assert {fault["kind"] for case in cases for fault in case.faults} == {
        "pump_effectiveness", "sensor_bias", "sensor_stuck",
    }  # fmt: skip


def test_without_a_grid_the_scenarios_own_faults_are_played(tmp_path: Path) -> None:
    file = campaign_file(tmp_path, GRID.split("[[fault]]")[0])
    (case, *_) = cases_of(file)
    assert case.label == "pump_effectiveness 1 = 0.4"
    assert case.faults == tomllib.loads(SHORT)["fault"]


def test_tables_are_laid_over_the_scenarios(tmp_path: Path) -> None:
    (case, *_) = cases_of(campaign_file(tmp_path))
    assert case.scenario_data["emulator"] == {"parameter_spread": 0.03}
    assert case.scenario_data["diagnosis"] == {"method": "ideal", "delay_s": 0.5}


def test_a_folder_and_a_scenario_are_campaigns_too(tmp_path: Path) -> None:
    for name in ("b", "a"):
        (tmp_path / f"{name}.toml").write_text(SHORT.replace('"short"', f'"{name}"'))
    spec, files = load_spec(tmp_path)
    assert [file.name for file in files] == ["a.toml", "b.toml"]
    assert len(cases_of(tmp_path)) == 2 * spec.campaign.seeds
    spec, files = load_spec(tmp_path / "b.toml")
    assert (spec.campaign.name, files) == ("b", (tmp_path / "b.toml",))
    (tmp_path / "empty").mkdir()
    with pytest.raises(SettingsError, match=r"empty: has no \*\.toml"):
        load_spec(tmp_path / "empty")


def test_the_command_line_says_seeds_and_duration(tmp_path: Path) -> None:
    spec, _ = load_spec(campaign_file(tmp_path))
    said = with_seeds(spec, 2, 100, 5.0)
    cases = expand(said, [tomllib.loads(SHORT)])
    assert {case.seed for case in cases} == {100, 101}
    assert {case.scenario_data["scenario"]["duration_s"] for case in cases} == {5.0}
    assert with_seeds(spec, None, None, None) == spec


def test_a_case_written_down_is_the_same_scenario(tmp_path: Path) -> None:
    for case in cases_of(campaign_file(tmp_path, GRID + PAIRS)):
        again = tomllib.loads(toml_text(case.scenario_data))
        assert json.dumps(again, sort_keys=True) == json.dumps(case.scenario_data, sort_keys=True)
        validated(Scenario, again, "again")
    odd = {"rig": {"a b": {"c": [1.5, True, float("inf")], "d": 'quote " and \\ and ü'}}, "reference": [{"at_s": 1e-7}]}
    assert tomllib.loads(toml_text(odd)) == odd


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("seeds = 3", "seeds = 0", r"campaign\.seeds = 0: must be a whole number at least 1"),
        ("seeds = 3", 'seeds = "3"', r"campaign\.seeds = '3': "),
        ("seeds = 3", "sedes = 3", r"campaign\.sedes = 3: unknown key"),
        ('name = "grid"', 'name = "../grid"', r"campaign\.name = '\.\./grid': "),
        ('scenarios = ["short.toml"]', "scenarios = []", r"campaign\.scenarios = \[\]: .*at least 1"),
        ("onset_s = [3.0, 4.0]", "onset_s = [4.0, 3.0]", r"fault\[0\]: onset_s \[4\.0, 3\.0\]: the first"),
        (
            "onset_s = [3.0, 4.0]",
            "onset_s = [-1.0, 3.0]",
            r"fault\[0\]\.onset_s\[0\] = -1\.0: must be a number at least 0",
        ),
        ("onset_s = [3.0, 4.0]", "", r"missing: fault\[0\]\.onset_s"),
        ("targets = [1, 2, [1, 2]]", "targets = []", r"fault\[0\]\.targets = \[\]: .*at least 1"),
        ("values = [0.4, 0.8]", "values = [nan]", r"fault\[0\]\.values\[0\] = nan: "),
        ("lasts_s = 5.0", "lasts_s = 0.0", r"fault\[0\]\.lasts_s = 0\.0: must be a number above 0"),
    ],
)
def test_a_wrong_campaign_file_is_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in GRID
    file = campaign_file(tmp_path, GRID.replace(old, new, 1))
    with pytest.raises(SettingsError, match=f"^{file}: {said}") as complaint:
        load_spec(file)
    assert "\n" not in str(complaint.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("values = [0.4, 0.8]", "values = [1.4]", r"fault\[0\]\.value = 1\.4: .*0\.\.1"),
        ("targets = [1, 2, [1, 2]]", "targets = [3]", r"fault\[0\]"),
        ('kind = "pump_effectiveness"', 'kind = "pump_losing"', r"fault\[0\]\.kind = 'pump_losing'"),
        ("parameter_spread = 0.03", "parameter_spread = 3.0", r"emulator\.parameter_spread = 3\.0: .*0 \.\. 0\.5"),
        ("delay_s = 0.5", "delay_s = -0.5", r"diagnosis\.delay_s = -0\.5: must be a number at least 0"),
    ],
)
def test_what_the_scenario_would_refuse_is_refused_before_any_run(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    assert old in GRID
    (case, *_) = cases_of(campaign_file(tmp_path, GRID.replace(old, new, 1)))
    with pytest.raises(SettingsError, match=f"^here: {said}") as complaint:
        campaign_case.check(case, CONFIG, "here")
    assert "\n" not in str(complaint.value)


CLASSES = {"false_alarms": 1, "false_alarms_lag": 1, "false_alarms_noise": 1, "false_alarms_spread": 1}
CLASSES |= {"false_alarms_turbulence": 1}
CLASSES |= {"growing": 64, "growing_slow": 48, "leaks": 8, "pairs": 200, "pump_losses": 11, "sensors": 28}
CLASSES |= {
    "shipped_rigs": 18,
    "drawn_rigs": 1,
    "drawn_rigs_fault": 21,
    "drawn_rigs_drift": 16,
    "drawn_rigs_growing": 32,
    "known_rigs": 1,
    "known_rigs_fault": 21,
}


@pytest.mark.parametrize("file", sorted((CONFIG / "campaigns").glob("*.toml")), ids=lambda file: file.stem)
def test_the_shipped_campaigns_can_be_run(file: Path) -> None:
    """Every class once, without the diagnosis, which other tests build; a case of each with a wrong value is refused.

    That a check which looks at nothing passes as well was not noticed here.
    """
    labels: dict[str, Case] = {}
    for case in cases_of(file):
        labels.setdefault(f"{case.label} {case.faults if case.label == 'pairs' else ''}", case)
    for case in labels.values():
        campaign_case.check(
            replace(case, scenario_data={**case.scenario_data, "diagnosis": {"method": "none"}}), CONFIG, case.label
        )
    assert len(labels) == CLASSES[file.stem]
    for table, key in (("diagnosis", "method"), ("emulator", "parameter_spread")):
        changed = {**case.scenario_data, table: {**case.scenario_data.get(table, {}), key: "wrong"}}
        with pytest.raises(ValueError, match=rf"{table}\.{key} = "):
            campaign_case.check(replace(case, scenario_data=changed), CONFIG, "here")
