"""Figures of a report as pictures of the documentation."""

from __future__ import annotations

import xml.dom.minidom
from pathlib import Path

from tools.report_figures import figures_of

ROOT = Path(__file__).resolve().parents[2]
SVG = '<svg role="img" aria-label="Output 1" viewBox="0 0 4 2"><defs></defs><g/></svg>'


def test_a_figure_becomes_a_picture_of_its_own() -> None:
    figures = figures_of(f"<html><figure>{SVG}</figure></html>")
    assert list(figures) == ["output-1"]
    root = xml.dom.minidom.parseString(figures["output-1"]).documentElement  # noqa: S318 - our own text
    assert root is not None
    assert root.getAttribute("xmlns") == "http://www.w3.org/2000/svg"


def test_the_pictures_of_the_tutorial_are_there_and_well_formed() -> None:
    names = {picture.name for picture in (ROOT / "docs/images").glob("first-run-*.svg")}
    page = (ROOT / "docs/tutorial/first-run.md").read_text(encoding="utf-8")
    assert names
    for name in names:
        assert f"../images/{name}" in page
        xml.dom.minidom.parse(str(ROOT / "docs/images" / name))  # noqa: S318 - our own pictures
