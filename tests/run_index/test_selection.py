"""Runs chosen and sorted by expressions, which are never run as code."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.run_index.indexed_run import IndexedRun
from hil.run_index.selection import SelectionError, chosen, ordered

ROWS = [
    IndexedRun(
        name="good", status="complete", seed=1, alarms=0, trips=0, size_bytes=300, law="state_feedback",
        figures={"iae_Vs": {"gain_fall": [0.5, 0.25]}, "overflow": False, "level_max_cm": [1, None], "alarms": []},
    ),
    IndexedRun(
        name="bad", status="tripped", seed=2, alarms=1, trips=1, size_bytes=100, law="mpc",
        figures={"iae_Vs": {"gain_fall": [2.0, 0.5]}, "overflow": True, "alarms": [{"kind": "pump_dead"}]},
    ),
    IndexedRun(name="killed", status="interrupted", size_bytes=200, problem="no kpi.json"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("expression", "names"),
    [
        ("status == 'tripped' and iae.gain_fall[0] > 1", ["bad"]),
        ("status == 'tripped' or iae.gain_fall[0] < 1", ["good", "bad"]),
        ("status in ('complete', 'interrupted')", ["good", "killed"]),
        ("status not in ['complete']", ["bad", "killed"]),
        ("'ed' in status", ["bad", "killed"]),
        ("0.4 < iae_Vs.gain_fall[0] <= 2", ["good", "bad"]),
        ("iae['gain_fall'][-1] * 2 == 1.0", ["bad"]),
        ("overflow", ["bad"]),
        ("not overflow", ["good"]),
        ("alarms + trips > 1", ["bad"]),
        ("kpi.alarms[0].kind == 'pump_dead'", ["bad"]),
        ("len(kpi.alarms) == 0", ["good"]),
        ("seed is None", ["killed"]),
        ("iae.gain_fall is not None", ["good", "bad"]),
        ("abs(seed - 3) == 1", ["bad"]),
        ("-seed < -1", ["bad"]),
        ("status\n== 'complete'", ["good"]),
        ("level_max_cm[1] > 0", []),
        ("level_max_cm[9] > 0", []),
        ("reconfigure == True", []),
    ],
)
def test_an_expression_chooses_runs(expression: str, names: list[str]) -> None:
    assert [row.name for row in chosen(ROWS, expression)] == names


def test_what_a_run_does_not_have_is_unknown_and_chooses_it_in_no_way() -> None:
    for expression in ("iae.gain_fall[0] > 1", "not iae.gain_fall[0] > 1", "iae.gain_fall[0] != 1", "seed + 1 > 0"):
        assert "killed" not in [row.name for row in chosen(ROWS, expression)]
    assert [row.name for row in chosen(ROWS, "seed > 5 or size_bytes == 200")] == ["killed"]


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        ("iae.gain_fal[0] > 1", "did you mean iae.gain_fall?"),
        ("statsu == 'tripped'", "did you mean status"),
        ("iae.xyzw[0] > 1", "iae has: gain_fall"),
        ("trips[0].cause == 'rim'", "the list is kpi.trips"),
        ("status == ", "not an expression"),
        ("", "from 1 to 1000 letters"),
        ("seed > 'x'", "a number can't be compared so with text"),
        ("seed", "true or false"),
        ("1 and overflow", "true or false"),
        ("seed / 0 > 1", "division by zero"),
        ("status * 2 == 'a'", "only numbers"),
        ("seed is 1", "None only"),
        ("iae[seed] > 1", "in brackets"),
        ("iae[0:2] > 1", "in brackets"),
        ("2 ** 9 > seed", "2 ** 9: not possible"),
        ("open('x') == 1", "open('x'): not possible"),
        ("__import__('os').system('true') == 0", "not possible"),
        ("(lambda: 1)() == 1", "not possible"),
        ("[x for x in 'ab'] == 1", "not possible"),
        ("().__class__ == 1", "().__class__: not possible"),
        ("len(seed) > 1", "len() can't be had of a number"),
        ("len(status, 1) == 1", "not possible"),
        ("f'{status}' == 'x'", "not possible"),
        ("(" * 400 + "seed" + ")" * 400 + " > 1", "not an expression"),
    ],
)
def test_what_can_not_be_used_is_one_line_that_says_what_can(expression: str, said: str) -> None:
    with pytest.raises(SelectionError) as raised:
        chosen(ROWS, expression)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


@given(st.text(max_size=40) | st.text("seedkpi.[]()0 1<>=!'+-*/andotr", max_size=40))
def test_no_text_breaks_the_reader(text: str) -> None:
    try:
        chosen(ROWS, text)
    except SelectionError as error:
        assert str(error)  # noqa: PT017 - anything else fails the test


def test_an_expression_without_runs_is_still_read() -> None:
    assert chosen([], "anything.goes > 1") == []
    with pytest.raises(SelectionError):
        chosen([], "anything goes")


@pytest.mark.parametrize(
    ("key", "names"),
    [
        ("size_bytes", ["bad", "killed", "good"]),
        ("-size_bytes", ["good", "killed", "bad"]),
        ("iae.gain_fall[0]", ["good", "bad", "killed"]),
        ("-iae.gain_fall[0]", ["bad", "good", "killed"]),
        ("name", ["bad", "good", "killed"]),
    ],
)
def test_runs_are_sorted_by_a_key_with_unknown_ones_last(key: str, names: list[str]) -> None:
    assert [row.name for row in ordered(ROWS, key)] == names


@pytest.mark.parametrize(("key", "said"), [("sise_bytes", "size_bytes"), ("kpi", "can't be sorted"), ("a b", "not an")])
def test_a_key_that_can_not_sort_is_an_error(key: str, said: str) -> None:
    with pytest.raises(SelectionError, match=said):
        ordered(ROWS, key)
