"""Run folders with odd content: each is named in one line, by every reader."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

import hil
from hil.edge.record.json_text import read_json, whole_text
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review import kpi
from hil.review.ticks import MissingColumnError, Ticks, parse_events, parse_ticks
from tests.review import toy


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("period_s", 0),
        ("period_s", True),
        ("started_utc", "yesterday"),
        ("started_utc", "2026-01-01T00:00:00"),
        ("windows", [{"name": "fall"}]),
        ("copies", {"rig.toml": 5}),
        ("settings", []),
        ("clock", {"zero": 1.0}),
        ("versions", None),
        ("mode", "asleep"),
    ],
)
def test_a_value_of_another_kind_in_run_json_is_named(tmp_path: Path, key: str, value: object) -> None:
    """It came back as an AttributeError or a ValueError wherever it was used."""
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    raw: dict[str, Any] = json.loads(folder.manifest_path.read_text())
    folder.manifest_path.write_text(json.dumps({**raw, key: value}))
    with pytest.raises(RunFolderError, match=rf"run: run\.json is not a run's manifest: {key} = .* must be"):
        hil.open_run(folder.path)


def test_a_manifest_that_is_no_text_or_no_table_names_its_folder(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    folder.manifest_path.write_bytes(b"\xff\xfe")
    with pytest.raises(RunFolderError, match=r"run/run\.json is no text"):
        folder.manifest()
    folder.manifest_path.write_text("[]")
    with pytest.raises(RunFolderError, match=r"run: .* it is no table"):
        folder.manifest()


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"severity": "LOUD"}, "severity = 'LOUD' must be one of INFO, WARN, ERROR"),
        ({"text": 5}, "text = 5 is no text"),
        ({"t_s": "soon"}, "t_s = 'soon' is no number"),
        ({"data": []}, r"data = \[\] is no object"),
    ],
)
def test_an_event_of_other_types_is_refused(change: dict[str, object], what: str) -> None:
    event = {"t_s": 1.0, "severity": "INFO", "code": "x", "text": "y", "data": {}, **change}
    with pytest.raises(RunFolderError, match=f"events, line 1 is not an event: {what}"):
        parse_events(json.dumps(event) + "\n", "events")


def test_text_that_no_encoding_has_is_replaced() -> None:
    """One half of a pair of surrogates ended report and export with a traceback."""
    assert read_json('{"a": ["\\ud83d\\ude00", "\\uD800"]}') == {"a": ["\U0001f600", "\ufffd"]}
    assert whole_text(os.fsdecode(b"run-\xff")) == "run-\ufffd"


def test_a_table_of_control_steps_says_what_it_lacks() -> None:
    with pytest.raises(MissingColumnError, match=r"^the table of control steps, ticks\.csv, has no column h1_est_V$"):
        parse_ticks("t_s\n0.0\n", "ticks")["h1_est_V"]
    with pytest.raises(RunFolderError, match="is empty: no control step was recorded"):
        parse_ticks("", "ticks")
    with pytest.raises(RunFolderError, match="has the column 'a' twice"):
        parse_ticks("t_s,a,a\n0.0,1.0,2.0\n", "ticks")
    assert isinstance(parse_ticks("t_s\n0.0\n", "ticks"), Ticks)


def test_a_run_without_its_tables_can_still_be_shown(tmp_path: Path) -> None:
    """Showing it in a notebook raised FileNotFoundError."""
    folder = RunFolder.create(tmp_path / "run", toy.plan())
    run = hil.open_run(folder.path)
    assert "cannot read" in repr(run)
    for name in ("columns", "ticks", "frames"):
        with pytest.raises(RunFolderError):
            getattr(run, name)
    shutil.rmtree(folder.path)
    with pytest.raises(RunFolderError, match="can't be read"):
        folder.manifest()


def test_a_run_without_a_rig_in_its_settings_is_named_by_its_folder(whole_run: RunFolder, tmp_path: Path) -> None:
    """The line did not say of which run, where `hil report --compare` reads two."""
    shutil.copytree(whole_run.path, tmp_path / "run")
    folder = RunFolder.open(tmp_path / "run")
    raw: dict[str, Any] = json.loads(folder.manifest_path.read_text())
    folder.manifest_path.write_text(json.dumps({**raw, "settings": {}}))
    with pytest.raises(RunFolderError, match=r"/run: run\.json's settings have no rig\.sensors\.gain_V_cm"):
        kpi.compute(folder)
