"""Reads JSON of a record as text that every file and terminal takes."""

from __future__ import annotations

import json
from typing import Any

ESCAPE = "\\ud"
"""How half of a pair of surrogates is written, which is no character; anything may write it, and no encoding has it."""


def read_json(text: str) -> Any:
    """As `json.loads`, but for halves of surrogate pairs, which are replaced. Raises ValueError, RecursionError."""
    value = json.loads(text)
    return _whole(value) if ESCAPE in text.lower() else value


def whole_text(text: str) -> str:
    """Text that can be encoded: of a file's name, for example, which may be any bytes."""
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def _whole(value: Any) -> Any:
    if isinstance(value, str):
        return whole_text(value)
    if isinstance(value, list):
        return [_whole(one) for one in value]
    if isinstance(value, dict):
        return {whole_text(name): _whole(one) for name, one in value.items()}
    return value
