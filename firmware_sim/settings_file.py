"""Settings files of the emulator: reading, merging, and errors that name file, key, value and what is allowed."""

import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

WORDS = {"model_type": "must be a table", "bool_type": "must be true or false"}
"""For the errors that are not from our own checks (`firmware_sim.setting_types`)."""

OTHER_FILES = {
    "campaign": "a campaign",
    "scenario": "a scenario",
    "nodes": "an emulator file",
    "safety": "a rig file",
    "bus": "a rig file",
}
"""A table at the top -> the only kind of file that has it."""


class SettingsError(ValueError):
    """A settings file is missing, is not TOML, or has a value that is not allowed."""


def check_kind(data: dict[str, Any], file: Path | None, table: str, kind: str) -> None:
    """Refuse a file that is plainly of another kind. table : what files of the right kind have."""
    if table in data:
        return
    found = next((what for name, what in OTHER_FILES.items() if name in data), "")
    if found:
        raise SettingsError(f"{file}: is {found}, not {kind}")


def read_text(file: Path) -> str:
    """The text of a file, which is UTF-8. Raises SettingsError."""
    try:
        return file.read_text(encoding="utf-8-sig")  # some editors write a byte order mark; it is no part of the text
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise SettingsError(f"{file}: is not UTF-8 text (byte {error.start})") from None


def read_toml(file: Path) -> dict[str, Any]:
    """The file as nested dicts. Raises SettingsError."""
    try:
        return tomllib.loads(read_text(file))
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{file}: is not valid TOML: {error}") from None


def merged(base: dict[str, Any], overlay: dict[str, Any]) -> dict[str, Any]:
    """`base` with the values of `overlay`, table by table."""
    result = dict(base)
    for key, value in overlay.items():
        below = result.get(key)
        are_tables = isinstance(below, dict) and isinstance(value, dict)
        result[key] = merged(below, value) if are_tables else value  # type: ignore[arg-type]
    return result


def holds(table: Any, path: tuple[int | str, ...]) -> bool:
    """Whether the value at path (or the table or list that lacks it) is in this table."""
    for part in path:
        if isinstance(table, list):
            return True
        if not isinstance(table, dict) or part not in table:
            return False
        table = table[part]
    return True


def first_complaint(error: ValidationError) -> tuple[tuple[int | str, ...], str]:
    """Key path of the first complaint, and the rest of its line."""
    complaint = error.errors(include_url=False)[0]
    kind = complaint["type"]
    if kind == "missing":
        return complaint["loc"], ": key is missing"
    if kind == "extra_forbidden":
        return complaint["loc"], f" = {complaint['input']!r}: unknown key"
    return complaint["loc"], f" = {complaint['input']!r}: {WORDS.get(kind, complaint['msg'])}"


def dotted(path: tuple[int | str, ...]) -> str:
    """A key path as in a file: "pumps.lag_s[1]"."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).lstrip(".")
