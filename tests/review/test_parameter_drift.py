"""A run's verdict on its rig file in words and figures, and what of the record it uses."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from hil.core.identification.drift import Drift, Moved
from hil.edge.record.manifest import Manifest, RunPlan
from hil.edge.record.run_folder import RunFolder
from hil.review import kpi
from hil.review.drift_section import drift_section
from hil.review.parameter_drift import busiest, file_words, first_fault_s, hours_since_file, parameters_json, sentence
from hil.review.ticks import LoggedEvent

MOVED = Moved("k1", 3.33, 3.2268, 0.001, 0.0999)


def manifest(settings: dict[str, object]) -> Manifest:
    plan = RunPlan("made", "live", None, 0.1, settings=settings)
    return Manifest(plan, "complete", "", "2026-11-14T12:00:00.000+00:00", None, {})


def test_a_move_is_said_with_the_day_of_the_file() -> None:
    of_file = manifest({"rig_file_utc": datetime(2026, 11, 12, 12, tzinfo=UTC).isoformat()})
    values = parameters_json(Drift((MOVED,), ()), hours_since_file(of_file))
    assert values["k1"]["per_hour"] == pytest.approx((3.2268 - 3.33) / 48.0, rel=1e-5)
    text = sentence("k1", values["k1"], file_words(of_file))
    assert text == "pump 1 gives 3.1 % less than the rig file of 12 November says (1.0 standard deviations)"


def test_without_the_files_day_there_is_no_rate() -> None:
    assert hours_since_file(manifest({})) is None
    assert parameters_json(Drift((MOVED,), ()), None)["k1"]["per_hour"] is None


@pytest.mark.parametrize(
    ("name", "estimate", "words"),
    [
        ("gamma2", 0.66, "the valve of pump 2 passes 10 % more to the lower tank than"),
        ("a3", 0.54, "the outlet of tank 3 is 10 % narrower than"),
    ],
)
def test_each_kind_of_parameter_has_words_of_its_own(name: str, estimate: float, words: str) -> None:
    value = parameters_json(Drift((Moved(name, 0.6, estimate, 0.01, 0.0),), ()), None)[name]
    assert sentence(name, value, "the file says").startswith(words)


def test_the_report_has_a_sentence_for_what_has_moved_and_names_what_is_not_determined(whole_run: RunFolder) -> None:
    figures = kpi.compute(whole_run)
    assert figures.parameters == {}
    assert "Not determined: " in drift_section(whole_run.manifest(), figures)
    moved = replace(figures, parameters=parameters_json(Drift((MOVED,), ()), None))
    html = drift_section(whole_run.manifest(), moved)
    assert "Pump 1 gives 3.1 % less than the rig file says (1.0 standard deviations)." in html
    assert "Not determined by the movement of this run: k2, gamma1" in html


def alarm(t_s: float, onset_s: float | None) -> LoggedEvent:
    data = {
        "number": 1, "kind": "leak", "target": 1, "size": 0.2, "size_std": 0.01, "onset_s": onset_s, "candidates": [],
        "detected_s": t_s, "recovered": False, "t_s": t_s,
    }  # fmt: skip
    return LoggedEvent(t_s, "WARNING", "alarm", "leak", data)


def test_the_record_ends_before_the_first_fault_that_was_named() -> None:
    assert first_fault_s([]) == float("inf")
    assert first_fault_s([alarm(100.0, 90.0)]) == 85.0
    assert first_fault_s([alarm(100.0, None)]) == 95.0
    assert first_fault_s([LoggedEvent(80.0, "ERROR", "trip", "", {})]) == 80.0


def test_of_a_long_record_the_stretch_with_movement_is_used() -> None:
    voltage_V = np.full((4000, 2), 3.0)
    voltage_V[2600:2900, 0] = 4.0
    assert 1900 <= busiest(voltage_V, 1000) <= 2600
    assert busiest(voltage_V[:500], 1000) == 0
