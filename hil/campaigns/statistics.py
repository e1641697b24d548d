"""Statistics of many outcomes: classes of faults, confusion, false alarms per hour, broken invariants."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaigns.cases import PAIRS
from hil.campaigns.growing import PROMPT_S
from hil.campaigns.row import INVARIANTS, Row
from hil.campaigns.told import LONG_UNKNOWN_S
from hil.core.counted import counted

CONFIDENCE = 0.95
NOTHING = "nothing"


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and 95th percentile of what is known of n values; None when no value is known."""

    n: int
    median: float | None
    p95: float | None


@dataclass(frozen=True, slots=True)
class FaultClass:
    """The runs of one class of faults: shares from 0 to 1, delays in s, bound_s: the median of their bounds.

    prompt : share of the growing faults that had their right name alone within `growing.PROMPT_S` of the time at which
    they began to matter; None for a class without any.
    """

    label: str
    runs: int
    detected: float
    right: float
    candidates_hold: float
    detection: Spread
    isolation: Spread
    bound_s: float | None
    size_error_1s: Spread
    size_error_5s: Spread
    flips: int
    iae_after_fault: tuple[Spread, Spread]
    held: float = 0.0
    prompt: float | None = None


@dataclass(frozen=True, slots=True)
class Rate:
    """Events over hours: per hour with exact Poisson limits. low_h, high_h : of the two-sided interval."""

    events: int
    hours: float
    per_h: float | None
    low_h: float | None
    high_h: float | None


def poisson_rate(events: int, hours: float, confidence: float = CONFIDENCE) -> Rate:
    """Rate of rare events with its exact confidence limits (Garwood 1936), two-sided."""
    if hours <= 0.0:
        return Rate(events, hours, None, None, None)
    from scipy.special import gammaincinv  # half the quantile of chi2 with twice as many degrees of freedom

    tail = 0.5 * (1.0 - confidence)
    low = float(gammaincinv(events, tail)) if events else 0.0
    high = float(gammaincinv(events + 1, 1.0 - tail))
    return Rate(events, hours, events / hours, low / hours, high / hours)


def false_alarms(rows: Sequence[Row]) -> Rate:
    """Alarms without a fault of the process, over the time without one."""
    return poisson_rate(sum(row.false_alarms for row in rows), sum(row.healthy_h for row in rows))


def questions_text(rows: Sequence[Row]) -> str:
    """How many of the false and spurious alarms were only open questions; "" if none was."""
    count, all_of_them = sum(row.questions for row in rows), sum(row.false_alarms + row.spurious_alarms for row in rows)
    if not count:
        return ""
    return f"Of {counted(all_of_them, 'false or spurious alarm')}, {count} were withdrawn before they had a name."


def unknown_text(rows: Sequence[Row]) -> str:
    """How often something stood that nothing known explains, and for how long; "" if it never did."""
    count, long = sum(row.unknowns for row in rows), sum(row.unknown_long for row in rows)
    if not count:
        return ""
    longest_s = max(row.unknown_s for row in rows)
    return (
        f"Unknown: {counted(count, 'time')}, the longest {longest_s:.0f} s; "
        f"{long} stood for {LONG_UNKNOWN_S:g} s or until the run stopped."
    )


def fault_classes(rows: Iterable[Row]) -> tuple[FaultClass, ...]:
    """Each class with a fault of the process, in the order of the rows."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        if row.detected is not None:
            groups.setdefault(row.label, []).append(row)
    return tuple(_fault_class(label, group) for label, group in groups.items())


def not_played(rows: Iterable[Row]) -> dict[str, int]:
    """For each class of faults the runs that ended before all their faults had begun; classes without any left out."""
    return dict(Counter(row.label for row in rows if row.not_played))


def confusion(rows: Iterable[Row]) -> dict[str, Counter[str]]:
    """What was declared, by class of faults; without pairs, which are too many kinds."""
    table: dict[str, Counter[str]] = {}
    for row in rows:
        is_not_judged = row.detected is None and row.not_played > 0
        if row.label != PAIRS and not row.crashed and not is_not_judged:
            table.setdefault(row.label, Counter())[row.declared or NOTHING] += 1
    return table


def trips(rows: Iterable[Row]) -> dict[str, int]:
    """How many runs tripped, by cause, the most frequent first."""
    return dict(Counter(row.trip_cause for row in rows if row.trip_cause).most_common())


def broken(rows: Sequence[Row]) -> dict[str, tuple[Row, ...]]:
    """The rows that broke each invariant; all invariants are there."""
    return {name: tuple(row for row in rows if getattr(row, name)) for name in INVARIANTS}


def spread(values: Iterable[float | None]) -> Spread:
    """Median and 95th percentile of the known ones."""
    known = np.array([value for value in values if value is not None])
    if not len(known):
        return Spread(0, None, None)
    return Spread(len(known), float(np.median(known)), float(np.quantile(known, 0.95)))


def _fault_class(label: str, rows: Sequence[Row]) -> FaultClass:
    prompt = [row.named_s is not None and row.named_s <= PROMPT_S for row in rows if row.grown_s is not None]
    return FaultClass(
        label=label,
        runs=len(rows),
        detected=_share(row.detected for row in rows),
        right=_share(row.right for row in rows),
        candidates_hold=_share(row.candidates_hold for row in rows),
        detection=spread(row.detection_s for row in rows),
        isolation=spread(row.isolation_s for row in rows),
        bound_s=spread(row.bound_s for row in rows).median,
        size_error_1s=spread(row.size_error_1s for row in rows),
        size_error_5s=spread(row.size_error_5s for row in rows),
        flips=sum(row.flips for row in rows),
        iae_after_fault=(
            spread(row.iae_after_fault_1_Vs for row in rows),
            spread(row.iae_after_fault_2_Vs for row in rows),
        ),
        held=_share(row.held or row.right for row in rows),
        prompt=_share(prompt) if prompt else None,
    )


def _share(flags: Iterable[bool | None]) -> float:
    known = [bool(flag) for flag in flags]
    return sum(known) / len(known)
