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


def both(figures: Mapping[str, Figures], rigs: Sequence[int]) -> Iterator[Table | str]:
    """What to print: the tables with their legends. figures : by the names of the jobs of `demo_command`."""
    yield _paper(figures)
    yield "ideal: the paper's gain on its ideal plant, control period 50 ms."
    yield "rig: decoupled outputs, 0.1 s, on a rig with pump lag, noise, 12 bit, and"
    yield "parameters up to 3 % off. Both with the paper's ideal detector."
    yield ""
    yield _detectors(figures, rigs)
    yield "ideal detector: is given the fault, exactly, 1 s late. GLR detector: finds"
    yield f"it from the readings; median of {len(rigs)} rigs. off by: error of the effectiveness"
    yield "1 s after isolation. Every level and command went through CAN frames."


def _paper(figures: Mapping[str, Figures]) -> Table:
    """Table 3 of the paper, its reproduction, and the rig's design on a realistic rig."""
    table = Table(title="The paper's table 3: IAE [V s]", title_justify="left")
    for name in ("window", "gains"):
        table.add_column(name)
    for name in ("output", "paper", "ideal", "off by", "rig"):
        table.add_column(name, justify="right")
    strategies = {
        "kept": (NO_RECONFIGURATION, table3.PAPER_NO_RECONFIGURATION_VS),
        "reconfigured": (IDEAL_DETECTOR, table3.PAPER_RECONFIGURED_VS),
    }
    for window in table3.TITLES:
        for strategy, (name, paper) in strategies.items():
            reproduced, rig = (figures[f"{where}, {name}"].iae_Vs[window] for where in ("ideal plant", "both pumps"))
            for output in (0, 1):
                theirs, ours = paper[window][output], reproduced[output]
                table.add_row(
                    window.replace("_", " ") if (strategy, output) == ("kept", 0) else "",
                    strategy if output == 0 else "",
                    str(output + 1),
                    table3.cell(theirs),
                    table3.cell(ours),
                    table3.deviation(ours, theirs),
                    table3.cell(rig[output]),
                    end_section=(strategy, output) == ("reconfigured", 1),
                )
    return table


def _detectors(figures: Mapping[str, Figures], rigs: Sequence[int]) -> Table:
    """The fall of the pumps' gain with each detector."""
    table = Table(title="Pump gain -60 % at 200 s: IAE [V s] until 350 s", title_justify="left")
    for name in ("fault", "diagnosis"):
        table.add_column(name)
    for name in ("y1", "y2", "detected", "isolated", "off by"):
        table.add_column(name, justify="right")
    for fault in FAULTS:
        rows = {
            NO_RECONFIGURATION: figures[f"{fault}, {NO_RECONFIGURATION}"],
            IDEAL_DETECTOR: figures[f"{fault}, {IDEAL_DETECTOR}"],
            GLR_DETECTOR: _median([figures[f"{fault}, {GLR_DETECTOR}, rig {seed}"] for seed in rigs]),
        }
        for diagnosis, row in rows.items():
            y1, y2 = row.iae_Vs[table3.GAIN_FALL]
            table.add_row(
                fault if diagnosis == NO_RECONFIGURATION else "",
                diagnosis,
                table3.cell(y1),
                table3.cell(y2),
                _cell(row.detection_s, "{:.1f} s"),
                _cell(row.isolation_s, "{:.1f} s"),
                _cell(row.off_by, "{:.3f}"),
                end_section=diagnosis == GLR_DETECTOR,
            )
    return table


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
