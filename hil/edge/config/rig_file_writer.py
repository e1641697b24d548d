"""A rig file with other values: its comments, its order and its notation stay.

`rig_text_with` makes the text, `replace_rig_file` puts it in the place of the old file and keeps that as a dated copy.
"""

from __future__ import annotations

import os
import textwrap
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, TypeGuard

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Array, Comment, Item, Table, Whitespace

from hil.edge.config.rig_file import Rig
from hil.edge.config.settings_file import Section, SettingsError, merged
from hil.edge.record.file_writing import writing

Value = float | Sequence[float]

COMMENT_COLUMN, LINE_WIDTH = 32, 128

COMMENTS: dict[str, str] = {
    "tanks.datum_cm": "how far the outlet (the end of its hose) lies below the tank's zero: at level h the water "
    "leaves with the head h + datum; one value, or four",
    "pumps.dead_zone_V": "below this voltage a pump gives no flow; one value, or two",
    "pumps.curve_1_V": "bend of the pump's curve: flow = gain * x * (1 + curve * x), with x = voltage - dead zone; one "
    "value, or two",
    "pumps.delay_s": "transport delay from the pump to the tanks; one value, or two",
    "sensors.offset_V": "sensor voltage at the tank's zero; one value, or four",
    "uncertainty": "one standard deviation of how far the rig may be off this file, as a share of the value there; the "
    "diagnosis takes a larger difference for a fault",
    "uncertainty.pump_gain": "of pumps.gain_cm3_Vs; one value, or two",
    "uncertainty.valve_split": "of pumps.valve_split; one value, or two",
    "uncertainty.outlet": "of tanks.outlet_cm2; one value, or four",
    "uncertainty.lag": "of pumps.lag_s; one value, or two",
}
"""Of the keys and tables that a rig file may leave out: as in the shipped `rig.toml`."""

MAX_COPIES = 1000


def rig_text_with(old_text: str, values: Mapping[str, Value], comments: Mapping[str, str] | None = None) -> str:
    """The rig file's text with other values, each under its key: {"pumps.gain_cm3_Vs": (3.1, 3.4)}.

    A value that is in the file already is left as it is written there. One number for all stays one number where the
    new values are equal. A key that is not in the file is put in its place, with its comment. comments : by key, in
    place of those of `COMMENTS`. Raises SettingsError when the text is not TOML, or a key is none of a rig file.
    """
    try:
        before = tomllib.loads(old_text)
        tomlkit.parse(old_text)
    except (tomllib.TOMLDecodeError, TOMLKitError) as error:
        raise SettingsError(f"the rig file is not TOML: {error}") from None
    wanted: dict[str, dict[str, Any]] = {}
    for key, value in values.items():
        section, name = _checked(key)
        wanted.setdefault(section, {})[name] = _plain(value)
    notes = {**COMMENTS, **(comments or {})}
    text = old_text
    changed: dict[str, dict[str, Any]] = {}
    for section, entries in wanted.items():
        for name, value in entries.items():
            old = before.get(section, {}).get(name)
            if _says(old, value):
                continue
            if isinstance(value, list) and not isinstance(old, list) and len(set(value)) == 1:
                value = value[0]
            changed.setdefault(section, {})[name] = value
            text = _with(text, section, name, value, notes)
    if _parsed(text) != merged(before, changed):
        raise SettingsError(
            "the rig file is written in a way that can't be edited: give each table a header, such as [pumps], and "
            "each key a line"
        )
    return text


def replace_rig_file(path: Path, text: str, now: datetime) -> Path:
    """Put the text in the place of the rig file, as a whole, and keep the old file beside it.

    Returns the path of the copy, `rig-2026-11-26T07-30.toml`; no copy is ever overwritten. A link stays a link: the
    file that it names is replaced. Raises IncompleteRecordError when the folder or the disk does not take it; the rig
    file is then as it was.
    """
    target = path.resolve()
    with writing(target):
        old = target.read_bytes()
        mode = target.stat().st_mode & 0o777
    copy = _keep_copy(target, old, mode, now)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        with writing(target):
            _write_new(temporary, text.encode("utf-8"), mode)
            temporary.replace(target)
    except BaseException:
        with suppress(OSError):
            copy.unlink()  # nothing was replaced
        raise
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    return copy


def read_rig_text(path: Path) -> str:
    """The file's text with the line ends that it has; a byte order mark is left out. Raises SettingsError."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise SettingsError(f"{path}: can't be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path}: is not UTF-8 text: {error}") from None


def _keep_copy(target: Path, old: bytes, mode: int, now: datetime) -> Path:
    for number in range(1, MAX_COPIES + 1):
        more = "" if number == 1 else f"-{number}"
        copy = target.with_name(f"{target.stem}-{now:%Y-%m-%dT%H-%M}{more}{target.suffix}")
        with writing(copy), suppress(FileExistsError):
            _write_new(copy, old, mode)
            return copy
    raise SettingsError(f"{target}: {MAX_COPIES} copies of this minute are there already")


def _write_new(path: Path, content: bytes, mode: int) -> None:
    """Write a file that must not exist before. Raises OSError; nothing is left then."""
    with path.open("xb") as file:
        try:
            path.chmod(mode)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        except BaseException:
            with suppress(OSError):
                path.unlink()
            raise


def _with(text: str, section: str, name: str, value: float | list[float], notes: Mapping[str, str]) -> str:
    """The text with one key changed or added."""
    document = tomlkit.parse(text)
    end = "\r\n" if "\r\n" in text else "\n"
    line = _line(name, value, notes.get(f"{section}.{name}", ""), end)
    table = document.get(section)
    if table is None:
        return _with_table(document, _commented(f"[{section}]", notes.get(section, ""), end) + line, end)
    if name in table:
        _replace(table, name, value)
    elif _has_header(table):
        _append(_neighbour(section, name, table), line, end)
    else:
        table[name] = value
    return tomlkit.dumps(document)


def _with_table(document: tomlkit.TOMLDocument, table_text: str, end: str) -> str:
    """After the sensors, where a rig file has its uncertainty; else at the end."""
    before = document.get("sensors")
    if _has_header(before):
        _append(_last_item(before), end + table_text, end)
        return tomlkit.dumps(document)
    text = tomlkit.dumps(document)
    return text + ("" if text.endswith("\n") else end) + end + table_text


def _has_header(table: Any) -> TypeGuard[Table]:
    return isinstance(table, Table) and not table.is_super_table() and len(table) > 0


def _replace(table: Any, name: str, value: float | list[float]) -> None:
    """Change a value; its comment stays in its column as far as there is room."""
    item = table.item(name) if hasattr(table, "item") else table[name]
    width = len(item.as_string())
    if isinstance(item, Array) and isinstance(value, list) and len(item) == len(value):
        for place, (old, new) in enumerate(zip(item, value, strict=True)):
            if float(old) != new:
                item[place] = new
    else:
        table[name] = value
        item = table.item(name) if hasattr(table, "item") else table[name]
    gap = item.trivia.comment_ws
    if item.trivia.comment and "\n" not in item.as_string():
        item.trivia.comment_ws = " " * max(len(gap) + width - len(item.as_string()), min(len(gap), 2))


def _neighbour(section: str, name: str, table: Table) -> Item:
    """The item after which a new key comes: the last line of the key that goes before it in a rig file."""
    fields = list(_section_of(section).model_fields)
    before = [field for field in fields[: fields.index(name)] if field in table]
    if not before:
        return _last_item(table)
    body = table.value.body
    place = next(i for i, (key, _) in enumerate(body) if key is not None and key.key == before[-1])
    while place + 1 < len(body) and isinstance(body[place + 1][1], Comment) and body[place + 1][1].trivia.indent:
        place += 1  # the comment goes on in the next line
    return body[place][1]


def _last_item(table: Table) -> Item:
    return [item for _, item in table.value.body if not isinstance(item, Whitespace)][-1]


def _append(item: Item, text: str, end: str) -> None:
    """Put lines after the item's line."""
    trail = item.trivia.trail
    item.trivia.trail = (trail if "\n" in trail else trail + end) + text


def _line(name: str, value: float | list[float], comment: str, end: str) -> str:
    return _commented(f"{name} = {tomlkit.item(value).as_string()}", comment, end)


def _commented(code: str, comment: str, end: str) -> str:
    """A line with its comment in the column where a rig file has it, and in further lines as far as it is long."""
    if not comment:
        return code + end
    lines = textwrap.wrap(comment, LINE_WIDTH - COMMENT_COLUMN - 2)
    first = code.ljust(COMMENT_COLUMN - 2) + f"  # {lines[0]}"
    return end.join([first, *(" " * COMMENT_COLUMN + f"# {line}" for line in lines[1:]), ""])


def _checked(key: str) -> tuple[str, str]:
    section, _, name = key.partition(".")
    if section not in Rig.model_fields or name not in _section_of(section).model_fields:
        raise SettingsError(f"{key}: no key of a rig file")
    return section, name


def _section_of(section: str) -> type[Section]:
    kind = Rig.model_fields[section].annotation
    if not (isinstance(kind, type) and issubclass(kind, Section)):
        raise SettingsError(f"{section}: no table of a rig file")
    return kind


def _plain(value: Value) -> float | list[float]:
    return [float(one) for one in value] if isinstance(value, Sequence) else float(value)


def _says(old: Any, value: float | list[float]) -> bool:
    """Whether the file says this already, be it with one number for all."""
    if isinstance(old, list) or not isinstance(value, list):
        return bool(old == value)
    return all(one == old for one in value)


def _parsed(text: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None
