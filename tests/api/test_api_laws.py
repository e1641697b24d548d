"""Control laws of one's own: as an object, by name, with options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import Field

import hil
from hil.bench.choice_table import TableChoice
from hil.bench.law_choices import LAWS


class Constant:
    """Asks for the same drives at every step."""

    def __init__(self, drive: float = 3.0) -> None:
        self.drive = drive

    def start(self, inputs: hil.LawInputs) -> None:
        """It remembers nothing."""

    def step(self, memory: None, inputs: hil.LawInputs) -> tuple[None, hil.LawRequest]:
        return memory, hil.LawRequest((self.drive, self.drive), inputs.reference_V, shown={"drive": self.drive})


class ConstantOptions(hil.LawOptions):
    drive: Annotated[float, Field(ge=0.0, le=10.0)] = 3.0


def make_constant(setup: hil.LawSetup, options: ConstantOptions) -> hil.ControlLaw:
    assert setup.period_s == setup.rig.control.period_s
    return Constant(options.drive)


@pytest.fixture
def constant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LAWS._rows, "constant", TableChoice("constant", "for this test", make_constant))


def scenario(tmp_path: Path, control: str) -> Path:
    file = tmp_path / "own.toml"
    file.write_text(f'[scenario]\nname = "own"\nduration_s = 1.0\n[control]\n{control}\n[diagnosis]\nmethod = "none"\n')
    return file


def test_an_object_is_used_in_place_of_the_scenarios_law_and_what_it_shows_is_a_series() -> None:
    result = hil.simulate(hil.load("steps", detector="none", law=Constant(2.5)), duration_s=1.0)
    assert set(result.series["law_drive"]) == {2.5}
    assert set(result.series["v1_raw_V"]) == {2.5}
    assert result.manifest.plan.settings["scenario"]["control"]["law"] == "Constant"


def test_the_default_law_shows_its_path_and_fills_the_columns_of_a_state_feedback() -> None:
    result = hil.simulate(hil.load("steps", detector="none"), duration_s=0.5)
    assert [name for name in result.series if name.startswith("law_")] == ["law_path_1_V", "law_path_2_V"]
    assert abs(result.series["K11"]).min() > 0.0


@pytest.mark.usefixtures("constant")
def test_a_scenario_names_a_law_and_its_options(tmp_path: Path) -> None:
    file = scenario(tmp_path, 'law = "constant"\noptions = { drive = 2.0 }')
    assert set(hil.simulate(file).series["v1_raw_V"]) == {2.0}
    bench = hil.load(file, law="state_feedback")
    assert bench.scenario.control.options == {}, "the options are those of the scenario's own law"


@pytest.mark.usefixtures("constant")
@pytest.mark.parametrize(
    ("control", "message"),
    [
        ('law = "no_such"', "control.law = 'no_such': must be one of state_feedback, "),
        (
            'law = "constant"\noptions = { drive = 11.0 }',
            "control.options.drive = 11.0: must be a number at least 0",
        ),
        ('law = "constant"\noptions = { drive = "2" }', "control.options.drive = '2': must be a number"),
        ('law = "constant"\noptions = { speed = 1.0 }', "control.options.speed = 1.0: unknown key"),
        ("options = { drive = 1.0 }", "control.options: the law 'state_feedback' has none, not drive"),
        ("options = 3", "control.options = 3: must be a table"),
    ],
)
def test_what_is_wrong_with_a_law_is_said_with_file_key_and_range(tmp_path: Path, control: str, message: str) -> None:
    file = scenario(tmp_path, control)
    with pytest.raises(hil.SettingsError) as caught:
        hil.load(file)
    assert str(caught.value).startswith(f"{file}: {message}")


@pytest.mark.parametrize(
    ("answer", "what"),
    [
        (None, "returned a NoneType"),
        (hil.LawRequest((float("nan"), 3.0), (6.0, 6.0)), "asked for"),
        (hil.LawRequest((3.0, 3.0), (float("inf"), 6.0)), "not finite"),
    ],
)
def test_a_law_that_fails_is_refused_before_anything_moves(answer: Any, what: str) -> None:
    class Fails(Constant):
        def step(self, memory: None, inputs: hil.LawInputs) -> tuple[None, hil.LawRequest]:
            del inputs
            return memory, answer

    with pytest.raises(hil.SettingsError, match=rf"control \(law 'Fails'\): .*{what}"):
        hil.load("steps", detector="none", law=Fails())


def bare(setup: Any, options: Any) -> hil.ControlLaw:
    raise AssertionError(f"called with {setup} and {options}")


def test_a_maker_whose_options_have_no_model_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(LAWS._rows, "bare", TableChoice("bare", "for this test", bare))
    with pytest.raises(hil.SettingsError, match=r"control\.law = 'bare': .*'options'.*LawOptions"):
        hil.load(scenario(tmp_path, 'law = "bare"'))
