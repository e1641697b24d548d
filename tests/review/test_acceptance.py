"""Limits of a scenario against the key figures of a run, and the JUnit file of their verdicts."""

from typing import Any

import pytest
from pydantic import ValidationError

from hil.edge.config.accept_table import CHECKS, AcceptTable
from hil.review.acceptance import MISSING, LimitVerdict, figure_at, verdicts

ALARM: dict[str, Any] = {"kind": "pump_effectiveness", "target": 1, "detected_s": 200.4}
FIGURES: dict[str, Any] = {
    "iae_Vs": {"fall": [0.2, 0.3], "short": [0.0, 0.0]},
    "settling_s": {"fall": [1.2, 3.5], "never": [0.0, None], "short": None},
    "overshoot_cm": {"fall": [0.2, 0.4], "one": [None, 0.0], "rest": [None, None], "short": None},
    "overshoot_at_s": {"fall": [210.0, 212.5], "one": [None, None], "rest": [None, None], "short": None},
    "level_max_cm": [12.0, 13.5, None, 2.0],
    "level_max_at_s": [20.0, 211.3, None, 3.0],
    "alarms": [ALARM],
    "trips": [{"t_s": 250.0, "cause": "high_level", "text": "tank 1"}],
    "skipped": 2,
    "lateness_s": {"p99": 0.004},
    "overflow": False,
    "status": "tripped",
}
FAULTS = [{"kind": "pump_effectiveness", "target": 1, "value": 0.4, "at_s": 200.0}]


def judged(**limit: Any) -> LimitVerdict:
    (verdict,) = verdicts([AcceptTable.model_validate({"name": "it", **limit})], FIGURES, FAULTS)
    return verdict


@pytest.mark.parametrize(
    ("kept", "broken"),
    [
        ({"iae_V_s": 0.31, "window": "fall"}, {"iae_V_s": 0.29, "window": "fall"}),
        ({"settling_s": 3.5, "window": "fall"}, {"settling_s": 3.4, "window": "fall"}),
        ({"overshoot_cm": 0.4, "window": "fall"}, {"overshoot_cm": 0.39, "window": "fall"}),
        ({"overshoot_cm": 0.0, "window": "one"}, {"overshoot_cm": 9.0, "window": "rest"}),
        ({"detected_within_s": 0.41}, {"detected_within_s": 0.39}),
        ({"named": ["pump_effectiveness 1"]}, {"named": ["pump_effectiveness 2"]}),
        ({"named": ["pump_effectiveness 1"]}, {"named": []}),
        ({"trip": "high_level"}, {"trip": "dry_run"}),
        ({"trip": "high_level"}, {"no_trip": True}),
        ({"level_max_cm": 13.5}, {"level_max_cm": 13.4}),
        ({"skipped_max": 2}, {"skipped_max": 1}),
        ({"lateness_p99_s": 0.004}, {"lateness_p99_s": 0.003}),
        ({"figure": "iae_Vs.fall[1]", "max": 0.3}, {"figure": "iae_Vs.fall[1]", "min": 0.31}),
        ({"figure": "overflow", "equals": False}, {"figure": "overflow", "equals": True}),
        ({"figure": "status", "equals": "tripped"}, {"figure": "status", "equals": "complete"}),
        (
            {"figure": "level_max_cm[0]", "min": 11.0, "max": 12.0},
            {"figure": "level_max_cm[0]", "min": 1.0, "max": 11.0},
        ),
        ({"figure": "skipped", "equals": 2}, {"figure": "skipped", "equals": True}),
        ({"no_trip": True}, {"no_alarm": True}),
    ],
)
def test_a_limit_is_kept_or_not(kept: dict[str, Any], broken: dict[str, Any]) -> None:
    if kept != {"no_trip": True}:
        assert judged(**kept).is_passed
    assert not judged(**broken).is_passed


def test_a_run_without_alarms_and_trips_keeps_the_limits_on_them() -> None:
    quiet = {**FIGURES, "alarms": [], "trips": []}
    limits: list[dict[str, Any]] = [{"no_alarm": True}, {"no_trip": True}, {"named": []}]
    accepts = [AcceptTable.model_validate({"name": "it", **limit}) for limit in limits]
    assert all(verdict.is_passed for verdict in verdicts(accepts, quiet, ()))


def test_a_verdict_says_value_limit_and_time() -> None:
    found = judged(detected_within_s=0.1)
    assert (found.value, found.limit, found.at_s) == ("pump_effectiveness 1: 0.4 s", "at most 0.1 s", 200.4)
    found = judged(no_trip=True)
    assert (found.value, found.limit, found.at_s) == ("high_level", "no trip", 250.0)
    found = judged(named=["sensor_bias 2"])
    assert (found.value, found.limit, found.at_s) == ("pump_effectiveness 1", "sensor_bias 2", 200.4)
    found = judged(level_max_cm=13.0)
    assert (found.value, found.limit, found.when) == ("13.5 cm", "at most 13 cm", "211.3 s")
    found = judged(overshoot_cm=0.1, window="fall")
    assert (found.value, found.limit, found.when) == ("0.4 cm", "at most 0.1 cm", "212.5 s")
    found = judged(iae_V_s=0.1, window="fall")
    assert (found.value, found.limit, found.when) == ("0.3 V s", "at most 0.1 V s", "fall")
    assert judged(skipped_max=0).when == "whole run"


def test_an_output_that_does_not_settle_keeps_no_limit() -> None:
    found = judged(settling_s=1e9, window="never")
    assert (found.value, found.is_passed) == ("output 2: not settled in the window", False)
    for key in ("settling_s", "overshoot_cm"):
        found = judged(**{key: 1e9, "window": "short"})
        assert (found.value, found.is_passed) == ("the run ended before the window did", False)


@pytest.mark.parametrize("path", ["nothing", "iae_Vs.fall[2]", "iae_Vs.rise[0]", "status[0]", "skipped.max"])
def test_a_figure_that_is_not_there_keeps_no_limit(path: str) -> None:
    assert figure_at(FIGURES, path) is None
    found = judged(figure=path, max=1e9)
    assert (found.value, found.is_passed) == (MISSING, False)
    assert not judged(figure=path, equals="").is_passed


def test_a_fault_that_nobody_reported_keeps_no_limit_on_detection() -> None:
    accept = AcceptTable(name="it", detected_within_s=1e9)
    others: list[dict[str, Any]] = [{"target": 2}, {"detected_s": 199.0}]
    for alarms in ([], *([{**ALARM, **other}] for other in others)):
        (found,) = verdicts([accept], {**FIGURES, "alarms": alarms}, FAULTS)
        assert not found.is_passed
        assert found.value == "pump_effectiveness 1: not reported"
    (found,) = verdicts([accept], FIGURES, ())
    assert not found.is_passed, "there is nothing to detect: the limit says nothing"


@pytest.mark.parametrize(
    ("limit", "text"),
    [
        ({}, "none of iae_V_s"),
        ({"no_trip": True, "no_alarm": True}, "no_alarm, no_trip of"),
        ({"iae_V_s": 1.0}, "need window"),
        ({"no_trip": True, "window": "fall"}, "need window"),
        ({"no_trip": True, "max": 1.0}, "are for figure"),
        ({"figure": "skipped"}, "needs min or max"),
        ({"figure": "skipped", "max": 1.0, "equals": 1}, "needs min or max"),
        ({"figure": "skipped", "max": 1.0, "min": 2.0}, "min 2 is above max 1"),
        ({"figure": "a b", "max": 1.0}, "figure"),
        ({"no_alarm": False}, "no_alarm"),
    ],
)
def test_a_limit_that_says_nothing_or_two_things_is_refused(limit: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        AcceptTable.model_validate({"name": "it", **limit})


def test_every_check_is_in_the_list() -> None:
    about = {"name", "window", "min", "max", "equals"}
    assert set(AcceptTable.model_fields) - about == set(CHECKS)
