"""The cost of a control step and of a lockstep run against an earlier commit: `tools.benchmark.step_ratio REVISION`.

Both trees take their turns on the same machine, pass by pass, so that a busy machine slows both.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from statistics import median

from rich.console import Console

from tools.benchmark import ROOT
from tools.benchmark.tables import DOCUMENT, Section, as_rich, as_time, as_verdict, write
from tools.benchmark.timing import Effort

MAX_RATIO = 1.5
SCENARIOS = ("paper_glr.toml", "leak.toml")
CHILD = """
import sys, time
from pathlib import Path
from statistics import median
from hil.bench import assembly
from hil.core import controller
from hil.core.controller import ControllerState
from tools.benchmark.capture import Capture

scenario = Path("config/scenarios", sys.argv[1])
capture = Capture.of_a_run(scenario=scenario)
config = assembly.controller_config(assembly.load(scenario))
print(len(capture.inputs), flush=True)
for _ in sys.stdin:
    state, took_ns, started_ns = ControllerState(), [], time.process_time_ns()
    for number, inputs in enumerate(capture.inputs):
        step_ns = time.perf_counter_ns()
        state, _ = controller.step(config, state, inputs, number * capture.period_ns)
        took_ns.append(time.perf_counter_ns() - step_ns)
    cpu_ns = time.process_time_ns() - started_ns
    started_ns = time.process_time_ns()
    ticks = len(Capture.of_a_run(60.0, scenario).inputs)
    run_ns = time.process_time_ns() - started_ns
    print(median(took_ns) * 1e-3, cpu_ns / len(took_ns) * 1e-3, run_ns / ticks * 1e-3, flush=True)
"""
"""Runs in a tree: the inputs of a scenario's run are captured, then every line asks for a pass over them.

A pass prints the median time of a step, the mean processor time of a step, and the processor time of a lockstep run of
60 s over its ticks, with its start, in us.
"""
TICK = "lockstep tick, with emulator and wire"
WHAT = ("median step", "mean processor time", TICK)


@dataclass
class Tree:
    """A process that measures one tree."""

    process: subprocess.Popen[str]

    def measured_us(self) -> list[float]:
        """The times of one more pass, in the order of WHAT."""
        if self.process.stdin is None or self.process.stdout is None:
            raise ValueError("the process was started without pipes")
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return [float(value) for value in self.process.stdout.readline().split()]


def unpack(revision: str, folder: Path) -> str:
    """Put the files of a commit into a folder; its short hash and subject."""
    packed = subprocess.run(["git", "archive", revision], cwd=ROOT, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=BytesIO(packed)) as archive:
        archive.extractall(folder, filter="data")
    about = subprocess.run(
        ["git", "show", "-s", "--format=%h %s", revision], cwd=ROOT, check=True, capture_output=True, text=True
    )
    return about.stdout.strip()


def step_ratio(revision: str, passes: int) -> Section:
    """Time of a step in this tree over that in the revision's. Raises subprocess.CalledProcessError."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="hil-step-ratio-") as scratch:
        about = unpack(revision, Path(scratch))
        for scenario in SCENARIOS:
            with ExitStack() as stack:
                before, now = (_start(stack, Path(tree), scenario) for tree in (scratch, ROOT))
                before.measured_us(), now.measured_us()  # for warm-up
                pairs = [(before.measured_us(), now.measured_us()) for _ in range(passes)]
            for place, what in enumerate(WHAT):
                ratio = median(mine[place] / theirs[place] for theirs, mine in pairs)
                times = (as_time(median(one[place] for one in side)) for side in zip(*pairs, strict=True))
                verdict = "" if what == TICK else as_verdict(ratio <= MAX_RATIO)
                rows.append((scenario, what, *times, f"{ratio:.2f}", verdict))
    note = (
        f"All of `controller.step` on the inputs of a run, and a lockstep run of 60 s, this tree beside "
        f"{about.split(maxsplit=1)[0]} (`{about.split(maxsplit=1)[1]}`), {passes} passes in turns; "
        f"the ratio is the median of the passes' ratios. Target of a step: {MAX_RATIO}."
    )
    columns = ("scenario", "of a step", "before", "now", "ratio", "verdict")
    return Section("One control step, against an earlier commit", note, columns, rows)


def _start(stack: ExitStack, tree: Path, scenario: str) -> Tree:
    """Start the process of a tree, and wait until it has captured its inputs; it ends with the stack."""
    process = stack.enter_context(
        subprocess.Popen(
            [sys.executable, "-c", CHILD, scenario],
            cwd=tree,
            env={"PYTHONPATH": str(tree), "PATH": "", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
    )
    if process.stdout is None or not process.stdout.readline():
        raise subprocess.CalledProcessError(process.wait(), str(tree))
    return Tree(process)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser("python -m tools.benchmark.step_ratio", description=__doc__)
    parser.add_argument("revision", help="commit to compare with")
    parser.add_argument("--passes", type=int, default=15, help="number of passes over a run")
    parser.add_argument("--write", action="store_true", help="put the figures into docs/reference/benchmarks.md")
    options = parser.parse_args(arguments)
    section = step_ratio(options.revision, options.passes)
    console = Console(width=140)
    console.print(as_rich(section), section.note, "")
    if options.write:
        write([section], Effort(runs=options.passes, rounds=1), "step ratio")
        console.print(f"written to {DOCUMENT.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
