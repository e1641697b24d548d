"""The table of alarms and trips in a run's report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hil.core.fault_kinds import FaultKind
from hil.core.types import NAMELESS
from hil.review import page
from hil.review.kpi import Kpi
from hil.review.ticks import Ticks

PUMP_LOSSES = (FaultKind.PUMP_EFFECTIVENESS, FaultKind.PUMP_DEAD)
NOTE = (
    "Size: as the detector reported it when it had isolated the fault, with its standard deviation. It estimates the "
    "effectiveness of a pump further; the last estimate is that at the end of the run, or before the pump recovered."
)


def alarm_table(runs: Sequence[tuple[str, Kpi, Ticks]]) -> str:
    """The alarms and trips of one run or more, as HTML. runs : name, key figures and steps of each."""
    rows = [[name, *row] for name, kpi, ticks in runs for row in _rows(kpi, ticks)]
    if not rows:
        return '<p class="soft">None.</p>'
    heads = ["run", "time [s]", "what", "size", "last estimate", "onset [s]", "isolated [s]", "candidates"]
    first = 0 if len(runs) > 1 else 1
    note = f'<p class="soft">{page.escape(NOTE)}</p>' if any(kpi.alarms for _, kpi, _ in runs) else ""
    return page.table(heads[first:], [row[first:] for row in rows], numeric=frozenset()) + note


def last_estimate(alarms: Sequence[Mapping[str, Any]], index: int, ticks: Ticks) -> float | None:
    """The effectiveness last estimated for the pump loss `alarms[index]`; None for other kinds, or when not recorded.

    The last is that before the pump recovered, before the next alarm on the same pump, or at the end of the run.
    """
    alarm = alarms[index]
    if alarm["kind"] not in PUMP_LOSSES or alarm["target"] not in (1, 2) or alarm["isolated_s"] is None:
        return None
    later = (one["detected_s"] for one in alarms[index + 1 :] if _is_on_the_same_pump(one, alarm))
    ends_s = [one_s for one_s in (alarm["recovered_s"], *later) if one_s is not None]
    times_s = ticks["t_s"]
    is_in_it = (times_s >= alarm["isolated_s"]) & (times_s < min(ends_s, default=math.inf))
    estimates = ticks.get(f"theta{alarm['target']}")[is_in_it]
    known = estimates[np.isfinite(estimates)]
    return float(known[-1]) if len(known) else None


def _is_on_the_same_pump(one: Mapping[str, Any], alarm: Mapping[str, Any]) -> bool:
    return one["kind"] in PUMP_LOSSES and one["target"] == alarm["target"]


def _rows(kpi: Kpi, ticks: Ticks) -> list[list[str]]:
    rows = [
        [
            page.number(alarm["detected_s"], 5),
            alarm["kind"] if alarm["kind"] in NAMELESS else f"{alarm['kind']} {alarm['target']}",
            _with_spread(alarm["size"], alarm["size_std"]),
            page.number(last_estimate(kpi.alarms, index, ticks), 3),
            page.number(alarm["onset_s"], 5),
            page.number(alarm["isolated_s"], 5),
            alarm.get("looks") or ", ".join(alarm["candidates"]),
        ]
        for index, alarm in enumerate(kpi.alarms)
    ]
    trips = [
        [page.number(trip["t_s"], 5), f"trip: {trip['cause']}", trip["text"], "", "", "", ""] for trip in kpi.trips
    ]
    return rows + trips


def _with_spread(size: Any, std: Any) -> str:
    shown = page.number(size, 3)
    return f"{shown} ± {page.number(std, 2)}" if isinstance(std, float) and std > 0.0 else shown
