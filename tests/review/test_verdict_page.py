"""The page of verdicts."""

from dataclasses import replace
from pathlib import Path

from hil.review.verdict_page import verdict_page
from tests.review.test_junit import TESTED


def test_the_page_shows_value_limit_and_time_and_links_to_the_report(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "a b"
    folder.mkdir(parents=True)
    (folder / "report.html").touch()
    html = verdict_page([replace(TESTED[0], folder=folder), *TESTED[1:]], tmp_path)
    for text in ("13.5 cm", "at most 0.1 cm", "211.3 s", "NOT KEPT", "disk full", "hold: no [[accept]] table"):
        assert text in html
    assert 'href="runs/a%20b/report.html"' in html
    assert "kpi.json" not in html, "it is not there"
    assert "0 of 3" in html


def test_what_comes_in_is_escaped(tmp_path: Path) -> None:
    name = "<script>alert(1)</script>"
    html = verdict_page([replace(TESTED[0], name=name, error=name, about=((name, name),))], tmp_path)
    assert "<script" not in html
