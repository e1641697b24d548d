"""Verdicts as a JUnit file, which continuous integration reads: a suite for each scenario, a case for each limit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from hil.review.acceptance import LimitVerdict

NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class JudgedScenario:
    """A scenario that was run. duration_s : of the computation. error : why it gave no figures; "" if it did."""

    name: str
    verdicts: tuple[LimitVerdict, ...]
    duration_s: float
    error: str = ""

    @property
    def is_passed(self) -> bool:
        """Whether it ran, and kept every limit."""
        return not self.error and all(verdict.is_passed for verdict in self.verdicts)


def write_junit(path: Path, tested: Sequence[JudgedScenario]) -> None:
    """Write the file. Raises OSError."""
    root = ElementTree.Element("testsuites", _counts(tested))
    for one in tested:
        suite = ElementTree.SubElement(root, "testsuite", {"name": _text(one.name), **_counts([one])})
        if one.error:
            case = _case(suite, one, "run", one.duration_s)
            ElementTree.SubElement(case, "error", {"message": _text(one.error), "type": "run"})
        for index, verdict in enumerate(one.verdicts):
            case = _case(suite, one, verdict.name, 0.0 if index else one.duration_s)
            if not verdict.is_passed:
                message = failure_text(verdict)
                ElementTree.SubElement(case, "failure", {"message": _text(message), "type": verdict.check})
    ElementTree.indent(root)
    path.write_bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def failure_text(verdict: LimitVerdict) -> str:
    """Value, limit and time of a limit that was not kept."""
    return f"{verdict.value}; limit: {verdict.limit}; when: {verdict.when}"


def _case(suite: ElementTree.Element, one: JudgedScenario, name: str, time_s: float) -> ElementTree.Element:
    about = {"classname": _text(one.name), "name": _text(name), "time": f"{time_s:.3f}"}
    return ElementTree.SubElement(suite, "testcase", about)


def _counts(tested: Sequence[JudgedScenario]) -> dict[str, str]:
    failures = sum(not verdict.is_passed for one in tested for verdict in one.verdicts)
    errors = sum(bool(one.error) for one in tested)
    return {
        "tests": str(sum(len(one.verdicts) for one in tested) + errors),
        "failures": str(failures),
        "errors": str(errors),
        "time": f"{sum(one.duration_s for one in tested):.3f}",
    }


def _text(text: str) -> str:
    """Without what XML can't hold."""
    return NOT_IN_XML.sub("?", text)
