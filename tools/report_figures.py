"""Figures of a run's report as pictures: `python -m tools.report_figures FOLDER OUT`.

The pictures of the tutorial are made by

    hil simulate paper_glr --out runs/first --seed 7
    python -m tools.report_figures runs/first docs/images output-1 actuator-gains command-signals --prefix first-run-
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

_FIGURE = re.compile(r'<svg role="img" aria-label="([^"]+)".*?</svg>', re.DOTALL)


def figures_of(report: str) -> dict[str, str]:
    """Every figure of a report by name ("output-1"), as the text of an SVG file on a white ground."""
    figures = {}
    for match in _FIGURE.finditer(report):
        name = match[1].lower().replace(" ", "-")
        svg = match[0].replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
        if "xmlns:xlink" not in svg:
            svg = svg.replace("<svg ", '<svg xmlns:xlink="http://www.w3.org/1999/xlink" ', 1)
        lines = (
            line.rstrip()
            for line in svg.replace(
                "<defs>", '<rect width="100%" height="100%" fill="white"/>\n <defs>', 1
            ).splitlines()
        )
        figures[name] = "\n".join(lines) + "\n"
    return figures


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description="Save figures of a run's report as SVG files.")
    parser.add_argument("folder", type=Path, help="run folder with a report.html")
    parser.add_argument("out", type=Path, help="folder for the pictures")
    parser.add_argument("names", nargs="*", help="figures, for example output-1; none: all of them")
    parser.add_argument("--prefix", default="", help="put before each file's name")
    options = parser.parse_args()
    figures = figures_of((options.folder / "report.html").read_text(encoding="utf-8"))
    for name in options.names or figures:
        if name not in figures:
            print(f"the report has no figure {name}, only {', '.join(figures)}", file=sys.stderr)
            return 2
        (options.out / f"{options.prefix}{name}.svg").write_text(figures[name], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
