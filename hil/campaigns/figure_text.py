"""Figures of a campaign as words, for the terminal and the report."""

from __future__ import annotations

from collections.abc import Mapping

from hil.campaigns.statistics import Rate, Spread


def rate_text(rate: Rate) -> str:
    """A rate with its confidence limits as text."""
    if rate.per_h is None:
        return "no time without a fault"
    return (
        f"{rate.events} in {rate.hours:.4g} h, {rate.per_h:.3g} per hour (95 %: {rate.low_h:.3g} to {rate.high_h:.3g})"
    )


def spread_text(values: Spread, digits: int = 3) -> str:
    """Median / 95th percentile; a dash when nothing is known."""
    if values.median is None or values.p95 is None:
        return "–"
    return f"{values.median:.{digits}g} / {values.p95:.{digits}g}"


def share_text(share: float | None) -> str:
    """A share as per cent; a dash where it does not apply."""
    return "–" if share is None else f"{share:.1%}"


def not_played_text(classes: Mapping[str, int]) -> str:
    """Runs whose faults had not begun when they ended, by class of faults; "" when there is none."""
    if not classes:
        return ""
    listed = ", ".join(f"{label} ({runs})" for label, runs in classes.items())
    return f"Not judged, because the run ended before the fault began: {listed}"
