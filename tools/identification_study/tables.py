"""The study's tables: errors and coverage of each parameter, and a summary in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from tools.identification_study.outcome import Outcome

GAINS = tuple(f"{group}{i}" for group, count in (("k", 2), ("gamma", 2), ("a", 4)) for i in range(1, count + 1))


def parameter_table(outcomes: Sequence[Outcome]) -> Table:
    """One row for each parameter that was free in any case."""
    table = Table(title=f"{len(outcomes)} rigs")
    for head in ("parameter", "rigs", "median error", "95 % error", "largest error", "covered", "RMS error / sd"):
        table.add_column(head, justify="left" if head == "parameter" else "right")
    for name in dict.fromkeys(name for one in outcomes for name in one.parameters):
        found = [one.parameters[name] for one in outcomes if name in one.parameters]
        errors = np.array([abs(one.value - one.true) for one in found])
        is_relative = all(abs(one.true) > 1e-9 for one in found)
        shown = 100.0 * errors / np.abs([one.true for one in found]) if is_relative else errors
        unit = "%" if is_relative else found[0].unit
        ratio = np.sqrt(np.mean([((one.value - one.true) / max(one.sd, 1e-12)) ** 2 for one in found]))
        numbers = (np.median(shown), np.quantile(shown, 0.95), np.max(shown))
        table.add_row(
            name,
            str(len(found)),
            *(f"{value:.3g} {unit}" for value in numbers),
            f"{sum(one.is_covered for one in found)} of {len(found)}",
            f"{ratio:.2f}",
        )
    return table


def summary(outcomes: Sequence[Outcome]) -> list[str]:
    """Structure, coverage and held-out error over all cases, in sentences."""
    told = [one for one in outcomes if not one.refusal]
    lines = [f"identified: {len(told)} of {len(outcomes)}"]
    lines += [f"{one.name}: refused: {one.refusal}" for one in outcomes if one.refusal]
    judged = [one for one in told if one.expected is not None]
    if judged:
        right = [one for one in judged if one.is_structure_right]
        lines.append(f"right structure: {len(right)} of {len(judged)}")
        lines += [f"{one.name}: {', '.join(one.structure)}" for one in judged if one not in right]
    if told:
        covered = [one.is_covered for outcome in told for one in outcome.parameters.values()]
        lines.append(f"intervals that cover: {100.0 * np.mean(covered):.1f} % of {len(covered)}")
        worst = max(told, key=Outcome.largest_share)
        lines.append(f"k, gamma, a: largest error {100.0 * worst.largest_share():.3g} % ({worst.name})")
        lines += [f"all within {100.0 * limit:g} %: {within(told, limit)}" for limit in (0.001, 0.005)]
        lines.append(f"largest held-out RMSE: {1000.0 * max(one.holdout_rmse_V for one in told):.2f} mV")
        lines.append(f"time for one: {np.median([one.duration_s for one in told]):.1f} s (median)")
    return lines


def within(outcomes: Sequence[Outcome], limit: float) -> str:
    """Of how many rigs all of k, gamma and a are identified and within this share of the truth."""
    right = [one for one in outcomes if set(GAINS) <= set(one.parameters) and one.largest_share() <= limit]
    return f"{len(right)} of {len(outcomes)} rigs"
