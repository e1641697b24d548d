"""Isolation: what is reported while candidates remain."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hil.core.diagnosis.glr import declaration, isolation, onsets


def test_what_can_not_be_told_apart_is_reported_once_and_only_under_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(declaration, "unresolved", lambda _m, _suspicion, likely: likely)
    memory: Any = None
    suspicion: Any = SimpleNamespace(is_told=False, number=4)
    without_number: Any = SimpleNamespace(is_told=False, number=None)
    reports: list[Any] = [isolation._still_open(memory, one, [1, 2]) for one in (without_number, suspicion, suspicion)]
    assert reports == [[], [[1, 2]], []]


def test_as_many_onsets_are_tried_before_the_likeliest_as_after_it() -> None:
    """All steps next to it among them: an onset that is wrong by one step makes the size wrong."""
    tried = onsets.ONSETS_AROUND
    assert len(set(tried)) == len(tried)
    assert {-by for by in tried} == set(tried) >= {-1, 0, 1}
