"""Table 3 of the paper, and the same table of our own runs beside it.

Hajiani and Poshtan, IJICS 2(2), 2012, table 3: the integral of the absolute error in V s, without and with
reconfiguration of the gains after both pumps have lost 60 % of their gain.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.types import Pair
from hil.review.kpi import Kpi

GAIN_FALL, REFERENCE_STEP = "gain_fall", "reference_step"
TITLES = {GAIN_FALL: "Fall of the pumps' gain", REFERENCE_STEP: "Step of the reference"}

PAPER_NO_RECONFIGURATION_VS: dict[str, Pair] = {GAIN_FALL: (13.07, 9.231), REFERENCE_STEP: (9.348, 9.405)}
PAPER_RECONFIGURED_VS: dict[str, Pair] = {GAIN_FALL: (0.702, 0.501), REFERENCE_STEP: (6.189, 6.234)}

NO_RECONFIGURATION, RECONFIGURATION = "no reconfiguration", "reconfiguration"
"""Names of the strategies."""


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the table: window, strategy, and the IAE of outputs 1, 2 in V s.

    ours_Vs : of each run; None for a run with another strategy.
    """

    window: str
    strategy: str
    paper_Vs: Pair
    ours_Vs: tuple[Pair | None, ...]


def applies_to(kpi: Kpi) -> bool:
    """Whether the run was over the paper's two windows."""
    return set(kpi.iae_Vs) == set(TITLES)


def lines(*kpis: Kpi) -> tuple[Line, ...]:
    """The table's four lines, each with the figures of all runs. The runs are over the paper's windows."""
    strategies = (
        (False, NO_RECONFIGURATION, PAPER_NO_RECONFIGURATION_VS),
        (True, RECONFIGURATION, PAPER_RECONFIGURED_VS),
    )
    return tuple(
        Line(
            TITLES[window],
            name,
            paper[window],
            tuple(kpi.iae_Vs[window] if kpi.reconfigure is is_reconfigured else None for kpi in kpis),
        )
        for window in TITLES
        for is_reconfigured, name, paper in strategies
    )


def cell(value_Vs: float | None) -> str:
    """A number with the paper's four digits, a dash for none."""
    return "–" if value_Vs is None else f"{value_Vs:#.4g}" if abs(value_Vs) >= 1.0 else f"{value_Vs:.3f}"


def deviation(ours_Vs: float | None, paper_Vs: float) -> str:
    """How far a number is from the paper's, in per cent of it."""
    return "" if ours_Vs is None else f"{100.0 * (ours_Vs / paper_Vs - 1.0):+.2f} %".replace("-", "−")
