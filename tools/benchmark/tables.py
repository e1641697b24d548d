"""Tables of figures: on the screen, and in the document with the conditions of the measurement."""

from __future__ import annotations

import importlib.util
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from rich.table import Table

from tools.benchmark import ROOT
from tools.benchmark.timing import Effort, yardstick_ms

DOCUMENT = ROOT / "docs/reference/benchmarks.md"


@dataclass(frozen=True)
class Section:
    """One table with its note."""

    title: str
    note: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def as_time(us: float) -> str:
    """Three digits, in µs or ms."""
    scaled, unit = (us, "µs") if us < 1000.0 else (us / 1000.0, "ms")
    digits = 2 if scaled < 10.0 else 1 if scaled < 100.0 else 0
    return f"{scaled:.{digits}f} {unit}"


def as_share(part: float, total: float) -> str:
    """In percent, one decimal."""
    return f"{100.0 * part / total:.1f} %"


def as_verdict(is_met: bool) -> str:
    """Whether a target was met, in words."""
    return "met" if is_met else "not met"


def as_rich(section: Section) -> Table:
    """The table for the screen."""
    table = Table(title=section.title, title_justify="left")
    for column in section.columns:
        table.add_column(column)
    for row in section.rows:
        table.add_row(*row)
    return table


def write(sections: list[Section], effort: Effort, block: str = "figures") -> None:
    """Replace the text between the block's markers in the document; a missing block is added."""
    begin, end = f"<!-- {block}: begin -->", f"<!-- {block}: end -->"
    lines = [begin, "", _circumstances(effort)]
    for section in sections:
        lines += ["", f"## {section.title}", "", section.note, ""]
        lines += [f"| {' | '.join(section.columns)} |", f"|{'---|' * len(section.columns)}"]
        lines += [f"| {' | '.join(row)} |" for row in section.rows]
    text = DOCUMENT.read_text(encoding="utf-8")
    before, is_there, rest = text.partition(begin)
    _, _, after = rest.partition(end)
    gap = "" if is_there else "\n"
    figures = "\n".join(lines)
    DOCUMENT.write_text(f"{before}{gap}{figures}\n\n{end}{after or chr(10)}", encoding="utf-8")


def _circumstances(effort: Effort) -> str:
    packages = ("numpy", "numba", "scipy", "control", "slycot", "python-can", "cantools", "rerun-sdk")
    versions = ", ".join(f"{name} {version(name)}" for name in packages if importlib.util.find_spec(_module(name)))
    now = datetime.now(UTC)
    load = os.getloadavg()[0]
    machine = f"{os.cpu_count()} cores, {_cpu_model()}, {platform.system()} {platform.machine()}"
    return (
        f"{now:%Y-%m-%d}; {machine}, load average {load:.1f} at the end; an empty loop of a "
        f"million turns takes {yardstick_ms():.1f} ms; "
        f"Python {platform.python_version()}, {versions}; {effort.runs} runs, {effort.rounds} rounds."
    )


def _module(package: str) -> str:
    return {"python-can": "can", "rerun-sdk": "rerun"}.get(package, package)


def _cpu_model() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or "unknown processor"
    return next(
        (line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")), "unknown"
    )
