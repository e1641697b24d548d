"""A rig file with other values: comments and order stay, and a replaced file is never lost."""

from __future__ import annotations

import difflib
import os
import tomllib
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.rig_file_writer import COMMENTS, read_rig_text, replace_rig_file, rig_text_with
from hil.edge.config.settings_file import SettingsError
from hil.edge.record.record_errors import IncompleteRecordError
from tests.cli.failing_disk import FailingDisk

CONFIG = Path(__file__).resolve().parents[2] / "config"
SHIPPED = [CONFIG / "rig.toml", *sorted((CONFIG / "rigs").glob("*.toml"))]
NOW = datetime(2026, 11, 26, 7, 30)


def _text(path: Path = SHIPPED[0]) -> str:
    return read_rig_text(path)


def _changed_lines(old: str, new: str) -> list[str]:
    lines = difflib.unified_diff(old.splitlines(), new.splitlines(), n=0, lineterm="")
    return [line for line in lines if line[0] in "+-" and line[:3] not in ("---", "+++")]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: str(path.stem))
def test_every_number_of_a_shipped_rig_goes_through_unchanged(path: Path) -> None:
    text = _text(path)
    values = {
        f"{section}.{name}": value
        for section, table in tomllib.loads(text).items()
        for name, value in table.items()
        if isinstance(value, (float, list))
    }
    assert rig_text_with(text, values) == text


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: str(path.stem))
def test_every_number_of_a_shipped_rig_can_be_changed_and_is_read_back(path: Path) -> None:
    text = _text(path)
    for section, table in tomllib.loads(text).items():
        for name, value in table.items():
            if not isinstance(value, (float, list)):
                continue
            other = [one * 1.0625 + 0.5 for one in value] if isinstance(value, list) else value * 1.0625 + 0.5
            new = rig_text_with(text, {f"{section}.{name}": other})
            assert tomllib.loads(new)[section][name] == other
            (minus, plus) = _changed_lines(text, new)
            assert minus.partition("#")[2] == plus.partition("#")[2], "the comment stays"


def test_the_comment_stays_in_its_column() -> None:
    new = rig_text_with(_text(), {"pumps.gain_cm3_Vs": (3.0512, 3.4)})
    assert "gain_cm3_Vs = [3.0512, 3.4]     # flow of each pump for 1 V" in new
    long = rig_text_with(_text(), {"sensors.gain_V_cm": (0.5123, 0.4987, 0.5001, 0.5031)})
    assert "gain_V_cm = [0.5123, 0.4987, 0.5001, 0.5031]  # sensor voltage" in long


def test_one_number_for_all_stays_one_number() -> None:
    assert "lag_s = 0.25  " in rig_text_with(_text(), {"pumps.lag_s": (0.25, 0.25)})
    assert "lag_s = [0.25, 0.3]  " in rig_text_with(_text(), {"pumps.lag_s": (0.25, 0.3)})


def test_a_missing_key_is_put_where_a_rig_file_has_it_with_its_comment(tmp_path: Path) -> None:
    old = _text(CONFIG / "rigs" / "johansson_minus.toml")
    values = {
        "tanks.datum_cm": (1.2, 0.0, 0.0, 0.0),
        "pumps.dead_zone_V": (0.31, 0.4),
        "pumps.curve_1_V": (0.01, 0.0),
        "pumps.delay_s": (0.2, 0.3),
        "sensors.offset_V": (0.1, 0.0, 0.0, 0.0),
        "uncertainty.pump_gain": (0.005, 0.006),
        "uncertainty.lag": (0.1, 0.1),
    }
    new = rig_text_with(old, values)
    (tmp_path / "rig.toml").write_text(new)
    load_rig(tmp_path / "rig.toml")
    assert not [line for line in _changed_lines(old, new) if line[0] == "-"], "nothing is lost"
    parsed = tomllib.loads(new)
    assert list(parsed) == ["tanks", "pumps", "sensors", "uncertainty", "control", "safety", "bus"]
    pumps = ["gain_cm3_Vs", "dead_zone_V", "curve_1_V", "valve_split", "lag_s", "delay_s", "range_V", "rate_V_s"]
    assert list(parsed["pumps"]) == pumps
    assert parsed["uncertainty"] == {"pump_gain": [0.005, 0.006], "lag": 0.1}
    assert "# below this voltage a pump gives no flow; one value, or two" in new


def test_a_key_is_not_put_between_a_line_and_the_rest_of_its_comment() -> None:
    old = _text().replace(
        "valve_split = [0.70, 0.60]      # gamma: share of a pump's flow that goes to its lower tank\n", ""
    )
    new = rig_text_with(old, {"pumps.valve_split": (0.7, 0.6)})
    after_curve = new[new.index("curve_1_V") :].splitlines()[:3]
    assert after_curve[1].strip() == "# value, or two"
    assert after_curve[2].startswith("valve_split = [0.7, 0.6]")


def test_comments_of_new_keys_are_those_of_the_shipped_file() -> None:
    """The table of comments once could differ from the file that the documents show."""
    joined = " ".join(line.strip().lstrip("# ") if line.startswith(" ") else line for line in _text().splitlines())
    for key, comment in COMMENTS.items():
        assert " ".join(comment.split()) in " ".join(joined.split()), key


def test_line_ends_and_a_missing_last_line_end_are_kept() -> None:
    old = "\r\n".join(_text(SHIPPED[-1]).splitlines())
    new = rig_text_with(old, {"pumps.dead_zone_V": (0.3, 0.4), "uncertainty.outlet": (0.01,) * 4})
    assert "\n" not in new.replace("\r\n", "")
    assert not [line for line in _changed_lines(old, new) if line[0] == "-"]


@pytest.mark.parametrize(
    "pumps",
    [
        "pumps = { gain_cm3_Vs = [1.0, 2.0] }\n",
        "pumps.gain_cm3_Vs = [1.0, 2.0]\n",
        "[pumps]\ngain_cm3_Vs = [\n  1.0,  # left\n  2.0,  # right\n]\n",
        '["pumps"]\n"gain_cm3_Vs" = [1.0, 2.0]',
    ],
)
def test_other_ways_to_write_it(pumps: str) -> None:
    new = rig_text_with(pumps, {"pumps.gain_cm3_Vs": (1.0, 2.5), "pumps.lag_s": (0.2, 0.3)})
    assert tomllib.loads(new)["pumps"] == {"gain_cm3_Vs": [1.0, 2.5], "lag_s": [0.2, 0.3]}
    assert ("# left" in pumps) == ("# left" in new)


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [("[pumps", "pumps.lag_s", "not TOML"), ("", "pumps.colour", "no key"), ("", "colour", "no key")],
)
def test_what_can_not_be_written_is_refused(text: str, key: str, words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        rig_text_with(text, {key: 1.0})


def test_the_replaced_file_is_kept_as_a_dated_copy_and_no_copy_is_overwritten(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_bytes(b"first")
    rig.chmod(0o640)
    first = replace_rig_file(rig, "second\r\n", NOW)
    second = replace_rig_file(rig, "third", NOW)
    assert first == tmp_path / "rig-2026-11-26T07-30.toml"
    assert (first.read_bytes(), second.read_bytes(), rig.read_bytes()) == (b"first", b"second\r\n", b"third")
    assert rig.stat().st_mode & 0o777 == first.stat().st_mode & 0o777 == 0o640
    assert len(list(tmp_path.iterdir())) == 3


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    real, link = tmp_path / "real" / "lab.toml", tmp_path / "rig.toml"
    real.write_text("old")
    link.symlink_to(real)
    copy = replace_rig_file(link, "new", NOW)
    assert link.is_symlink()
    assert (real.read_text(), copy.parent, copy.name) == ("new", real.parent, "lab-2026-11-26T07-30.toml")


@pytest.mark.parametrize(
    "name", ["a b [c] *?.toml", "rig\nfile.toml", "ünï.toml", "rig", "..toml", "-r.toml", "x.y.toml"]
)
def test_hostile_file_names(tmp_path: Path, name: str) -> None:
    rig = tmp_path / name
    rig.write_text("old")
    copy = replace_rig_file(rig, "new", NOW)
    assert (rig.read_text(), copy.read_text(), copy.parent) == ("new", "old", tmp_path)


def test_a_disk_that_is_full_at_any_moment_leaves_the_file_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = tmp_path / "rig.toml"
    for fails_from in range(1, 20):
        rig.write_text("old")
        disk = FailingDisk(tmp_path, fails_from)
        with monkeypatch.context() as patch:
            disk.install(patch)
            try:
                replace_rig_file(rig, "new", NOW)
            except IncompleteRecordError as error:
                said = str(error)
            else:
                assert fails_from > 4, "copy and file take at least four operations"
                return
        assert "No space left" in said
        assert rig.read_text() == "old"
        assert list(tmp_path.iterdir()) == [rig], "no other file is left"
    pytest.fail("it never succeeded")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_can_not_be_written_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text("old")
    tmp_path.chmod(0o555)
    try:
        with pytest.raises(IncompleteRecordError, match=r"rig-2026-11-26T07-30\.toml can't be written"):
            replace_rig_file(rig, "new", NOW)
    finally:
        tmp_path.chmod(0o755)
    assert rig.read_text() == "old"


def test_every_key_that_may_be_missing_and_is_identified_has_a_comment() -> None:
    optional = {
        f"{section}.{name}"
        for section in ("tanks", "pumps", "sensors", "uncertainty")
        for name, field in _fields(section).items()
        if not field.is_required()
    }
    assert optional <= set(COMMENTS)


def _fields(section: str) -> Any:
    return Rig.model_fields[section].annotation.model_fields  # type: ignore[union-attr]
