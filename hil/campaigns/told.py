"""What the alarms of a run said, report by report, and whether it was true of a drawn rig.

On a rig that the controller does not know, an alarm may say nothing but the truth: what a pump gives over its file, or
what its lag is. It is judged by each of its reports at the time of the report, not by the last one alone: a wrong size
that stands for a moment was shown to an operator and used by the control law.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from hil.campaigns.observer import Observations
from hil.core.types import NAMELESS, UNKNOWN, UNRESOLVED
from hil.review.alarms import Finding, Injected, finding_of, grouped

PUMP_GAIN, PUMP_LAG = "pump_effectiveness", "pump_lag"
SIZE_TOLERANCE, LAG_TOLERANCE = 0.1, 0.25
"""Share of the flow that the file says; share of the true lag."""

MIN_V = 1.0
"""What a pump gives at a lower voltage is its dead zone, not its gain: it is judged by what it gives here."""

LONG_UNKNOWN_S = 30.0
"""Something that nothing known explains and that stays for so long, or until the run stops, is counted apart."""

FlowShare = Callable[[int, float], float]
"""What a pump (1, 2) really gives at a voltage, over what the rig file says that it gives there."""


@dataclass(frozen=True, slots=True)
class Report:
    """One report of an alarm. t_s : when it was made.

    voltage_V, assumed : of a pump, the voltage then, and what the controller assumed from then on that it gives, as a
    share of its file's flow. true : the share or the lag that would have been right; None where nothing is known.
    is_recovery : it is the last one, and says with its size that the pump is as its file says, or without one nothing.
    """

    t_s: float
    kind: str
    target: Any
    size: float | None
    voltage_V: float | None = None
    assumed: float | None = None
    true: float | None = None
    is_recovery: bool = False

    @property
    def is_true(self) -> bool:
        """Whether it says what the pump is, within the tolerances; what names nothing says nothing wrong."""
        if self.kind in NAMELESS or (self.is_recovery and self.size is None):
            return True
        if self.true is None or self.size is None:
            return False
        if self.kind == PUMP_LAG:
            return abs(self.size - self.true) <= LAG_TOLERANCE * self.true
        said = [self.size] if self.assumed is None else [self.size, self.assumed]
        return all(abs(share - self.true) <= SIZE_TOLERANCE for share in said)


@dataclass(frozen=True, slots=True)
class Reported:
    """A finding, and all that was reported under its number."""

    finding: Finding
    reports: tuple[Report, ...]

    @property
    def is_honest(self) -> bool:
        """Whether it names something in the end, and every name and size on the way there was true."""
        return self.finding.kind not in NAMELESS and all(report.is_true for report in self.reports)

    @property
    def is_unknown(self) -> bool:
        """Whether it ended as something that nothing known explains, and said nothing wrong before."""
        return self.finding.kind == UNKNOWN and all(report.is_true for report in self.reports)

    @property
    def is_question(self) -> bool:
        """Whether it was withdrawn before it had a name."""
        return self.finding.kind == UNRESOLVED and self.finding.recovered_s is not None

    def as_json(self) -> dict[str, Any]:
        """The finding with its reports."""
        return {**asdict(self.finding), "reports": [asdict(report) for report in self.reports]}


def reported(
    drawn: Mapping[str, Any], seen: Observations, onset_s: float, flow_share: FlowShare | None
) -> tuple[Reported, ...]:
    """The alarms of a run; onset_s : of the first fault of the process, inf without one.

    On a drawn rig that the controller does not know an alarm may be open before the fault, and tell of the fault under
    its number. So what is reported from the onset on is a finding of its own there.
    """
    alarms = [(t_s, event.data) for t_s, event in seen.events if event.code == "alarm"]
    if not is_unlike_its_file(drawn):
        return _findings(drawn, seen, alarms, flow_share)
    after: list[tuple[float, dict[str, Any]]] = []
    for t_s, data in alarms:
        if t_s >= onset_s:
            known = {name: data.get(name) for name in ("detected_s", "isolated_s")}
            earlier = {name: t_s for name, at_s in known.items() if isinstance(at_s, float) and at_s < onset_s}
            after.append((t_s, {**data, **earlier}))
    before = [(t_s, data) for t_s, data in alarms if t_s < onset_s]
    return (*_findings(drawn, seen, before, flow_share), *_findings(drawn, seen, after, flow_share))


def is_unlike_its_file(drawn: Mapping[str, Any]) -> bool:
    """Whether a rig was drawn, and the controller was not told what."""
    return "flow_ratio" in drawn


def is_allowed(told: Reported, drawn: Mapping[str, Any], faults: Sequence[Injected]) -> bool:
    """Whether an alarm is no false one, because it says what a drawn rig is, or that nothing known explains it.

    What is said of a pump that has failed is judged as the name of a fault.
    """
    finding = told.finding
    is_faulty = any(
        fault.target == finding.target and finding.kind in fault.kinds and fault.at_s <= (finding.detected_s or 0.0)
        for fault in faults
    )
    return is_unlike_its_file(drawn) and not is_faulty and (told.is_honest or told.is_unknown)


def unknown_figures(alarms: Sequence[Reported], end_s: float, *, is_complete: bool) -> dict[str, Any]:
    """Columns about what nothing known explained. end_s : of the run. is_complete : whether it ran to its end.

    unknowns : how many. unknown_s : for how long the longest stood. unknown_long : those that stood for
    `LONG_UNKNOWN_S`, or until the run was stopped.
    """
    spans = [span for told in alarms for span in _unknown_spans_s(told, end_s)]
    is_long = [
        to_s - from_s >= LONG_UNKNOWN_S or (math.isclose(to_s, end_s) and not is_complete) for from_s, to_s in spans
    ]
    return {
        "unknowns": len(spans),
        "unknown_s": max((to_s - from_s for from_s, to_s in spans), default=0.0),
        "unknown_long": sum(is_long),
    }


def _unknown_spans_s(told: Reported, end_s: float) -> list[tuple[float, float]]:
    """From and until when it was unknown: to its next name, its end, or the end of the run."""
    spans: list[tuple[float, float]] = []
    ends = [report.t_s for report in told.reports[1:]]
    for report, to_s in zip(told.reports, [*ends, end_s], strict=True):
        if report.kind != UNKNOWN or report.is_recovery:
            continue
        if spans and spans[-1][1] == report.t_s:
            spans[-1] = (spans[-1][0], to_s)
        else:
            spans.append((report.t_s, to_s))
    return spans


def _findings(
    drawn: Mapping[str, Any], seen: Observations, alarms: Sequence[tuple[float, Any]], flow_share: FlowShare | None
) -> tuple[Reported, ...]:
    return tuple(
        Reported(finding_of(group), tuple(_report(drawn, seen, alarm, flow_share) for alarm in group))
        for group in grouped({**data, "reported_s": t_s} for t_s, data in alarms)
    )


def _report(
    drawn: Mapping[str, Any], seen: Observations, alarm: Mapping[str, Any], flow_share: FlowShare | None
) -> Report:
    t_s, kind, target, size = float(alarm["reported_s"]), str(alarm.get("kind")), alarm.get("target"), alarm.get("size")
    known = float(size) if isinstance(size, (int, float)) and math.isfinite(size) else None
    plain = Report(t_s, kind, target, known, is_recovery=bool(alarm.get("is_recovery")))
    if not is_unlike_its_file(drawn) or target not in (1, 2):
        return plain
    if kind == PUMP_LAG:
        return replace(plain, true=float(drawn["lag_s"][target - 1]))
    if kind != PUMP_GAIN or flow_share is None or not len(seen.steps):
        return plain
    step = min(int(np.searchsorted(seen.column("t_s"), t_s - 1e-6)), len(seen.steps) - 1)
    voltage_V, assumed = (float(seen.column(name)[step]) for name in (f"v{target}_V", f"e{target}"))
    return replace(plain, voltage_V=voltage_V, assumed=assumed, true=flow_share(target, max(voltage_V, MIN_V)))
