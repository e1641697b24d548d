"""The alarms of a run, merged into one finding for each reported fault, and compared with the injected faults.

A detector reports a fault again, with the same number, when it knows more: the first report gives the time, the last
one gives kind and size. A recovery closes the finding; the same number afterwards is another fault. Every alarm without
a number (0) is a finding of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from hil.core.fault_course import FaultCourse
from hil.core.fault_kinds import FaultKind, fault_kind
from hil.core.types import NAMELESS, UNRESOLVED

TIME_TOLERANCE_S = 1e-6
ALSO_CALLED: Mapping[str, str] = {FaultKind.PUMP_DEAD: FaultKind.PUMP_EFFECTIVENESS}
"""Kinds that may be reported by a more general name."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault as the diagnosis reported it; None for what it never reported.

    kind, target, size, size_std, onset_s, candidates : as last reported; see `hil.core.types.Alarm`. detected_s : time
    of the first report. first_candidates : "kind target" of all candidates at that time. isolated_s : when kind and
    target were first known. flips : how often they changed after that. recovered_s : when its end was reported. looks :
    of something that no known fault explains, what it looks like.
    """

    number: int
    kind: str
    target: Any
    size: float | None
    size_std: float | None
    onset_s: float | None
    detected_s: float | None
    isolated_s: float | None
    candidates: tuple[str, ...]
    first_candidates: tuple[str, ...] = ()
    flips: int = 0
    recovered_s: float | None = None
    looks: str = ""


@dataclass(frozen=True, slots=True)
class Injected:
    """A fault that the emulator played; fields as in a scenario's [[fault]].

    value : its full size. until_s : inf for a permanent fault. ramp_s, period_s, duty : see `FaultCourse`.
    """

    kind: str
    target: Any
    value: float
    at_s: float
    until_s: float = math.inf
    ramp_s: float = 0.0
    period_s: float | None = None
    duty: float = 1.0

    @property
    def course(self) -> FaultCourse:
        """When it is there, and how it grows."""
        return FaultCourse(self.at_s, self.until_s, self.ramp_s, self.period_s, self.duty)

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds by which a diagnosis may report it."""
        is_drift = self.kind == FaultKind.SENSOR_BIAS and self.ramp_s > 0.0  # while it grows, it is one
        general = FaultKind.SENSOR_DRIFT if is_drift else ALSO_CALLED.get(self.kind)
        return tuple(filter(None, (self.kind, general)))

    @property
    def names(self) -> tuple[str, ...]:
        """As candidates are named."""
        return tuple(f"{kind} {self.target}" for kind in self.kinds)

    @property
    def is_of_the_process(self) -> bool:
        """Whether it acts on pumps, tanks or sensors."""
        kind = fault_kind(self.kind)
        return kind is not None and kind.is_of_the_process


@dataclass(frozen=True, slots=True)
class Judgement:
    """Findings compared with the injected faults.

    answers : for each of `faults` the finding that reports it, None for a missed fault. false : findings before the
    first fault. spurious : later findings that report no injected fault. repeated : later ones that report a growing
    or intermittent fault again, by its own name or unresolved with it among the candidates; they are neither spurious
    nor a wrong name.
    """

    faults: tuple[Injected, ...]
    answers: tuple[Finding | None, ...]
    false: tuple[Finding, ...]
    spurious: tuple[Finding, ...]
    repeated: tuple[Finding, ...] = ()

    @property
    def is_right(self) -> bool:
        """Whether every fault of the process is reported by its own name, and nothing else is reported."""
        asked = [
            (fault, answer) for fault, answer in zip(self.faults, self.answers, strict=True) if fault.is_of_the_process
        ]
        named = all(answer is not None and _names(answer, fault) for fault, answer in asked)
        return named and not self.false and not self.spurious

    @property
    def is_held(self) -> bool:
        """Whether no fault of the process has a wrong name: each has its own, or an open alarm has it as candidate.

        An open alarm is one that is unresolved and not withdrawn. Further unresolved alarms are no names.
        """
        asked = [
            (fault, answer) for fault, answer in zip(self.faults, self.answers, strict=True) if fault.is_of_the_process
        ]
        others = [finding for finding in self.spurious if finding.kind not in NAMELESS]
        held = all(answer is not None and (_names(answer, fault) or _holds(answer, fault)) for fault, answer in asked)
        return held and not self.false and not others


def merged(alarms: Iterable[Mapping[str, Any]]) -> tuple[Finding, ...]:
    """Alarms, each as the data of its event, as findings in the order in which they were first raised."""
    return tuple(finding_of(reports) for reports in grouped(alarms))


def grouped(alarms: Iterable[Mapping[str, Any]]) -> tuple[tuple[Mapping[str, Any], ...], ...]:
    """The reports of each fault in the order of time, its recovery last; faults in the order of their first report."""
    groups: list[list[Mapping[str, Any]]] = []
    open_at: dict[int, list[Mapping[str, Any]]] = {}
    for alarm in alarms:
        number = alarm.get("number") or 0
        group = open_at.get(number)
        if alarm.get("is_recovery"):
            if group is not None:
                group.append(alarm)
                del open_at[number]
            continue
        if group is None:
            group = []
            groups.append(group)
            if number:
                open_at[number] = group
        group.append(alarm)
    return tuple(tuple(group) for group in groups)


def finding_of(reports: Sequence[Mapping[str, Any]]) -> Finding:
    """One fault's reports, as `grouped` gives them, as its finding."""
    finding = _first(reports[0].get("number") or 0, reports[0])
    for alarm in reports[1:]:
        if alarm.get("is_recovery"):
            finding = replace(finding, recovered_s=_known(alarm.get("detected_s")))
        else:
            finding = _later(finding, alarm)
    return finding


def injected(faults: Iterable[Mapping[str, Any]]) -> tuple[Injected, ...]:
    """The faults of a scenario's settings, by time."""
    found = [
        Injected(
            str(fault["kind"]),
            fault.get("target") or 0,
            float(fault.get("value") or 0.0),
            float(fault["at_s"]),
            math.inf if fault.get("until_s") is None else float(fault["until_s"]),
            float(fault.get("ramp_s") or 0.0),
            None if fault.get("period_s") is None else float(fault["period_s"]),
            1.0 if fault.get("duty") is None else float(fault["duty"]),
        )
        for fault in faults
    ]
    return tuple(sorted(found, key=lambda fault: fault.at_s))


def judge(faults: Sequence[Injected], findings: Sequence[Finding]) -> Judgement:
    """Assign findings to faults: first those with the right name, then, in the order of time, those after the onset."""
    process = [index for index, fault in enumerate(faults) if fault.is_of_the_process]
    first_s = min((faults[index].at_s for index in process), default=math.inf)
    left = [finding for finding in findings if _time(finding) >= first_s - TIME_TOLERANCE_S]
    false = tuple(finding for finding in findings if finding not in left)
    answers: list[Finding | None] = [None] * len(faults)
    for says_so in (_names, _holds, _follows):
        for index in process:
            match = next((finding for finding in left if says_so(finding, faults[index])), None)
            if answers[index] is None and match is not None:
                answers[index] = match
                left.remove(match)
    changing = [faults[index] for index in process if faults[index].ramp_s > 0.0 or faults[index].period_s is not None]
    repeated = tuple(finding for finding in left if any(_repeats(finding, fault) for fault in changing))
    spurious = tuple(finding for finding in left if finding not in repeated)
    return Judgement(tuple(faults), tuple(answers), false, spurious, repeated)


def _first(number: int, alarm: Mapping[str, Any]) -> Finding:
    kind, target = str(alarm.get("kind")), alarm.get("target")
    candidates = tuple(alarm.get("candidates") or ())
    return Finding(
        number,
        kind,
        target,
        size=_known(alarm.get("size")),
        size_std=_known(alarm.get("size_std")),
        onset_s=_known(alarm.get("onset_s")),
        detected_s=_known(alarm.get("detected_s")),
        isolated_s=_isolated_s(alarm),
        candidates=candidates,
        first_candidates=candidates or (f"{kind} {target}",),
        looks=str(alarm.get("looks") or ""),
    )


def _later(before: Finding, alarm: Mapping[str, Any]) -> Finding:
    now = _first(before.number, alarm)
    is_flip = before.isolated_s is not None and (before.kind, before.target) != (now.kind, now.target)
    return replace(
        now,
        detected_s=before.detected_s,
        isolated_s=now.isolated_s if before.isolated_s is None else before.isolated_s,
        first_candidates=before.first_candidates,
        flips=before.flips + is_flip,
    )


def _isolated_s(alarm: Mapping[str, Any]) -> float | None:
    return None if alarm.get("kind") in NAMELESS else _known(alarm.get("isolated_s"))


def _names(finding: Finding, fault: Injected) -> bool:
    return finding.kind in fault.kinds and finding.target == fault.target and _follows(finding, fault)


def _holds(finding: Finding, fault: Injected) -> bool:
    """Whether the finding is an open alarm with the fault among its candidates."""
    is_open = finding.kind == UNRESOLVED and finding.recovered_s is None
    return is_open and any(name in finding.candidates for name in fault.names) and _follows(finding, fault)


def _repeats(finding: Finding, fault: Injected) -> bool:
    is_held = finding.kind == UNRESOLVED and any(name in finding.candidates for name in fault.names)
    return _names(finding, fault) or is_held


def _follows(finding: Finding, fault: Injected) -> bool:
    return _time(finding) >= fault.at_s - TIME_TOLERANCE_S


def _time(finding: Finding) -> float:
    return -math.inf if finding.detected_s is None else finding.detected_s


def _known(value: Any) -> float | None:
    """The value if it is a finite number, otherwise None."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) else None
