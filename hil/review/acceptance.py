"""The verdicts on a run: limits of its scenario against its key figures."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hil.core.fault_kinds import fault_kind
from hil.edge.config.accept_table import AcceptTable
from hil.review.alarms import injected

MISSING = "not in kpi.json"
NOT_REACHED = "the run ended before the window did"
Figures = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class LimitVerdict:
    """One limit and what the run gave.

    value, limit : as text. at_s : when it was decided; None: by the whole `window`, or by the whole run where that is
    empty.
    """

    name: str
    check: str
    value: str
    limit: str
    at_s: float | None
    is_passed: bool
    window: str = ""

    @property
    def when(self) -> str:
        """When it was decided, as text."""
        return (self.window or "whole run") if self.at_s is None else f"{self.at_s:.1f} s"


def verdicts(
    accepts: Iterable[AcceptTable], figures: Figures, faults: Sequence[Mapping[str, Any]]
) -> tuple[LimitVerdict, ...]:
    """The verdict on each limit. figures : of `kpi.json`. faults : of the scenario, as its settings have them.

    A limit on a figure that the run does not have is not kept.
    """
    return tuple(_verdict(accept, figures, faults) for accept in accepts)


def figure_at(figures: Figures, path: str) -> Any:
    """The figure at a path such as `iae_Vs.gain_fall[0]`; None if there is none."""
    found: Any = figures
    for part in re.findall(r"\w+", path):
        if isinstance(found, Mapping):
            found = found.get(part)
        elif isinstance(found, Sequence) and not isinstance(found, str) and part.isdecimal():
            found = found[int(part)] if int(part) < len(found) else None
        else:
            return None
    return found


def _verdict(accept: AcceptTable, figures: Figures, faults: Sequence[Mapping[str, Any]]) -> LimitVerdict:
    value, limit, at_s, is_passed = _JUDGES[accept.check](accept, figures, faults)
    return LimitVerdict(accept.name, accept.check, value, limit, at_s, is_passed, accept.window or "")


_Judged = tuple[str, str, float | None, bool]


def _iae(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    del faults
    pair = figure_at(figures, "iae_Vs").get(accept.window) if figure_at(figures, "iae_Vs") else None
    return _at_most(None if pair is None else max(pair), accept.iae_V_s, "V s")


def _settling(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    """Of both outputs."""
    del faults
    pair = figures["settling_s"].get(accept.window)
    limit = f"at most {accept.settling_s:g} s"
    if pair is None:
        return NOT_REACHED, limit, None, False
    outside = [str(output) for output, value in enumerate(pair, 1) if value is None]
    if outside:
        return f"output {' and '.join(outside)}: not settled in the window", limit, None, False
    return _at_most(max(pair), accept.settling_s, "s")


def _overshoot(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    """Of the outputs whose reference changed in the window."""
    del faults
    limit = f"at most {accept.overshoot_cm:g} cm"
    pair = figures["overshoot_cm"].get(accept.window)
    if pair is None:
        return NOT_REACHED, limit, None, False
    known = [
        (value, at_s)
        for value, at_s in zip(pair, figures["overshoot_at_s"][accept.window], strict=True)
        if value is not None
    ]
    if not known:
        return "no reference changes in the window", limit, None, False
    value, at_s = max(known, key=lambda one: float(one[0]))
    text, _, _, is_kept = _at_most(value, accept.overshoot_cm, "cm")
    return text, limit, at_s, is_kept


def _detected(accept: AcceptTable, figures: Figures, faults: Sequence[Mapping[str, Any]]) -> _Judged:
    """Each injected fault of the process by an alarm of its own name, so soon after its onset."""
    limit = f"at most {accept.detected_within_s:g} s"
    late: list[tuple[float, str, float]] = []
    for fault in injected(faults):
        if not fault.is_of_the_process:
            continue
        times = [
            float(alarm["detected_s"])
            for alarm in figures["alarms"]
            if f"{alarm['kind']} {alarm['target']}" in fault.names and alarm["detected_s"] is not None
        ]
        after = [t for t in times if t >= fault.at_s]
        if not after:
            return f"{fault.names[0]}: not reported", limit, None, False
        late.append((min(after) - fault.at_s, fault.names[0], min(after)))
    if not late:
        return "the scenario has no fault of the process", limit, None, False
    delay_s, name, at_s = max(late)
    return f"{name}: {delay_s:.3g} s", limit, at_s, delay_s <= (accept.detected_within_s or 0.0)


def _named(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    del faults
    wanted = sorted(accept.named or ())
    found = sorted({_name_of(alarm) for alarm in figures["alarms"]})
    times = [alarm["detected_s"] for alarm in figures["alarms"] if _name_of(alarm) not in wanted]
    return ", ".join(found) or "nothing", ", ".join(wanted) or "nothing", min(times, default=None), found == wanted


def _name_of(alarm: Mapping[str, Any]) -> str:
    kind = fault_kind(str(alarm["kind"]))
    return str(alarm["kind"]) if kind is None or not alarm["target"] else f"{alarm['kind']} {alarm['target']}"


def _no_alarm(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    del accept, faults
    names = [_name_of(alarm) for alarm in figures["alarms"]]
    at_s = figures["alarms"][0]["detected_s"] if names else None
    return ", ".join(names) or "none", "no alarm", at_s, not names


def _no_trip(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    del accept, faults
    trips = figures["trips"]
    return ", ".join(str(one["cause"]) for one in trips) or "none", "no trip", _first_s(trips), not trips


def _trip(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    del faults
    trips = figures["trips"]
    cause = str(trips[0]["cause"]) if trips else "none"
    return cause, f"trip by {accept.trip}", _first_s(trips), cause == accept.trip


def _level(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    del faults
    known = {level: tank for tank, level in enumerate(figures["level_max_cm"]) if level is not None}
    highest = max(known, default=None)
    text, limit, _, is_kept = _at_most(highest, accept.level_max_cm, "cm")
    return text, limit, None if highest is None else figures["level_max_at_s"][known[highest]], is_kept


def _skipped(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    del faults
    return _at_most(figures["skipped"], accept.skipped_max, "steps")


def _lateness(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    del faults
    return _at_most(figure_at(figures, "lateness_s.p99"), accept.lateness_p99_s, "s")


def _figure(accept: AcceptTable, figures: Figures, faults: object) -> _Judged:
    del faults
    value = figure_at(figures, accept.figure or "")
    if accept.equals is not None:
        is_same = value == accept.equals and isinstance(value, bool) == isinstance(accept.equals, bool)
        return MISSING if value is None else str(value), f"is {accept.equals}", None, is_same
    limits = [f"at least {accept.min:g}"] if accept.min is not None else []
    limits += [f"at most {accept.max:g}"] if accept.max is not None else []
    limit = " and ".join(limits)
    if value is None:
        return MISSING, limit, None, False
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"{value} is no number", limit, None, False
    is_kept = (accept.min is None or value >= accept.min) and (accept.max is None or value <= accept.max)
    return f"{value:.6g}", limit, None, is_kept


def _at_most(value: float | None, limit: float | None, unit: str) -> _Judged:
    text = f"at most {limit:g} {unit}"
    if value is None or limit is None:
        return MISSING, text, None, False
    return f"{value:.4g} {unit}", text, None, value <= limit


def _first_s(trips: Sequence[Mapping[str, Any]]) -> float | None:
    return float(trips[0]["t_s"]) if trips else None


_JUDGES: Mapping[str, Callable[[AcceptTable, Figures, Sequence[Mapping[str, Any]]], _Judged]] = {
    "iae_V_s": _iae,
    "settling_s": _settling,
    "overshoot_cm": _overshoot,
    "detected_within_s": _detected,
    "named": _named,
    "no_alarm": _no_alarm,
    "no_trip": _no_trip,
    "trip": _trip,
    "level_max_cm": _level,
    "skipped_max": _skipped,
    "lateness_p99_s": _lateness,
    "figure": _figure,
}
