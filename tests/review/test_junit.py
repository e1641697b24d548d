"""The JUnit file of verdicts: the rules of its schema, names, counts; any text."""

from datetime import datetime

import junitparser
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.review.acceptance import LimitVerdict
from hil.review.judged_scenario import JudgedScenario, is_good, summary
from hil.review.junit import junit_text
from tests.review.junit_file import checked

KEPT = LimitVerdict("no trip", "no_trip", "none", "no trip", None, True)
BROKEN = LimitVerdict("dry", "level_max_cm", "13.5 cm", "at most 0.1 cm", 211.34, False)
TESTED = (
    JudgedScenario("loss.of.pump", (KEPT, BROKEN), 1.5, about=(("seed", "3"),), began=datetime(2024, 2, 29, 12, 30, 5)),
    JudgedScenario("full", error="disk full", duration_s=0.5),
    JudgedScenario("hold", not_run="no [[accept]] table"),
    JudgedScenario("tripped", (KEPT,), 0.25, error="the run did not go to its end: tripped, high_level"),
)


def test_the_file_keeps_the_schema_s_rules() -> None:
    root = checked(junit_text(TESTED, "bench 1"))
    counts = [[suite.get(key) for key in ("name", "tests", "failures", "errors", "skipped")] for suite in root]
    assert counts == [
        ["loss.of.pump", "2", "1", "0", "0"],
        ["full", "1", "0", "1", "0"],
        ["hold", "1", "0", "0", "1"],
        ["tripped", "2", "0", "1", "0"],
    ]
    assert root[0].get("timestamp") == "2024-02-29T12:30:05"
    assert [one.get("value") for one in root.findall("testsuite[1]/properties/property")] == ["loss.of.pump", "3"]


def test_a_failure_shows_value_limit_and_time() -> None:
    failure = checked(junit_text(TESTED, "bench")).find("testsuite/testcase/failure")
    assert failure is not None
    assert failure.get("message") == failure.text == "13.5 cm; limit: at most 0.1 cm; when: 211.3 s"


def test_a_server_finds_package_class_and_case() -> None:
    """It takes the class up to the last point as the package."""
    root = checked(junit_text(TESTED, "bench"))
    found = [(*case.get("classname", "").rsplit(".", 1), case.get("name")) for case in root[0].findall("testcase")]
    assert found == [("hil.test", "loss_of_pump", "no trip"), ("hil.test", "loss_of_pump", "dry")]


def test_a_parser_of_another_project_reads_it() -> None:
    suites = junitparser.JUnitXml.fromstring(junit_text(TESTED, "bench").encode())
    assert (suites.tests, suites.failures, suites.errors, suites.skipped) == (6, 1, 2, 1)
    loss = next(suite for suite in suites if suite.name == "loss.of.pump")
    (result,) = next(case for case in loss if case.name == "dry").result
    assert isinstance(result, junitparser.Failure)
    assert "13.5 cm" in result.message


@given(st.text(), st.text(min_size=1))
def test_any_text_makes_a_valid_file(value: str, name: str) -> None:
    verdict = LimitVerdict(f"x{name}", "figure", value, "1", None, False)
    root = checked(junit_text([JudgedScenario("one", (verdict,)), JudgedScenario("two", error=f"e{value}")], name))
    assert len(root.findall("testsuite/testcase/failure")) == 1


def test_the_schema_refuses_what_servers_refuse() -> None:
    good = junit_text(TESTED, "bench")
    for old, new in (
        ('hostname="bench" ', ""),
        ("<system-out />", ""),
        ("2024-02-29T12:30:05", "2024-02-29 12:30"),
        ('type="run"', ""),
        ('<skipped message="no [[accept]] table" />', '<skipped /><failure type="a" />'),
        ('id="1"', 'id="0"'),
    ):
        assert old in good
        with pytest.raises(AssertionError):
            checked(good.replace(old, new))


def test_the_summary_leaves_out_what_did_not_run() -> None:
    assert summary(TESTED) == "0 of 3 scenarios passed, 1 not run"
    assert not is_good(TESTED)
    assert is_good(TESTED[2:3])
    assert [one.result for one in TESTED] == ["FAILED", "ERROR", "not run", "ERROR"]
