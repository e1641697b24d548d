"""The tables of `hil demo`: the paper's table 3 beside ours, and the same fault with each fault detector."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from rich.table import Table

from hil.core.types import Pair
from hil.review import table3

FAULTS = ("both pumps", "pump 1")
NO_RECONFIGURATION, IDEAL_DETECTOR, GLR_DETECTOR = "no reconfiguration", "ideal detector", "GLR detector"


PAPER_TITLE = "The paper's table 3: IAE [V s]"
DETECTORS_TITLE = "Pump gain -60 % at 200 s: IAE [V s] until 350 s"
MIN_WIDE = 76
"""Columns of the wide tables."""


@dataclass(frozen=True)
class Figures:
    """Figures of a run.

    iae_Vs : window -> outputs 1, 2. detection_s, isolation_s : after the fault. off_by : error of the effectiveness
    reported, 1 s after the isolation. None where nothing was reported.
    """

    iae_Vs: Mapping[str, Pair]
    detection_s: float | None = None
    isolation_s: float | None = None
    off_by: float | None = None


def both(figures: Mapping[str, Figures], rigs: Sequence[int], width: int = MIN_WIDE) -> Iterator[Table | str]:
    """What to print: the tables with their legends.

    figures : by the names of the jobs of `demo_command`. width : of the terminal; below `MIN_WIDE` columns there is a
    table for each window and each fault, of at most 60 columns.
    """
    yield from _paper(figures, is_wide=width >= MIN_WIDE)
    yield (
        "ideal: the paper's gain on its ideal plant, control period 50 ms. rig: decoupled outputs, 0.1 s, on a rig "
        "with pump lag, noise, 12 bit, and parameters up to 3 % off. Both with the paper's ideal detector."
    )
    yield ""
    yield from _detectors(figures, rigs, is_wide=width >= MIN_WIDE)
    yield (
        f"ideal detector: is given the fault, exactly, 1 s late. GLR detector: finds it from the readings; median of "
        f"{len(rigs)} rigs. off by: error of the effectiveness 1 s after isolation. "
        "Every level and command went through CAN frames."
    )


def _paper(figures: Mapping[str, Figures], *, is_wide: bool) -> Iterator[Table | str]:
    """Table 3 of the paper, its reproduction, and the rig's design on a realistic rig."""
    numbers = ("output", "paper", "ideal", "off by", "rig")
    rows = {window.replace("_", " "): list(_paper_rows(figures, window)) for window in table3.TITLES}
    yield from _tables(PAPER_TITLE, "window", "gains", numbers, rows, is_wide=is_wide)


def _paper_rows(figures: Mapping[str, Figures], window: str) -> Iterator[list[str]]:
    strategies = {
        "kept": (NO_RECONFIGURATION, table3.PAPER_NO_RECONFIGURATION_VS),
        "reconfigured": (IDEAL_DETECTOR, table3.PAPER_RECONFIGURED_VS),
    }
    for strategy, (name, paper) in strategies.items():
        reproduced, rig = (figures[f"{where}, {name}"].iae_Vs[window] for where in ("ideal plant", "both pumps"))
        for output in (0, 1):
            theirs, ours = paper[window][output], reproduced[output]
            yield [
                strategy if output == 0 else "",
                str(output + 1),
                table3.cell(theirs),
                table3.cell(ours),
                table3.deviation(ours, theirs),
                table3.cell(rig[output]),
            ]


def _detectors(figures: Mapping[str, Figures], rigs: Sequence[int], *, is_wide: bool) -> Iterator[Table | str]:
    """The fall of the pumps' gain with each detector."""
    numbers = ("y1", "y2", "detected", "isolated", "off by")
    rows = {fault: list(_detector_rows(figures, rigs, fault)) for fault in FAULTS}
    yield from _tables(DETECTORS_TITLE, "fault", "diagnosis", numbers, rows, is_wide=is_wide)


def _detector_rows(figures: Mapping[str, Figures], rigs: Sequence[int], fault: str) -> Iterator[list[str]]:
    runs = {
        NO_RECONFIGURATION: figures[f"{fault}, {NO_RECONFIGURATION}"],
        IDEAL_DETECTOR: figures[f"{fault}, {IDEAL_DETECTOR}"],
        GLR_DETECTOR: _median([figures[f"{fault}, {GLR_DETECTOR}, rig {seed}"] for seed in rigs]),
    }
    for diagnosis, run in runs.items():
        y1, y2 = run.iae_Vs[table3.GAIN_FALL]
        yield [
            diagnosis,
            table3.cell(y1),
            table3.cell(y2),
            _cell(run.detection_s, "{:.1f} s"),
            _cell(run.isolation_s, "{:.1f} s"),
            _cell(run.off_by, "{:.3f}"),
        ]


def _tables(
    title: str, group: str, first: str, numbers: Sequence[str], rows: Mapping[str, list[list[str]]], *, is_wide: bool
) -> Iterator[Table | str]:
    """One table with a column for the group, or, on a narrow terminal, one without vertical lines for each group."""
    if is_wide:
        table = Table(title=title, title_justify="left")
        _add_columns(table, (group, first), numbers)
        for name, cells in rows.items():
            for index, row in enumerate(cells):
                table.add_row("" if index else name, *row, end_section=index == len(cells) - 1)
        yield table
        return
    yield from _narrow_tables(title, first, numbers, rows)


def _narrow_tables(
    title: str, first: str, numbers: Sequence[str], rows: Mapping[str, list[list[str]]]
) -> Iterator[Table | str]:
    for name, cells in rows.items():
        table = Table(title=f"{title}\n{name}", title_justify="left", box=None, padding=(0, 2, 0, 0), pad_edge=False)
        _add_columns(table, (first,), numbers)
        for row in cells:
            table.add_row(*row)
        yield table
        yield ""


def _add_columns(table: Table, texts: Sequence[str], numbers: Sequence[str]) -> None:
    for name in texts:
        table.add_column(name)
    for name in numbers:
        table.add_column(name, justify="right")


def _median(runs: Sequence[Figures]) -> Figures:
    """Figure by figure; what is missing in a run counts as worst."""
    first, second = (median(run.iae_Vs[table3.GAIN_FALL][output] for run in runs) for output in (0, 1))
    return Figures(
        {table3.GAIN_FALL: (first, second)},
        _middle([run.detection_s for run in runs]),
        _middle([run.isolation_s for run in runs]),
        _middle([run.off_by for run in runs]),
    )


def _middle(values: Sequence[float | None]) -> float | None:
    middle = median(float("inf") if value is None else value for value in values)
    return None if middle == float("inf") else middle


def _cell(value: float | None, form: str) -> str:
    return "–" if value is None else form.format(value)
