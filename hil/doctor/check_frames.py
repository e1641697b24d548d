"""Frames: their periods, losses and refusals; foreign traffic on the bus."""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise
from math import sqrt
from statistics import median

from hil.core.counted import counted
from hil.probe.check_result import Result, failed, passed, warned
from hil.probe.observation import COMMAND, Observation
from hil.wire.frame_check import Rejection
from hil.wire.rejections import frames_rejected, other_sender, wrong_length

PERIOD_WARN, PERIOD_FAIL = 0.05, 0.20
"""Allowed deviation of the mean period from the DBC's, as a share of it."""
JITTER_WARN = 0.25
"""Standard deviation of the time between frames, as a share of the period."""
LOSS_FAIL = 0.05
"""With this share of lost or refused frames, two commands in a row are lost ninety times an hour."""
MIN_FRAMES = 3
SECOND_NS = 1_000_000_000

WIRING = "check cable, termination (60 ohms between CAN_H and CAN_L), supply and bit rate"
COUNTERS = (Rejection.DUPLICATE, Rejection.OLD)


def check_frames(observation: Observation) -> list[Result]:
    """Period and integrity of every periodic frame of the nodes."""
    results = []
    for spec in observation.contract.frames.values():
        if spec.cycle_s > 0.0:
            results += [check_period(observation, spec.name), check_integrity(observation, spec.name)]
    return results


def check_period(observation: Observation, name: str, fail_above: float = PERIOD_FAIL) -> Result:
    """Mean and jitter of the time between consecutive frames, compared with the DBC's cycle time.

    The period is wrong if both mean and median are: frames delayed while the computer is busy change only the mean, and
    a node that alternately sends early and late changes only the median.
    """
    check, cycle_s = f"{name} period", observation.contract.frames[name].cycle_s
    arrivals = observation.of(name)
    gaps_s = [(b.t_ns - a.t_ns) * 1e-9 for a, b in pairwise(arrivals) if b.lost == 0]
    if len(arrivals) < MIN_FRAMES or not gaps_s:
        refused = observation.refused(name).total()
        found = f"{counted(len(arrivals), 'frame')} in {observation.duration_s:.1f} s" + (
            f", {refused} refused" if refused else ""
        )
        return failed(check, found, f"is the node switched on and connected to this bus? If so, {WIRING}")
    mean_s = sum(gaps_s) / len(gaps_s)
    jitter_s = sqrt(sum((gap_s - mean_s) ** 2 for gap_s in gaps_s) / len(gaps_s))
    off = min(abs(mean_s - cycle_s), abs(median(gaps_s) - cycle_s)) / cycle_s
    found = (
        f"{mean_s * 1e3:.2f} ms, jitter {jitter_s * 1e3:.2f} ms, longest {max(gaps_s) * 1e3:.1f} ms; "
        f"DBC {cycle_s * 1e3:g} ms"
    )
    if off > fail_above:
        return failed(check, found, "the node's firmware does not keep the DBC's cycle time")
    if off > PERIOD_WARN:
        return warned(check, found, "the node's clock or firmware deviates from the DBC's cycle time")
    if jitter_s > JITTER_WARN * cycle_s:
        return warned(check, found, "the bus, the node or the computer is busy; stop other programs and check again")
    return passed(check, found)


def check_integrity(observation: Observation, name: str) -> Result:
    """Shares of frames lost by the counter, and refused by CRC, counter, length or range."""
    check = f"{name} integrity"
    accepted, lost, refused = len(observation.of(name)), observation.lost(name), observation.refused(name)
    total = accepted + lost + refused.total()
    if total == 0:
        return failed(check, "no frame", f"is the node switched on and connected to this bus? If so, {WIRING}")
    spec, lengths = observation.contract.frames[name], observation.wrong_lengths(name)
    parts = [f"{lost} lost"] if lost else []
    for why, count in sorted(refused.items()):
        detail = f" ({wrong_length(spec.frame_id, lengths, spec.length)})" if why is Rejection.LENGTH else ""
        parts.append(f"{count} refused: {why}{detail}")
    share = (lost + refused.total()) / total
    found = (
        f"{counted(total, 'frame')}, none lost or refused"
        if not parts
        else f"of {counted(total, 'frame')} of {spec.frame_id:#05x} {', '.join(parts)} ({share:.1%})"
    )
    if not parts:
        return passed(check, found)
    advice = WIRING
    if lengths:
        advice = other_sender(spec.frame_id, lengths)
    elif share >= LOSS_FAIL and any(why in COUNTERS for why in refused):
        advice = "its counter must increase by one from frame to frame (docs/reference/wire.md)"
    return failed(check, found, advice) if share >= LOSS_FAIL else warned(check, found, advice)


def check_foreign_traffic(observation: Observation, errors_per_s_max: int) -> list[Result]:
    """Commands of other senders, and error frames."""
    commands = len(observation.of(COMMAND))
    errors_ns = [refusal.t_ns for refusal in observation.refusals if refusal.why is Rejection.ERROR_FRAME]
    results = []
    if commands:
        advice = "stop the other controller first; until then the doctor sends nothing"
        results.append(failed("commands of others", f"{commands} pump commands from another sender", advice))
    elif refused := observation.refused(COMMAND):
        spec = observation.contract.frames[COMMAND]
        found = frames_rejected(spec.frame_id, refused, observation.wrong_lengths(COMMAND), spec.length)
        results.append(warned("commands of others", found, "find the node that sends them, and stop it"))
    else:
        results.append(passed("commands of others", "none"))
    most = max((bisect_right(errors_ns, t_ns + SECOND_NS) - at for at, t_ns in enumerate(errors_ns)), default=0)
    found = f"{len(errors_ns)} in {observation.duration_s:.1f} s, at most {most} within a second"
    if most >= errors_per_s_max:
        results.append(failed("error frames", found, f"a run would trip; {WIRING}"))
    elif errors_ns:
        results.append(warned("error frames", found, WIRING))
    else:
        results.append(passed("error frames", "none"))
    return results
