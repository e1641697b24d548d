"""The page of `hil test --html`: verdicts of all scenarios, with links to the reports of their runs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from hil.review import page
from hil.review.judged_scenario import JudgedScenario, is_good, summary

COLOURS = {"passed": "complete", "FAILED": "failed", "ERROR": "failed", "not run": "interrupted"}
"""Result -> status whose colour it has."""

HEADS = ("limit", "result", "value", "allowed", "when")


def verdict_page(tested: Sequence[JudgedScenario], beside: Path) -> str:
    """The page's HTML. beside : folder that the page will stand in, from which the links go."""
    run = [one for one in tested if not one.not_run or one.error]
    idle = [one for one in tested if one not in run]
    limits = [verdict for one in run for verdict in one.verdicts]
    word = "passed" if is_good(tested) else "FAILED"
    began = min((one.began for one in run if one.began is not None), default=None)
    facts = [*([("began", f"{began:%Y-%m-%d %H:%M:%S}")] if began else [])]
    head = f"<h1>Test of scenarios{page.badge(COLOURS[word], word)}</h1>"
    body = f'<header>{head}<p class="soft">{page.escape(summary(tested))}</p>{page.facts(facts)}</header>\n'
    body += page.cards(
        [
            ("scenarios passed", f"{sum(one.is_passed for one in run)} of {len(run)}"),
            ("limits kept", f"{sum(verdict.is_passed for verdict in limits)} of {len(limits)}"),
            ("scenarios without a verdict", f"{sum(bool(one.error) for one in run)}"),
            ("not run", f"{len(idle)}"),
        ]
    )
    body += "".join(_scenario(one, beside) for one in run)
    body += page.section("Not run", page.bullets([f"{one.name}: {one.not_run}" for one in idle]))
    return page.document(f"Test of scenarios: {word}", body)


def _scenario(one: JudgedScenario, beside: Path) -> str:
    facts = [*one.about, ("took", f"{one.duration_s:.1f} s")]
    rows = [
        (verdict.name, "kept" if verdict.is_passed else "NOT KEPT", verdict.value, verdict.limit, verdict.when)
        for verdict in one.verdicts
    ]
    marks = ["soft" if verdict.is_passed else "ERROR" for verdict in one.verdicts]
    error = f'<p class="ERROR">{page.escape(one.error)}</p>\n' if one.error else ""
    table = page.table(HEADS, rows, classes=marks) if rows else ""
    head = f"<h2>{page.escape(one.name)}{page.badge(COLOURS[one.result], one.result)}</h2>"
    return f"<section>{head}\n{page.facts(facts)}{error}{table}{_links(one, beside)}</section>\n"


def _links(one: JudgedScenario, beside: Path) -> str:
    """To the report, where there is one, and the key figures."""
    if one.folder is None:
        return ""
    files = [(name, one.folder / file) for name, file in (("report", "report.html"), ("key figures", "kpi.json"))]
    links = [
        f'<a href="{page.escape(quote(os.path.relpath(path.absolute(), beside)))}">{name}</a>'
        for name, path in files
        if path.is_file()
    ]
    return f"<p>{', '.join(links)}</p>\n" if links else ""
