"""The table of a benchmark as texts, for the terminal, the report and the documentation."""

from __future__ import annotations

from collections.abc import Sequence

from hil.campaigns.standing import Course, Detection, Interval, Overall, Standing, Standings

DASH = "–"
ABOUT = (
    "Of each window the medians over the seeds of the IAE of outputs 1 / 2 in V s; runs that ended before are counted "
    "behind it, and are in no median. sigma(v): noise of the voltage at rest, of the noisier pump. Overshoot: the "
    "largest of all runs. Settled: within 20 mV to the window's end, the slower output and window of those with "
    "a step. Energy: integral of v1^2 + v2^2 over all windows. Delay: median, and median over the bound. "
    "Ratio: geometric mean over the windows of the median ratio of IAE, seed by seed, to the best of the window. Rank: "
    "mean over windows and seeds. Both with 95 % intervals by bootstrap over the seeds."
)


SUMMARY_HEADS = (
    "ratio to the best", "rank", "sigma(v) [mV]", "overshoot [mV]", "settled [s]", "energy [V²s]", "tripped", "stopped",
    "delay [s] (over bound)",
)  # fmt: skip


def heads(courses: Sequence[Course]) -> list[str]:
    """Heads of the table of a rig: who, the summary, and the IAE of each window."""
    return ["law · detector", *SUMMARY_HEADS, *(course.name for course in courses)]


def lines(standings: Standings, rig: str) -> list[list[str]]:
    """The table of a rig, the entrant with the best mean rank first."""
    entrants = sorted((one for one in standings.overall if one.entrant.rig == rig), key=lambda one: one.rank.value)
    return [_line(standings, one) for one in entrants]


def course_heads() -> list[str]:
    """Heads of the table of a window."""
    return [
        "law · detector", "ended", "IAE 1 / 2 [V s]", "ratio to the best", "rank", "at equal noise",
        "settled [s]", "overshoot [mV]", "worst [mV]", "largest error [mV]", "sigma(v) [mV]", "energy [V²s]",
    ]  # fmt: skip


def course_line(one: Standing) -> list[str]:
    """A line of the table of a window."""
    return [
        one.entrant.name,
        f"{one.ended} of {one.runs}{_causes(one)}",
        pair_text(one.iae_Vs),
        interval_text(one.ratio),
        interval_text(one.rank, 2),
        number(one.quiet_ratio, 3),
        " / ".join(map(_settled, one.settling_s, one.unsettled, (one.ended,) * 2)),
        pair_text(one.overshoot_V, 1e3, 2),
        number(one.worst_overshoot_V, 2, 1e3),
        pair_text(one.peak_V, 1e3),
        number(one.noise_V, 2, 1e3),
        number(one.energy_V2s, 4),
    ]


def detection_heads() -> list[str]:
    """Heads of the table of the detectors."""
    return ["law · detector", "scenario", "found", "right", "delay [s]", "bound [s]", "delay - bound [s]",
            "delay / bound", "false alarms"]  # fmt: skip


def detection_line(one: Detection) -> list[str]:
    """A line of the table of the detectors."""
    return [
        one.entrant.name,
        one.scenario,
        f"{one.found} of {one.faults}",
        f"{one.right} of {one.faults}",
        number(one.delay_s, 3),
        number(one.bound_s, 3),
        number(one.over_bound_s, 3),
        number(one.over_bound, 3),
        str(one.false_alarms),
    ]


def interval_text(one: Interval, digits: int = 3) -> str:
    """A value with its limits."""
    return f"{number(one.value, digits)} ({number(one.low, digits)} to {number(one.high, digits)})"


def pair_text(values: tuple[float | None, float | None], factor: float = 1.0, digits: int = 3) -> str:
    """Two values; one dash where neither is known."""
    if values == (None, None):
        return DASH
    return " / ".join(number(value, digits, factor) for value in values)


def number(value: float | None, digits: int, factor: float = 1.0) -> str:
    """A number with so many digits; a dash for none; "inf" where a run without a score decides."""
    if value is None:
        return DASH
    text = f"{factor * value:.{digits}g}"
    return f"{float(text):g}" if "e" in text and "inf" not in text and abs(float(text)) < 1e6 else text


def _line(standings: Standings, one: Overall) -> list[str]:
    own = [standing for standing in standings.of_courses if standing.entrant == one.entrant]
    overshoot_V = max((s.worst_overshoot_V for s in own if s.worst_overshoot_V is not None), default=None)
    energies = [s.energy_V2s for s in own]
    is_known = bool(energies) and None not in energies
    return [
        one.entrant.name,
        interval_text(one.ratio),
        interval_text(one.rank, 2),
        number(one.noise_V, 2, 1e3),
        number(overshoot_V, 2, 1e3),
        _slowest(own),
        f"{sum(energy or 0.0 for energy in energies):.0f}" if is_known else DASH,
        f"{one.tripped} of {one.runs}" if one.tripped else "0",
        f"{one.stopped + one.crashed} of {one.runs}" if one.stopped + one.crashed else "0",
        _delay([found for found in standings.detections if found.entrant == one.entrant]),
        *(_iae(standing) for standing in own),
    ]


def _iae(one: Standing) -> str:
    lost = one.runs - one.ended
    text = pair_text(one.iae_Vs)
    return f"{text} ({lost} of {one.runs} not ended)" if lost else text


def _causes(one: Standing) -> str:
    named = ", ".join(f"{cause} {count}" for cause, count in one.endings.items())
    return f" ({named})" if named else ""


def _settled(value: float | None, unsettled: int, of: int) -> str:
    if value is None:
        return f"never ({unsettled} of {of})" if of else DASH
    return number(value, 3) + (f" ({unsettled} of {of} never)" if unsettled else "")


def _slowest(own: Sequence[Standing]) -> str:
    """Of the windows with a step, the slowest median."""
    steps = [one for one in own if one.overshoot_V != (None, None) and one.ended]
    if not steps:
        return DASH
    values = [value for one in steps for value in one.settling_s]
    return "never" if None in values else number(max(value for value in values if value is not None), 3)


def _delay(found: Sequence[Detection]) -> str:
    """Each scenario's median delay with its ratio to the bound."""
    texts = [
        number(one.delay_s, 2) + ("" if one.over_bound is None else f" ({number(one.over_bound, 2)})")
        for one in found
        if one.delay_s is not None
    ]
    return ", ".join(texts) or DASH
