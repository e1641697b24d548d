"""Isolation: what is reported while candidates remain."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hil.core.diagnosis.glr import declaration, isolation


def test_what_can_not_be_told_apart_is_reported_once_and_only_under_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(declaration, "unresolved", lambda _m, _suspicion, likely: likely)
    memory: Any = None
    suspicion: Any = SimpleNamespace(is_told=False, number=4)
    without_number: Any = SimpleNamespace(is_told=False, number=None)
    reports: list[Any] = [isolation._still_open(memory, one, [1, 2]) for one in (without_number, suspicion, suspicion)]
    assert reports == [[], [[1, 2]], []]
