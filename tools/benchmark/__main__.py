"""The command line: `python -m tools.benchmark [--write] [--quick]`; `tools.benchmark.realtime` has its own."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from rich.console import Console

from tools.benchmark import ROOT
from tools.benchmark.assignment import eigenstructure_assignment, recomputation
from tools.benchmark.campaign import campaign_step
from tools.benchmark.diagnosis import diagnosis_step
from tools.benchmark.lockstep import lockstep_profile, lockstep_speed
from tools.benchmark.steps import codec
from tools.benchmark.tables import DOCUMENT, as_rich, write
from tools.benchmark.timing import Effort


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        "python -m tools.benchmark", description="Timings of the project, as ratios where there is a peer."
    )
    parser.add_argument("--write", action="store_true", help=f"put the figures into {DOCUMENT.relative_to(ROOT)}")
    parser.add_argument("--quick", action="store_true", help="few repetitions, for a quick check")
    options = parser.parse_args(arguments)
    effort = Effort(runs=2, rounds=7, steps=2_000) if options.quick else Effort()
    console = Console(width=max(Console().width, 120))
    sections = []
    parts = (campaign_step, diagnosis_step, eigenstructure_assignment, recomputation, codec)
    measures = (lockstep_speed, lockstep_profile, *parts)
    for measure in measures:
        for section in measure(effort):
            sections.append(section)
            console.print(as_rich(section), section.note, "")
    if options.write:
        write(sections, effort)
        console.print(f"written to {DOCUMENT.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
