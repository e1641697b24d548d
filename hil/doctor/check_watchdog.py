"""The time of the pump node's watchdog, measured by sending no more commands after enabled commands of 0 V.

A status frame reports the node's state only every 50 ms. Therefore each trial begins at another phase of that period.
Over all trials the last status with "run" and the first with "tripped" give the time within 10 ms.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from hil.core.types import NodeState
from hil.probe.bus_probe import STATUS_WAIT_S, InterruptedByUserError, Probe
from hil.probe.check_result import Result, failed, not_checked, passed, warned
from hil.probe.observation import STATUS, Arrival

WATCHDOG_S = 0.25
TOLERANCE_S = 0.02
PHASES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Phases of the trials, as shares of the status frame's period."""
SPARE_TRIALS = 5
IRREGULAR = 0.3
"""A trial is repeated if the time between its status frames deviates by this share of their period."""
SLOW_SEND_S = 0.005
TRIPPED_BY_WATCHDOG = 1


@dataclass(frozen=True, slots=True)
class WatchdogTiming:
    """Result of the trials, in s after the last command.

    runs_until_s, tripped_by_s : bounds of the time, -inf and inf while unknown. problem : what is wrong with the node,
    "" for nothing. is_measured : whether all phases were measured.
    """

    runs_until_s: float = float("-inf")
    tripped_by_s: float = float("inf")
    problem: str = ""
    is_measured: bool = False


def measure(probe: Probe) -> WatchdogTiming:
    """Let the watchdog trip once for each phase, and clear the trip each time. The node must be ready, at 0 V."""
    timing, spare = WatchdogTiming(), SPARE_TRIALS
    phases = list(PHASES)
    try:
        while phases:
            low_s, high_s, problem, is_regular = _trial(probe, phases[0])
            if not is_regular and spare:
                spare -= 1
                continue
            if problem:
                return WatchdogTiming(timing.runs_until_s, timing.tripped_by_s, problem)
            if not is_regular:
                return timing
            timing = WatchdogTiming(max(timing.runs_until_s, low_s), min(timing.tripped_by_s, high_s))
            del phases[0]
    except InterruptedByUserError:
        probe.command(clear=True)  # restore the state: ready, at 0 V
        raise
    return WatchdogTiming(timing.runs_until_s, timing.tripped_by_s, is_measured=True)


def _trial(probe: Probe, phase: float) -> tuple[float, float, str, bool]:
    """Bounds by one trial, what was wrong, and whether its status frames came regularly."""
    cycle_s, begin_ns = probe.contract.frames[STATUS].cycle_s, probe.now_ns
    for _ in range(3):
        if probe.await_status(STATUS_WAIT_S) is None:
            return 0.0, 0.0, "no PumpStatus", False
        probe.listen(phase * cycle_s)
        sent_ns = probe.command(enable=True)
        is_slow = (probe.now_ns - sent_ns) * 1e-9 > SLOW_SEND_S
    seen = probe.listen(WATCHDOG_S + TOLERANCE_S + 3 * cycle_s).of(STATUS)
    times_s = [(status.t_ns - sent_ns) * 1e-9 for status in seen]
    is_regular = not is_slow and _is_regular(probe.listener.observed(begin_ns, probe.now_ns).of(STATUS), cycle_s)
    uncleared = _clear(probe)
    problem = _problem(seen) or uncleared
    runs_s = [t_s for t_s, status in zip(times_s, seen, strict=True) if _state(status) is NodeState.RUN]
    trips_s = [t_s for t_s, status in zip(times_s, seen, strict=True) if _state(status) is NodeState.TRIPPED]
    return max(runs_s, default=0.0), min(trips_s, default=float("inf")), problem, is_regular


def _is_regular(statuses: list[Arrival], cycle_s: float) -> bool:
    """Whether they came with the DBC's period from the first command of the trial on."""
    gaps_s = [(b.t_ns - a.t_ns) * 1e-9 for a, b in pairwise(statuses)]
    return bool(gaps_s) and max(abs(gap_s - cycle_s) for gap_s in gaps_s) < IRREGULAR * cycle_s


def _problem(seen: list[Arrival]) -> str:
    states = [_state(status) for status in seen]
    if any(max(status.values["Applied1"], status.values["Applied2"]) > 0.0 for status in seen):
        return "it applied a voltage at commands of 0 V"
    if not states:
        return "no PumpStatus"
    if NodeState.RUN not in states and states[0] is not NodeState.TRIPPED:
        return f"in state {states[0].name.lower()} after enabled commands of 0 V, not run"
    if states[-1] is NodeState.RUN:
        return f"still in state run {WATCHDOG_S + TOLERANCE_S:g} s after the last command"
    if states[-1] is not NodeState.TRIPPED:
        return f"in state {states[-1].name.lower()} without commands, not tripped"
    if int(seen[-1].values["TripCause"]) != TRIPPED_BY_WATCHDOG:
        return f"tripped with cause {int(seen[-1].values['TripCause'])}, not 1 (watchdog)"
    return ""


def _clear(probe: Probe) -> str:
    probe.command(clear=True)
    status = probe.await_status(STATUS_WAIT_S, lambda arrival: _state(arrival) is NodeState.READY)
    return "" if status is not None else "the trip can't be cleared"


def _state(status: Arrival) -> NodeState:
    return NodeState(int(status.values["State"]))


def check_watchdog(timing: WatchdogTiming, check: str = "watchdog") -> Result:
    """Whether the node latches 250 ms after the last command."""
    if timing.problem:
        return failed(check, timing.problem, "never let this node drive pumps (docs/reference/firmware.md, watchdog)")
    low_s, high_s = timing.runs_until_s, timing.tripped_by_s
    if low_s == float("-inf"):
        return warned(
            check,
            "it trips, but status frames came too irregularly to measure the time",
            "check again on a computer without other load",
        )
    found = f"trips within {low_s * 1e3:.0f} to {high_s * 1e3:.0f} ms; must be {WATCHDOG_S * 1e3:g} ms"
    if low_s > WATCHDOG_S + TOLERANCE_S:
        return failed(check, found, "too late: pumps run on without a controller (docs/reference/firmware.md)")
    if high_s < WATCHDOG_S - TOLERANCE_S:
        return failed(check, found, "too early: it will trip in a run (docs/reference/firmware.md)")
    if not timing.is_measured:
        return warned(check, found, "status frames came too irregularly: check again on a computer without other load")
    return passed(check, found)


def unchecked(why: str) -> Result:
    """The time was not measured."""
    return not_checked("watchdog", why)
