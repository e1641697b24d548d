"""The laws as a scenario names them: options, errors, and a run on the bench from any state of the tanks."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.bench.comparator_laws import PiOptions, PredictiveOptions, make_pi
from hil.bench.law_choices import LAWS, STATE_FEEDBACK
from hil.core.laws.quadratic_program import solve_qp
from hil.core.types import Mode
from tests.laws.law_rigs import MINUS, MINUS_PLANT, PLUS, PLUS_PLANT

COMPARATORS = ("pi", "lqr", "governor", "mpc", "fuzzy_mpc", "feedback_linearisation")
NEED_SOLVER = ("governor", "mpc", "fuzzy_mpc")


def scenario(tmp_path: Path, text: str, name: str = "rest.toml") -> Path:
    file = tmp_path / name
    file.write_text(f'[scenario]\nname = "rest"\nduration_s = 6.0\n[diagnosis]\nmethod = "none"\n{text}\n')
    return file


def test_the_table_has_every_comparator() -> None:
    assert {STATE_FEEDBACK, *COMPARATORS} <= set(LAWS.names)


@pytest.mark.parametrize("law", COMPARATORS)
def test_a_law_holds_the_rig_at_rest_on_the_bench(law: str, tmp_path: Path) -> None:
    result = hil.simulate(scenario(tmp_path, f'[control]\nlaw = "{law}"'))
    outputs = np.column_stack([result.series["h1_V"], result.series["h2_V"]])
    assert np.abs(outputs - outputs[0]).max() < 0.08
    assert set(result.series["mode"][5:50]) == {int(Mode.RUNNING)}


@pytest.mark.parametrize("law", NEED_SOLVER)
def test_a_missing_solver_is_an_error_that_says_what_to_install(
    law: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(hil.SettingsError, match=r"pip install 'fourtank-hil\[mpc\]'"):
        hil.load(scenario(tmp_path, f'[control]\nlaw = "{law}"'))


def test_feedback_linearisation_is_refused_on_the_non_minimum_phase_rig(tmp_path: Path) -> None:
    with pytest.raises(hil.SettingsError, match="gamma1"):
        hil.load(scenario(tmp_path, '[control]\nlaw = "feedback_linearisation"'), rig="johansson_plus")


@pytest.mark.parametrize(
    ("options", "message"),
    [("move_weight = -1.0", "control.options.move_weight"), ("horizon = 3", "control.options.horizon")],
)
def test_a_wrong_option_is_named_with_its_key(options: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(hil.SettingsError, match=message):
        hil.load(scenario(tmp_path, f'[control]\nlaw = "mpc"\n[control.options]\n{options}'))


def test_options_that_are_not_given_are_those_of_the_phase() -> None:
    options = PredictiveOptions(move_weight=0.5)
    assert options.values(MINUS)["move_weight"] == options.values(PLUS)["move_weight"] == 0.5
    assert options.values(MINUS)["horizon_s"] < options.values(PLUS)["horizon_s"]


def test_the_pairing_and_the_published_settings_follow_the_rig() -> None:
    assert [make_pi(plant, PiOptions()).crossed for plant in (MINUS_PLANT, PLUS_PLANT)] == [False, True]
    published = [make_pi(plant, PiOptions(settings="johansson")) for plant in (MINUS_PLANT, PLUS_PLANT)]
    assert [law.crossed for law in published] == [False, False]
    assert [law.gain_V_V for law in published] == [(3.0, 2.7), (1.5, -0.12)]
    assert make_pi(MINUS_PLANT, PiOptions(settings="johansson", integral_s=(20.0, 21.0))).integral_s == (20.0, 21.0)


def test_a_quadratic_program_without_a_solution_is_none() -> None:
    H, f = np.eye(2), np.array([-1.0, -3.0])
    row = np.array([[1.0, 1.0]])
    x = solve_qp(H, f, np.array([0.0, 0.0, -9.0]), np.array([9.0, 9.0, 2.0]), row)
    assert x is not None
    np.testing.assert_allclose(x, (0.0, 2.0), atol=1e-9)
    assert solve_qp(H, f, np.array([0.0, 0.0, 5.0]), np.array([1.0, 1.0, 6.0]), row) is None
