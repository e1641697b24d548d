"""The notebooks of docs/examples: they run, their stored outputs and pages are those of today, and they are small."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import pytest

from tools.notebooks import EXAMPLES, executed, notebooks, page_of, printed

MAX_PICTURE_BYTES = 100_000
NAVIGATION = EXAMPLES.parents[1] / "mkdocs.yml"
NOTEBOOKS = [pytest.param(path, id=path.stem) for path in notebooks()]


def test_there_are_notebooks() -> None:
    names = {path.stem for path in notebooks()}
    assert {"reading_a_run", "paper_figures", "comparing_designs", "campaign_statistics"} <= names


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS)
def test_a_notebook_runs_and_prints_what_it_shows(path: Path) -> None:
    """`python -m tools.notebooks` executes them again and stores what they print."""
    assert printed(executed(path)) == printed(nbformat.read(path, as_version=4))


@pytest.mark.parametrize("path", NOTEBOOKS)
def test_the_page_of_a_notebook_is_up_to_date(path: Path) -> None:
    """`python -m tools.notebooks --pages` makes it."""
    page, pictures = page_of(nbformat.read(path, as_version=4), path.stem)
    assert path.with_suffix(".md").read_text(encoding="utf-8") == page
    assert {file.name: file.read_bytes() for file in EXAMPLES.glob(f"{path.stem}-*.png")} == pictures
    assert f"examples/{path.stem}.md" in NAVIGATION.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", NOTEBOOKS)
def test_a_notebook_is_small_and_whole(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    _, pictures = page_of(notebook, path.stem)
    assert pictures
    assert all(len(picture) < MAX_PICTURE_BYTES for picture in pictures.values())
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.execution_count, "outputs are stored"
            assert not [
                output for output in cell.outputs if output.output_type == "error" or output.get("name") == "stderr"
            ]


@pytest.mark.parametrize("path", NOTEBOOKS)
def test_a_notebook_uses_the_public_face_alone(path: Path) -> None:
    source = "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code")
    assert not re.search(r"\b(from|import) (hil\.|firmware_sim)|from hil import", source)


def test_a_page_has_text_code_outputs_and_pictures() -> None:
    table = "<div>\n<style scoped>td {}</style>\n<table>\n\n<tr></tr></table></div>"
    outputs = [
        nbformat.v4.new_output("stream", text="printed\n"),
        nbformat.v4.new_output("display_data", {"text/html": table, "text/plain": "plain"}),
        nbformat.v4.new_output("display_data", {"image/png": "AAAA", "text/plain": "<Figure size 1x1>"}),
    ]
    cells = [
        nbformat.v4.new_markdown_cell("# Title"),
        nbformat.v4.new_code_cell("# What it shows\nx = 1", outputs=outputs),
    ]
    notebook = nbformat.v4.new_notebook(cells=cells)
    page, pictures = page_of(notebook, "name")
    assert page.startswith("# Title\n\nThe notebook is [`docs/examples/name.ipynb`](name.ipynb)")
    assert "``` { .python }\n# What it shows\nx = 1\n```\n\n```text\nprinted\n```\n\n<table>\n<tr></tr></table>" in page
    assert "![What it shows](name-1.png)" in page
    assert pictures == {"name-1.png": b"\0\0\0"}
    assert printed(notebook) == ["printed\n", "plain"]
