"""`python -m tools.benchmark.realtime [--minutes M] [--only lateness|latency|live] [--write]`, privileged."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from rich.console import Console

from tools.benchmark import ROOT
from tools.benchmark.realtime import sections
from tools.benchmark.tables import DOCUMENT, as_rich, write
from tools.benchmark.timing import Effort


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser("python -m tools.benchmark.realtime", description="How well the loop keeps time.")
    parser.add_argument("--minutes", type=float, default=0.5, help="a period and a peer (default: 0.5; 10 is thorough)")
    parser.add_argument("--only", choices=("lateness", "latency", "live"), help="one of the tables")
    parser.add_argument("--write", action="store_true", help=f"put the figures into {DOCUMENT.relative_to(ROOT)}")
    options = parser.parse_args(arguments)
    if not 0.01 <= options.minutes <= 600.0:
        parser.error(f"--minutes {options.minutes:g} is outside 0.01..600")
    plan = sections.Plan(options.minutes)
    console = Console(width=max(Console().width, 150))
    found = []
    tables = {"lateness": sections.lateness, "latency": sections.latency, "live": sections.live}
    for name, measure in tables.items():
        if options.only in (None, name):
            for section in measure(plan):
                found.append(section)
                console.print(as_rich(section), section.note, "")
    if options.write:
        write(found, Effort(), block="realtime")
    return 0


if __name__ == "__main__":
    sys.exit(main())
