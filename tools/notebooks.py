"""Executes the notebooks of docs/examples and makes a page of each: `python -m tools.notebooks [--pages] [NAME...]`.

A notebook is executed in an empty folder, and its outputs are stored in it. The page of the same name, beside it,
has its text, code and outputs; its pictures are files beside it. --pages: only the pages, from the stored outputs.
"""

from __future__ import annotations

import argparse
import base64
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

EXAMPLES = Path(__file__).resolve().parents[1] / "docs" / "examples"
TIMEOUT_S = 300
PICTURE = "image/png"


def notebooks() -> list[Path]:
    """The notebooks, by name."""
    return sorted(EXAMPLES.glob("*.ipynb"))


def executed(path: Path) -> Any:
    """The notebook with the outputs of a run in an empty folder. Raises nbclient's error for a cell that fails."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(
            notebook, timeout=TIMEOUT_S, coalesce_streams=True, resources={"metadata": {"path": folder}}
        ).execute()
    for number, cell in enumerate(notebook.cells, start=1):
        cell.id, cell.metadata = f"cell-{number}", {}
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook.metadata = nbformat.from_dict({"kernelspec": kernel, "language_info": {"name": "python"}})
    return notebook


def write(path: Path, notebook: Any) -> None:
    """Store a notebook with its outputs."""
    path.write_text(nbformat.writes(notebook, indent=1) + "\n", encoding="utf-8")


def printed(notebook: Any) -> list[str]:
    """What the cells print and show as text: the same at each execution."""
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    texts = [output.get("text") or output.get("data", {}).get("text/plain", "") for output in outputs]
    return [text for text in texts if not text.startswith("<Figure")]


def page_of(notebook: Any, name: str) -> tuple[str, dict[str, bytes]]:
    """The page, and the pictures on it by file name."""
    parts, pictures = [], dict[str, bytes]()
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            continue
        parts.append(f"``` {{ .python }}\n{cell.source}\n```")
        for output in cell.outputs:
            data = output.get("data", {})
            if PICTURE in data:
                file = f"{name}-{len(pictures) + 1}.png"
                pictures[file] = base64.b64decode(data[PICTURE])
                parts.append(f"![{_caption(cell.source)}]({file})")
            elif "<table" in data.get("text/html", ""):
                parts.append(_table(data["text/html"]))
            elif text := output.get("text") or data.get("text/plain"):
                parts.append(f"```text\n{text.rstrip()}\n```")
    title, *rest = parts
    note = f"The notebook is [`docs/examples/{name}.ipynb`]({name}.ipynb); it makes the runs that it reads."
    return "\n\n".join([title, note, *rest]) + "\n", pictures


def write_page(path: Path) -> None:
    """Write the page of a notebook, and its pictures."""
    page, pictures = page_of(nbformat.read(path, as_version=4), path.stem)
    path.with_suffix(".md").write_text(page, encoding="utf-8")
    for old in EXAMPLES.glob(f"{path.stem}-*.png"):
        old.unlink()
    for name, content in pictures.items():
        (EXAMPLES / name).write_bytes(content)


def _caption(source: str) -> str:
    """What a picture shows: the comment on the first line of its cell."""
    first = source.splitlines()[0]
    return first.removeprefix("# ") if first.startswith("# ") else "Figure"


def _table(html: str) -> str:
    """A table without pandas' style sheet and without empty lines, which would end the HTML in Markdown."""
    table = re.sub(r"<style.*?</style>|</?div>", "", html, flags=re.DOTALL)
    return "\n".join(line for line in table.splitlines() if line.strip())


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description="Execute the notebooks of docs/examples and make their pages.")
    parser.add_argument("names", nargs="*", help="notebooks, without .ipynb; none: all")
    parser.add_argument("--pages", action="store_true", help="only the pages, from the stored outputs")
    options = parser.parse_args()
    for path in [EXAMPLES / f"{name}.ipynb" for name in options.names] or notebooks():
        if not options.pages:
            write(path, executed(path))
        write_page(path)
        print(path.name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
