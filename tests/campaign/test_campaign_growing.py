"""How runs with growing faults are judged: the time from which they matter, and candidates that hold them."""

from __future__ import annotations

from io import StringIO
from typing import Any

import pytest
from rich.console import Console

from hil.campaigns import growing, statistics
from hil.campaigns.campaign_report import render
from hil.cli import campaign_tables
from hil.review.alarms import Injected, Judgement, judge, merged
from tests.campaign.campaign_bench import row

CLOGS = Injected("outlet_block", 3, 0.5, 100.0, ramp_s=100.0)
SPLIT = (0.7, 0.6)


def judged(*alarms: dict[str, Any], fault: Injected = CLOGS) -> Judgement:
    return judge((fault,), merged(alarms))


def alarm(t_s: float, kind: str, target: int, number: int = 1, **more: Any) -> dict[str, Any]:
    isolated_s = None if kind == "unresolved" else t_s
    return {
        "detected_s": t_s, "isolated_s": isolated_s, "kind": kind, "target": target, "number": number, **more,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("fault", "grown_s"),
    [
        (CLOGS, 110.0),
        (Injected("pump_effectiveness", 1, 0.5, 100.0, ramp_s=50.0), 105.0),
        (Injected("valve_split", 2, 0.4, 100.0, ramp_s=20.0), 105.0),
        (Injected("sensor_drift", 1, -0.05, 100.0), 105.0),
        (Injected("sensor_bias", 4, 0.5, 100.0, ramp_s=10.0), 105.0),
        (Injected("leak", 1, 0.04, 100.0, ramp_s=10.0), None),
        (Injected("leak", 1, 0.5, 100.0), None),
        (Injected("sensor_stuck", 1, 0.0, 100.0), None),
    ],
)
def test_a_growing_fault_matters_from_5_percent_on(fault: Injected, grown_s: float | None) -> None:
    found = growing.figures((fault,), judged(fault=fault), SPLIT)
    assert found.named_s is None
    assert found.grown_s == pytest.approx(grown_s)


def test_the_time_to_the_right_name_counts_from_5_percent() -> None:
    assert growing.figures((CLOGS,), judged(alarm(130.0, "outlet_block", 3)), SPLIT).named_s == pytest.approx(20.0)
    assert growing.figures((CLOGS,), judged(alarm(104.0, "outlet_block", 3)), SPLIT).named_s == pytest.approx(-6.0)


def test_a_name_that_was_wrong_before_does_not_count_as_soon() -> None:
    changed = judged(alarm(104.0, "sensor_drift", 3), alarm(130.0, "outlet_block", 3))
    beside = judged(alarm(104.0, "outlet_block", 3), alarm(130.0, "sensor_drift", 3, number=2))
    assert [growing.figures((CLOGS,), verdict, SPLIT).named_s for verdict in (changed, beside)] == [None, None]


def test_an_open_alarm_holds_its_candidates() -> None:
    """A run that ended with the fault among the candidates counted as one with a wrong name."""
    names = ("sensor_drift 3", "outlet_block 3")
    still_open = judged(alarm(104.0, "unresolved", 0, candidates=names))
    assert (still_open.is_right, still_open.is_held) == (False, True)
    assert not judged(alarm(104.0, "unresolved", 0, candidates=names[:1])).is_held
    withdrawn = alarm(120.0, "unresolved", 0, candidates=names, is_recovery=True)
    assert not judged(alarm(104.0, "unresolved", 0, candidates=names), withdrawn).is_held
    wrong_beside = judged(alarm(104.0, "leak", 1, number=2), alarm(104.0, "unresolved", 0, candidates=names))
    assert not wrong_beside.is_held
    assert not judged(alarm(104.0, "leak", 1)).is_held


def test_an_unresolved_alarm_with_a_known_growing_fault_is_a_repetition() -> None:
    """It counted as a spurious one, that names a fault that does not exist."""
    again = alarm(150.0, "unresolved", 0, number=2, candidates=("outlet_block 3", "leak 1"))
    assert len(judged(alarm(104.0, "outlet_block", 3), again).repeated) == 1
    other = alarm(150.0, "unresolved", 0, number=2, candidates=("leak 1",))
    unclear = judged(alarm(104.0, "outlet_block", 3), other)
    assert (unclear.is_right, unclear.is_held) == (False, True)


def test_table_and_report_have_the_share_that_was_named_in_time() -> None:
    known: dict[str, Any] = {"label": "leak 1 = 0.5 in 50 s", "detected": True, "held": True, "grown_s": 105.0}
    rows = [
        row(**known, right=True, named_s=60.0),
        row(**known, right=True, named_s=61.0),
        row(**known, right=False, named_s=None),
        row(**(known | {"held": False}), right=False, named_s=None),
    ]
    (one,) = statistics.fault_classes(rows)
    assert (one.held, one.prompt) == (0.75, 0.25)
    for width in (120, 60):
        console = Console(file=StringIO(), width=width)
        campaign_tables.show(console, rows)
        shown = console.file.getvalue()  # type: ignore[attr-defined]
        assert "75.0%" in shown
        assert "25.0%" in shown
    assert "right 60 s after 5 %" in render("growing", rows)
    (plain,) = statistics.fault_classes([row(label="leak 1", detected=True, right=True)])
    assert plain.prompt is None
