"""The generated reference pages: they name everything that the code has, and say something about each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cantools
import pytest
import typer

import hil
from firmware_sim.faults.catalogue import KINDS
from hil.bench.designs import DESIGNS
from hil.bench.detectors import DETECTORS
from hil.campaigns.spec import load_spec
from hil.cli.app import app
from hil.edge.config.scenario_file import load_scenario
from hil.edge.record.signals import SIGNALS
from tools.reference import FOLDER, ROOT
from tools.reference.comments import comments_of
from tools.reference.pages import PAGES, write_pages
from tools.reference.ranges import range_of
from tools.reference.settings import FILES, SettingsFile, keys_of_file, range_of_key
from tools.reference.units import unit_of

FREE_NUMBERS = {
    "accept[].min",
    "accept[].max",
    "reference[].change_V",
    "fault[].value",
    "fault[].values",
    "pairs.pool[].value_range",
    "one_fault.pool[].value_range",
}
"""Keys whose range depends on something else: the process, the kind of the fault, or the figure that is limited."""


def of_file(title: str) -> SettingsFile:
    return next(file for file in FILES if file.title == title)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.title)
def test_every_settings_key_has_meaning_range_and_unit(file: SettingsFile) -> None:
    comments = comments_of(file.example)
    for key in keys_of_file(file):
        assert comments.get(key.path), f"{file.example.name} says nothing about {key.path}"
        accepted = range_of_key(key)
        assert accepted, key.path
        is_free_number = accepted in ("number", "list of number", "2 numbers, each number")
        assert not is_free_number or key.path in FREE_NUMBERS, f"{key.path} has no range"
        if "value" in range_of(key.field) and "_" in key.name and not key.name.endswith(("_seed", "_max")):
            assert unit_of(key.name) != "–", f"{key.path} has no unit"


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.title)
def test_the_examples_explain_no_key_that_the_settings_do_not_have(file: SettingsFile) -> None:
    known = {key.path for key in keys_of_file(file)}
    free = tuple(key.path + "." for key in keys_of_file(file) if range_of(key.field) == "table")
    for path in comments_of(file.example):
        is_table = any(key.startswith((path + ".", path + "[]")) for key in known)
        assert path in known or is_table or path.startswith(free), path


def test_the_annotated_scenario_and_campaign_are_valid() -> None:
    assert load_scenario(of_file("Scenario file").example).scenario.name == "one_pump"
    spec, scenarios = load_spec(of_file("Campaign file").example)
    assert spec.campaign.seeds == 50
    assert all(path.is_file() for path in scenarios)


def test_the_settings_page_has_the_shipped_values_and_every_choice() -> None:
    page = PAGES["settings.md"]()
    assert "| `safety.level_max_cm` | cm | 0 < value | `19` |" in page
    assert all(f"| `{name}` |" in page for name in ("rig", "calibrated", "glr", "ideal", "none"))
    assert {"rig", "calibrated"} <= set(DESIGNS.names)
    assert {"glr", "ideal", "none"} <= set(DETECTORS.names)


def test_the_command_line_page_has_every_command_and_option() -> None:
    page = PAGES["command-line.md"]()
    group: Any = typer.main.get_command(app)
    for name, command in group.commands.items():
        section = page.partition(f"\n## hil {name}\n")[2].partition("\n## ")[0]
        for one in command.params:
            if one.param_type_name == "option" and one.name != "help":
                assert all(f"`{opt}`" in section for opt in one.opts), (name, one.opts)
                assert one.help, f"hil {name} {one.opts}: no help"
    assert "\n## firmware-sim\n" in page


def test_the_frames_page_has_every_signal_with_its_unit() -> None:
    page = PAGES["frames.md"]()
    database: Any = cantools.database.load_file(str(ROOT / "config/bench.dbc"), cache_dir=None)
    for message in database.messages:
        section = page.partition(f"\n## {message.name}\n")[2].partition("\n## ")[0]
        assert f"`0x{message.frame_id:03X}`" in section
        for signal in message.signals:
            assert f"| `{signal.name}` |" in section
    assert "| `Level1` | 0..15 | 0.0002 | 0..10.24 | V |" in page


def test_the_fault_kinds_page_has_every_kind() -> None:
    page = PAGES["fault-kinds.md"]()
    assert all(f"| `{kind}` |" in page for kind in KINDS)


def test_the_signals_page_has_every_column() -> None:
    page = PAGES["signals.md"]()
    assert all(f"`{signal.column}`" in page for signal in SIGNALS)


def test_the_api_page_has_every_public_name_once() -> None:
    entries = [line for line in PAGES["api.md"]().splitlines() if line.startswith("::: ")]
    assert sorted(entries) == sorted(f"::: hil.{name}" for name in getattr(hil, "__all__", ()))


def test_pages_that_have_not_changed_are_not_written_again(tmp_path: Path) -> None:
    write_pages(tmp_path)
    before = {file.name: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    write_pages(tmp_path)
    assert before == {file.name: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    assert set(before) == set(PAGES)


def test_generated_pages_are_not_in_version_control() -> None:
    ignored = (ROOT / ".gitignore").read_text().splitlines()
    assert all(f"/{(FOLDER / name).relative_to(ROOT).as_posix()}" in ignored for name in PAGES)
