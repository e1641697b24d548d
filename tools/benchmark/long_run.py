"""Size of a run of 24 h, and what it takes to read it: `python -m tools.benchmark.long_run FOLDER [--write]`.

A folder that is not there is made first by `hil simulate` of tools/benchmark/day.toml: minutes. Each reading happens in
a process of its own, whose peak memory counts. Times are also given as multiples of the time in which Python counts the
lines of ticks.csv.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from tools.benchmark.tables import DOCUMENT, Section, as_rich, as_verdict, write
from tools.benchmark.timing import Effort

SCENARIO = Path(__file__).with_name("day.toml")
MAX_FOLDER_BYTES, MAX_S, MAX_BYTES = 1.5e9, 10.0, 1e9
FILES = ("ticks.csv", "can.log", "sent.log", "run.rrd", "events.jsonl", "run.json", "kpi.json")

OPEN = "import hil; run = hil.open_run({folder!r}); "
COMMAND = "import sys; from hil.cli.app import main; sys.argv = ['hil', "
COUNTING = "lines of ticks.csv counted"
READINGS: Mapping[str, str] = {
    COUNTING: "print(sum(1 for line in open({folder!r} + '/ticks.csv', 'rb')))",
    "`open_run`, shown": OPEN + "print(run)",
    "`run.select`, four columns": OPEN + "print(run.select('h1_V', 'h2_V', 'v1_V', 'v2_V').mean())",
    "`run.ticks`, all columns": OPEN + "print(run.ticks.mean())",
    "`run.signals`, level frames of tanks 1 and 2": OPEN + "print(len(run.signals['LowerLevels']))",
    "`run.frames`, all frames": OPEN + "print(len(run.frames))",
    "key figures again": (
        "from pathlib import Path; from hil.edge.record.run_folder import RunFolder; from hil.review import kpi; "
        "print(kpi.compute(RunFolder(Path({folder!r}))).ticks)"
    ),
    "`hil report`": COMMAND + "'report', {folder!r}]; main()",
    "`hil compare` with a second run of 24 h": COMMAND + "'compare', {folder!r}, {again!r}, '--out', {out!r}]; main()",
}
TARGETED = ("`open_run`, shown", "`run.ticks`, all columns", "`hil report`", "`hil compare` with a second run of 24 h")


@dataclass(frozen=True)
class Reading:
    """What one reading took."""

    wall_s: float
    cpu_s: float
    peak_bytes: int


def measured(code: str) -> Reading:
    """Run Python code in a process of its own. Raises CalledProcessError when it fails."""
    started = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - started
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise subprocess.CalledProcessError(process.returncode, code)
    return Reading(wall_s, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024)


def sizes(folder: Path) -> Section:
    """The files of the run."""
    found = {name: (folder / name).stat().st_size for name in FILES if (folder / name).is_file()}
    total = sum(found.values())
    rows = [(f"`{name}`", _as_size(size), "", "") for name, size in found.items()]
    rows.append(
        ("all", f"{total / 1e6:.0f} MB", f"{MAX_FOLDER_BYTES / 1e6:.0f} MB", as_verdict(total < MAX_FOLDER_BYTES))
    )
    note = "24 h in lockstep, 10 Hz, 125 frames a second (tools/benchmark/day.toml)."
    return Section("A run of 24 h: its files", note, ("file", "size", "target", "verdict"), rows)


def _as_size(size: int) -> str:
    """In MB or kB."""
    return f"{size / 1e6:.1f} MB" if size > 1e5 else f"{size / 1e3:.1f} kB"


def readings(folder: Path, beside: Path, rounds: int) -> Section:
    """Time and memory of each reading; the median of so many rounds, in turns. beside : a folder for what is made."""
    again = shutil.copytree(folder, beside / "again", copy_function=os.link)
    places = {"folder": str(folder), "again": str(again), "out": str(beside / "compared")}
    codes = {name: code.format(**places) for name, code in READINGS.items()}
    found: dict[str, list[Reading]] = {name: [] for name in codes}
    for _ in range(rounds):
        for name, code in codes.items():
            found[name].append(measured(code))
        shutil.rmtree(beside / "compared")
    rows = []
    for name, list_of in found.items():
        middle = sorted(list_of, key=lambda one: one.wall_s)[len(list_of) // 2]
        ratios = sorted(one.cpu_s / base.cpu_s for one, base in zip(list_of, found[COUNTING], strict=True))
        peak_bytes = max(one.peak_bytes for one in list_of)
        is_met = middle.cpu_s < MAX_S and peak_bytes < MAX_BYTES
        figures = (f"{middle.wall_s:.1f} s", f"{middle.cpu_s:.1f} s", f"{ratios[len(ratios) // 2]:.1f}")
        verdict = as_verdict(is_met) if name in TARGETED else ""
        rows.append((name, *figures, f"{peak_bytes / 1e6:.0f} MB", verdict))
    note = (
        "Each in a process of its own, imports included. Ratio: of processor time, to that of counting the lines of "
        f"ticks.csv. Target: {MAX_S:.0f} s of processor time, since other programs lengthen the time, and "
        f"{MAX_BYTES / 1e6:.0f} MB."
    )
    columns = ("what", "time", "CPU time", "ratio", "peak memory", "verdict")
    return Section("A run of 24 h: what it takes to read it", note, columns, rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser("python -m tools.benchmark.long_run", description=__doc__)
    parser.add_argument("folder", type=Path, help="run folder; made if it is not there")
    parser.add_argument("--write", action="store_true", help="put the figures into docs/reference/benchmarks.md")
    parser.add_argument("--rounds", type=int, default=3, help="how often each reading is measured")
    options = parser.parse_args(arguments)
    if not options.folder.exists():
        command = [sys.executable, "-m", "hil", "simulate", str(SCENARIO), "--out", str(options.folder), "--no-report"]
        subprocess.run(command, check=True)
    with tempfile.TemporaryDirectory(dir=options.folder.parent) as beside:
        sections = [sizes(options.folder), readings(options.folder, Path(beside), options.rounds)]
    console = Console(width=140)
    for section in sections:
        console.print(as_rich(section), section.note, "")
    if options.write:
        write(sections, Effort(runs=1, rounds=options.rounds), "long run")
        console.print(f"written to {DOCUMENT.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
