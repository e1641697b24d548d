"""Designs and detectors by table: a built-in one is its module and a row, an installed one a package alone."""

from importlib.metadata import EntryPoint

import pytest

import hil
from hil.bench import choice_table
from hil.bench.choice_table import ChoiceTable, TableChoice
from hil.bench.designs import DESIGNS, DesignMaker, rig_design
from hil.bench.detectors import DETECTORS, no_detector
from hil.edge.config.rig_file import Rig


class Weaker:
    """The rig's own gains times 0.8: a design of one file."""

    follows_reference = True

    def __init__(self, rig: Rig) -> None:
        self._inner = rig_design(rig)

    def gains(self, linear: hil.LinearModel) -> hil.Gains:
        inner = self._inner.gains(linear)
        first, second = (tuple(0.8 * gain for gain in row) for row in inner.levels_V_cm)
        (q11, q12), (q21, q22) = inner.integrals_1_s
        (i11, i12), (i21, i22) = inner.integral_inverse
        inverse = ((i11 / 0.8, i12 / 0.8), (i21 / 0.8, i22 / 0.8))
        return hil.Gains((first, second), ((0.8 * q11, 0.8 * q12), (0.8 * q21, 0.8 * q22)), inverse)


def test_a_row_in_the_table_is_all_that_a_built_in_design_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two files: the design's module and its row; settings check, messages and `hil.design` follow."""
    monkeypatch.setitem(DESIGNS._rows, "weaker", TableChoice("weaker", "for this test", Weaker))
    assert hil.load("paper", design="weaker").scenario.control.design == "weaker"
    assert hil.design("weaker").noise_gain == pytest.approx(0.8 * hil.design("rig").noise_gain)
    with pytest.raises(hil.SettingsError, match="must be one of rig, calibrated, weaker"):
        hil.load("paper", design="stronger")


def test_a_row_in_the_table_is_all_that_a_built_in_detector_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DETECTORS._rows, "silent", TableChoice("silent", "for this test", no_detector))
    assert hil.load("paper", detector="silent").scenario.diagnosis.method == "silent"
    with pytest.raises(hil.SettingsError, match=r"must be one of glr, ideal, none, .*, silent"):
        hil.load("paper", detector="loud")


@pytest.fixture
def table(monkeypatch: pytest.MonkeyPatch) -> ChoiceTable[DesignMaker]:
    entries = {
        "rig": EntryPoint("rig", "no_such_module:make", "g"),
        "own": EntryPoint("own", "hil.bench.designs:rig_design", "g"),
        "broken": EntryPoint("broken", "no_such_module:make", "g"),
    }
    monkeypatch.setattr(choice_table, "installed", lambda _: entries)
    return ChoiceTable("control.design", "g", TableChoice("rig", "built in", rig_design))


def test_an_installed_name_is_listed_and_loaded(table: ChoiceTable[DesignMaker]) -> None:
    assert table.names == ("rig", "own", "broken")
    assert table.find("own", "file.toml").make is rig_design


def test_a_built_in_name_always_means_the_built_in_row(table: ChoiceTable[DesignMaker]) -> None:
    assert table.find("rig", "file.toml").summary == "built in"


def test_a_package_that_does_not_load_and_a_name_that_is_not_there_are_told_apart(
    table: ChoiceTable[DesignMaker],
) -> None:
    with pytest.raises(hil.SettingsError, match=r"file\.toml: control\.design = 'broken'.*No module named"):
        table.find("broken", "file.toml")
    with pytest.raises(
        hil.SettingsError, match=r"file\.toml: control\.design = 'pid': must be one of rig, own, broken"
    ):
        table.find("pid", "file.toml")
