"""Drawn rigs of a campaign: repeatable, within their ranges, startable, and told to the controller or not."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from hil.bench import campaign_case, campaign_run
from hil.bench.campaign_case import run_case
from hil.bench.campaign_run import CampaignOptions
from hil.campaigns.campaign_report import render
from hil.campaigns.cases import Case
from hil.campaigns.draw_spec import Draw
from hil.campaigns.rig_draw import DrawnRig, RigNumbers, draw_rig
from hil.cli import campaign_tables
from hil.edge.config.settings_file import SettingsError, validated
from tests.campaign.campaign_bench import CONFIG, SHORT, campaign_file, row

HEAD = """[campaign]
name = "drawn"
scenarios = ["short.toml"]
seeds = 4

[diagnosis]
method = "none"
"""
DRAW: dict[str, Any] = {
    "gain_ratio": [0.7, 1.3],
    "curve_1_V": [-0.03, 0.03],
    "dead_zone_V": [0.0, 0.5],
    "lag_ratio": [0.3, 5.0],
    "outlet_ratio": [0.9, 1.1],
    "scale_error": [-0.02, 0.02],
    "period_s": [0.02, 0.05, 0.1],
    "start_V": [[0.0, 0.0], [3.0, 3.0]],
}
TOML = "[draw]\n" + "".join(f"{key} = {value}\n" for key, value in DRAW.items())
REFERENCES = {"every_s": [20.0, 100.0], "levels_cm": [6.0, 16.0]}
ONE_FAULT = """
[one_fault]
onset_s = [3.0, 6.0]
[[one_fault.pool]]
kind = "pump_effectiveness"
targets = [1, 2]
value_range = [0.1, 0.9]
[[one_fault.pool]]
kind = "sensor_stuck"
targets = [1, 2, 3, 4]
"""


@pytest.fixture(scope="module")
def base() -> RigNumbers:
    return campaign_case.rig_numbers(Case("", "", "", 0, {"scenario": {"name": "s", "duration_s": 1.0}}), CONFIG, "s")


def drawn(base: RigNumbers, seed: int, duration_s: float = 500.0, **table: Any) -> DrawnRig:
    return draw_rig(validated(Draw, table, "test"), base, seed, duration_s)


def cases_of(folder: Path, text: str) -> tuple[Case, ...]:
    return campaign_run.load(campaign_file(folder, text), CONFIG, CampaignOptions())[1]


def test_every_value_is_within_its_range_and_ratios_are_uniform_in_the_logarithm(base: RigNumbers) -> None:
    rigs = [drawn(base, seed, **DRAW).values for seed in range(400)]
    for key, parts in (
        ("gain_ratio", 2),
        ("curve_1_V", 2),
        ("dead_zone_V", 2),
        ("outlet_ratio", 4),
        ("scale_error", 4),
    ):
        values = np.array([rig[key] for rig in rigs])
        low, high = DRAW[key]
        assert values.shape == (400, parts)
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() <= high
        assert np.corrcoef(values[:, 0], values[:, 1])[0, 1] == pytest.approx(0.0, abs=0.15), "each part its own"
    lags = np.array([rig["lag_ratio"] for rig in rigs])
    assert np.median(lags) == pytest.approx(math.sqrt(0.3 * 5.0), rel=0.15)
    assert {rig["period_s"] for rig in rigs} == {0.02, 0.05, 0.1}
    assert {tuple(rig["start_V"]) for rig in rigs} == {(0.0, 0.0), (3.0, 3.0)}


def test_a_seed_has_the_same_rig_with_and_without_other_keys_and_faults(base: RigNumbers, tmp_path: Path) -> None:
    whole = drawn(base, 3, **DRAW).values
    assert drawn(base, 3, gain_ratio=DRAW["gain_ratio"]).values["gain_ratio"] == whole["gain_ratio"]
    assert drawn(base, 4, **DRAW).values["gain_ratio"] != whole["gain_ratio"]
    healthy, faulty = (cases_of(tmp_path, HEAD + TOML + more) for more in ("", ONE_FAULT))
    assert [case.drawn for case in healthy] == [case.drawn for case in faulty]
    assert all(len(case.faults) == 1 for case in faulty)
    assert {case.label.split()[0] for case in faulty} <= {"pump_effectiveness", "sensor_stuck"}
    assert all(case.label.split()[1] == str(case.faults[0]["target"]) for case in faulty)


def test_a_run_at_rest_begins_with_the_flows_of_the_undrawn_rig(base: RigNumbers) -> None:
    """3 V on pumps 30 % stronger with outlets 10 % smaller would begin with a level of 26 cm, over the rim."""
    for seed in range(30):
        rig = drawn(base, seed, **(DRAW | {"start_V": [[3.0, 3.0]]}))
        pumps, start_V = rig.overlay["emulator"]["pumps"], rig.overlay["emulator"]["tanks"]["start_V"]
        for pump in (0, 1):
            x = start_V[pump] - pumps["dead_zone_V"][pump]
            flow = pumps["gain_cm3_Vs"][pump] * x * (1.0 + pumps["curve_1_V"][pump] * x)
            assert flow == pytest.approx(base.gain_cm3_Vs[pump] * 3.0, rel=2e-3)


def test_the_controller_knows_what_it_is_told_and_always_its_own_period(base: RigNumbers) -> None:
    unknown, known = drawn(base, 7, **DRAW), drawn(base, 7, rig_knows=True, **DRAW)
    assert unknown.overlay["rig"] == {"control": {"period_s": unknown.values["period_s"]}}
    assert known.overlay["emulator"] == unknown.overlay["emulator"]
    assert known.overlay["rig"]["pumps"] == known.overlay["emulator"]["pumps"]
    assert known.overlay["rig"]["tanks"]["outlet_cm2"] == known.overlay["emulator"]["tanks"]["outlet_cm2"]
    errors = np.array(known.overlay["emulator"]["sensors"]["scale_error"])
    assert known.overlay["rig"]["sensors"]["gain_V_cm"] == pytest.approx(0.5 * (1.0 + errors), rel=1e-3)


def holding(rig: RigNumbers, lower_cm: tuple[float, float]) -> list[float]:
    return [rig.voltage_V(pump, flow) for pump, flow in enumerate(rig.holding_flows_cm3_s(lower_cm))]


def test_random_references_are_levels_that_the_rig_holds(base: RigNumbers) -> None:
    table = {**DRAW, "references": REFERENCES}
    steps = drawn(base, 2, 3600.0, **table).overlay["reference"]
    times = [0.0, *(step["at_s"] for step in steps), 3600.0]
    assert all(20.0 <= later - at <= 100.0 for at, later in pairwise(times[:-1]))
    levels = [tuple(step["levels_cm"]) for step in steps]
    assert len(set(levels)) == len(levels) > 40
    assert all(6.0 <= level <= 16.0 for pair in levels for level in pair)
    assert all(0.5 <= voltage <= 9.0 for pair in levels for voltage in holding(base, pair) if voltage), "of the base"
    assert base.holds((12.4, 12.7))
    assert not base.holds((2.0, 18.0)), "pump 1 would have to give less than nothing"


def test_numbers_of_a_rig_agree_with_its_equilibrium(base: RigNumbers) -> None:
    """3 V hold the paper's levels, and a bent curve with a dead zone is inverted to the flow that it gives."""
    assert holding(base, (12.26, 12.78)) == pytest.approx([3.0, 3.0], rel=2e-3)
    bent = replace(base, dead_zone_V=(0.5, 0.2), curve_1_V=(-0.03, 0.05), datum_cm=(3.0, 3.0, 0.0, 0.0))
    for pump in (0, 1):
        assert bent.voltage_V(pump, bent.flow_cm3_s(pump, 7.0)) == pytest.approx(7.0)
        assert bent.voltage_V(pump, 0.0) == 0.0
    assert bent.voltage_V(0, 1000.0) == math.inf, "the curve never reaches it"
    assert bent.outflow_cm3_s(0, 9.0) == pytest.approx(base.outflow_cm3_s(0, 12.0))


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ({"gain_ratio": [1.3, 0.7]}, "gain_ratio [1.3, 0.7]: the first is above the second"),
        ({"gain_ratio": [0.0, 1.0]}, "gain_ratio[0] = 0.0: must be a number above 0 and at most 100"),
        ({"period_s": [0.3]}, "period_s[0] = 0.3: must be a number at least 0.001 and at most 0.2"),
        ({"curve_1_V": [-0.1, 0.0]}, "curve_1_V[0] = -0.1: must be a number at least -0.05 and at most 1"),
        ({"references": {"every_s": [9.0, 3.0], "levels_cm": [6.0, 16.0]}}, "every_s [9.0, 3.0]: the first is above"),
    ],
)
def test_a_wrong_table_is_named_with_what_is_allowed(table: dict[str, Any], named: str) -> None:
    with pytest.raises(SettingsError) as error:
        validated(Draw, table, "file")
    assert named in str(error.value)


def test_rigs_that_cannot_run_are_refused_before_the_first_run(base: RigNumbers, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"seed 1: the drawn pumps can't give the flow of \[3.0, 3.0\] V within 10"):
        drawn(base, 1, gain_ratio=[0.1, 0.2])
    with pytest.raises(SettingsError, match=r"levels_cm = \[19.0, 20.0\]: the rig of seed 1 can hold none of them"):
        drawn(
            base, 1, gain_ratio=[0.1, 0.11], start_V=[[0.0, 0.0]], references=REFERENCES | {"levels_cm": [19.0, 20.0]}
        )
    narrow = "[draw]\noutlet_ratio = [0.5, 0.6]\n"
    with pytest.raises(SettingsError, match=r"grid\.toml: short: .*tanks\.start_V = .* gives a level of [\d.]+ cm"):
        cases_of(tmp_path, HEAD + narrow)


def test_the_row_and_the_folder_say_what_was_drawn(tmp_path: Path) -> None:
    at_rest = TOML.replace("[[0.0, 0.0], [3.0, 3.0]]", "[[3.0, 3.0]]")  # no start phase, which takes minutes
    file = campaign_file(tmp_path, HEAD.replace("seeds = 4", "seeds = 1") + at_rest)
    (tmp_path / "short.toml").write_text(SHORT.replace("12.0", "2.0").split("[[fault]]")[0])
    prepared = campaign_run.prepare(file, CampaignOptions(processes=1))
    store = campaign_run.open_store(prepared, tmp_path / "out")
    (found,) = campaign_run.run_missing(prepared, store, lambda _: None)
    assert found.status == "complete", found.reason
    said = json.loads(found.drawn_json)
    assert said == json.loads(json.dumps(prepared.cases[0].drawn))
    assert set(said) == {*DRAW, "flow_ratio", "lag_s"}
    campaign_run.write_results(prepared, store, [found], report=False)
    again = campaign_run.load(tmp_path / "out" / "cases" / f"{found.key}.toml", CONFIG, CampaignOptions(seeds=1))[1]
    repeated = run_case(again[0], CONFIG)
    assert (repeated.iae_1_Vs, repeated.steps) == (found.iae_1_Vs, found.steps)


def test_terminal_and_report_count_honest_alarms_and_trips() -> None:
    rows = [
        row(honest_alarms=2, seed=1, unknowns=2, unknown_s=41.2, unknown_long=1),
        row(trip_cause="high_level", seed=2, false_alarms=3, questions=1),
    ]
    out = StringIO()
    campaign_tables.show(Console(file=out, width=120), rows)
    assert "Besides, 2 alarms that say what a drawn rig is." in out.getvalue()
    assert "Tripped: 1 of 2 runs: high_level 1" in out.getvalue()
    assert "Of 3 false or spurious alarms, 1 were withdrawn before they had a name." in out.getvalue()
    unknown = "Unknown: 2 times, the longest 41 s; 1 stood for 30 s or until the run stopped."
    assert unknown in out.getvalue()
    page = render("drawn", rows)
    assert f"a name. Besides, 2 alarms that say what a drawn rig is. {unknown}" in page
    assert "longest unknown [s]" in page
