"""A log of frames read and decoded with numpy, beside python-can and cantools, frame by frame.

python -m tools.benchmark.log_decode [--write]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import can
import cantools
from rich.console import Console

import hil
from hil.bench import assembly
from hil.data.can_log import read_can_log
from hil.data.decode import decode
from tools.benchmark import SCENARIO
from tools.benchmark.tables import Section, as_rich, as_verdict, write
from tools.benchmark.timing import Effort, in_turns

RUN_S = 500.0
TARGET = 50.0
ROUNDS = 9


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser("python -m tools.benchmark.log_decode", description=__doc__)
    parser.add_argument("--write", action="store_true", help="put the figures into the page of the benchmarks")
    options = parser.parse_args(arguments)
    section = log_decode()
    console = Console(width=max(Console().width, 120))
    console.print(as_rich(section), section.note)
    if options.write:
        write([section], Effort(runs=1, rounds=ROUNDS), "log decode")
    return 0


def log_decode() -> Section:
    """Time per frame of the can.log of a run."""
    database: Any = cantools.database.load_file(assembly.load(SCENARIO).dbc_path)
    with tempfile.TemporaryDirectory() as folder:
        hil.simulate(str(SCENARIO), out=Path(folder) / "run", duration_s=RUN_S, rerun=False)
        path = Path(folder) / "run" / "can.log"
        log, messages = read_can_log(path), _messages(path)

        def decode_by_cantools() -> None:
            for message in messages:
                database.decode_message(message.arbitration_id, message.data, decode_choices=False)

        calls: dict[str, tuple[Callable[[], Any], int]] = {
            "read": (lambda: read_can_log(path), 3),
            "python-can, read": (lambda: _messages(path), 1),
            "decode": (lambda: decode(log, database), 10),
            "cantools, decode": (decode_by_cantools, 1),
        }
        times = in_turns(calls, ROUNDS)
    times["read and decode"] = [a + b for a, b in zip(times["read"], times["decode"], strict=True)]
    theirs = zip(times["python-can, read"], times["cantools, decode"], strict=True)
    times["python-can and cantools"] = [a + b for a, b in theirs]
    peers = {"decode": "cantools, decode", "read": "python-can, read", "read and decode": "python-can and cantools"}
    rows = []
    for name, peer in peers.items():
        ratio = median(a / b for a, b in zip(times[peer], times[name], strict=True))
        target, verdict = (f"≥ {TARGET:g}", as_verdict(ratio >= TARGET)) if name == "decode" else ("", "")
        each = [f"{median(times[which]) / len(log) * 1e3:.0f} ns" for which in (name, peer)]
        rows.append((name, *each, f"{ratio:.0f}", target, verdict))
    note = (
        f"Per frame, of the {len(log)} frames of {RUN_S:g} s of a run; all signals of all frames. Peers: python-can's "
        "reader of candump logs, and cantools' decode of one frame after the other. Ratio: their time over ours."
    )
    return Section("Decoding a log", note, ("what", "hil.data", "frame by frame", "ratio", "target", "verdict"), rows)


def _messages(path: Path) -> list[can.Message]:
    with can.CanutilsLogReader(path) as reader:
        return list(reader)


if __name__ == "__main__":
    sys.exit(main())
