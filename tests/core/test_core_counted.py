"""Numbers of things in messages."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from hil.core.counted import counted

HIL = Path(__file__).resolve().parents[2] / "hil"
COUNTED = r" (alarms|trips|runs(?! at)|steps|frames|lines|commands|entries|readings|heartbeats|faults|checks|events)\b"


@pytest.mark.parametrize(
    ("number", "text"), [(0, "0 alarms"), (1, "1 alarm"), (2, "2 alarms"), (1000, "1000 alarms")], ids=str
)
def test_singular_and_plural(number: int, text: str) -> None:
    assert counted(number, "alarm") == text


def test_another_plural_and_another_form() -> None:
    assert [counted(number, "entry", "entries") for number in (1, 2)] == ["1 entry", "2 entries"]
    assert counted(12_345, "line", form=",") == "12,345 lines"


def _plurals_after_a_value(text: str) -> list[str]:
    """Parts of f-strings in which a value is followed by a noun in the plural."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.JoinedStr):
            for before, after in zip(node.values, node.values[1:], strict=False):
                if isinstance(before, ast.FormattedValue) and isinstance(after, ast.Constant):
                    found += [str(after.value)] if re.match(COUNTED, str(after.value)) else []
    return found


def test_no_message_puts_a_number_before_a_plural_by_hand() -> None:
    """The end of a run used to say "1 alarms"."""
    assert _plurals_after_a_value("f'{n} alarms, {m} trips'") == [" alarms, ", " trips"]
    found = {path.name: parts for path in HIL.rglob("*.py") if (parts := _plurals_after_a_value(path.read_text()))}
    assert found == {"demo_command.py": [" runs"]}, "always 13"
