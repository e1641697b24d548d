"""A scenario as TOML text, so that a case can be run and recorded on its own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def toml_text(table: Mapping[str, Any]) -> str:
    """Nested dicts as TOML: values, then tables as inline tables of their names, lists of tables one by one."""
    parts = [f"{_key(name)} = {_value(value)}\n" for name, value in table.items() if not _is_tabular(value)]
    for name, value in table.items():
        if isinstance(value, Mapping):
            parts.append(f"\n[{_key(name)}]\n{_lines(value)}")
        elif _is_tabular(value):
            parts += [f"\n[[{_key(name)}]]\n{_lines(entry)}" for entry in value]
    return "".join(parts).lstrip("\n")


def _is_tabular(value: Any) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(entry, Mapping) for entry in value)
    )


def _lines(table: Mapping[str, Any]) -> str:
    return "".join(f"{_key(name)} = {_value(value)}\n" for name, value in table.items() if value is not None)


def _key(name: str) -> str:
    is_bare = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if is_bare else _value(name)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(name)} = {_value(entry)}" for name, entry in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int | float):
        return repr(value)  # inf and nan are TOML too
    raise TypeError(f"{value!r} has no place in a scenario file")
