"""Verdicts as a JUnit file, which continuous integration reads: a suite for each scenario, a case for each limit.

The format has no standard. The file keeps the rules of both schemas in use, that of Ant's reports and that of Jenkins'
xUnit plugin: a suite has name, package, id, host, time stamp and counts; properties first, then the cases, then the two
outputs; a case has class and name, and at most one of failure, error and skipped.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime
from xml.etree import ElementTree

from hil.review.judged_scenario import JudgedScenario, failure_text

NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
PACKAGE = "hil.test"
RUN_CASE = "run"
"""The case of a scenario that has no verdicts."""


def junit_text(tested: Sequence[JudgedScenario], host: str) -> str:
    """The file's text. host : name of this computer, for the suites."""
    root = ElementTree.Element("testsuites")
    for number, one in enumerate(tested):
        _suite(root, number, one, host)
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _suite(root: ElementTree.Element, number: int, one: JudgedScenario, host: str) -> None:
    about = {"id": str(number), "name": _text(one.name), "package": PACKAGE, "hostname": _text(host) or "localhost"}
    began = one.began or datetime.fromtimestamp(0.0)
    about["timestamp"] = began.strftime("%Y-%m-%dT%H:%M:%S")
    suite = ElementTree.SubElement(root, "testsuite", about | _counts(one))
    properties = ElementTree.SubElement(suite, "properties")
    folder = () if one.folder is None else (("run_folder", str(one.folder)),)
    for name, value in (("scenario", one.name), *one.about, *folder):
        ElementTree.SubElement(properties, "property", {"name": _text(name), "value": _text(value)})
    if one.error or one.not_run:
        case = _case(suite, one, RUN_CASE, one.duration_s)
        if one.error:
            ElementTree.SubElement(case, "error", {"message": _text(one.error), "type": RUN_CASE})
        else:
            ElementTree.SubElement(case, "skipped", {"message": _text(one.not_run)})
    for index, verdict in enumerate(one.verdicts):
        case = _case(suite, one, verdict.name, 0.0 if index else one.duration_s)
        if not verdict.is_passed:
            message = _text(failure_text(verdict))
            failure = ElementTree.SubElement(case, "failure", {"message": message, "type": verdict.check})
            failure.text = message
    for output in ("system-out", "system-err"):
        ElementTree.SubElement(suite, output)


def _case(suite: ElementTree.Element, one: JudgedScenario, name: str, time_s: float) -> ElementTree.Element:
    """A case. Its class is package and scenario, without a point in the latter: servers split the class at the last."""
    about = {
        "classname": f"{PACKAGE}.{_text(one.name).replace('.', '_')}",
        "name": _text(name),
        "time": f"{time_s:.3f}",
    }
    return ElementTree.SubElement(suite, "testcase", about)


def _counts(one: JudgedScenario) -> dict[str, str]:
    return {
        "tests": str(len(one.verdicts) + bool(one.error or one.not_run)),
        "failures": str(sum(not verdict.is_passed for verdict in one.verdicts)),
        "errors": str(int(bool(one.error))),
        "skipped": str(int(bool(one.not_run) and not one.error)),
        "time": f"{one.duration_s:.3f}",
    }


def _text(text: str) -> str:
    """In one line, without what XML can't hold."""
    return NOT_IN_XML.sub("?", " ".join(text.split()))
