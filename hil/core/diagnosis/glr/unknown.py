"""What no hypothesis explains: how it is noticed, what the filter does meanwhile, and when it is over.

The hypothesis with the greatest evidence is only the best of those that there are. So its own residuals are looked at:
the squared whitened innovations of its replay since the onset have a mean of 1 if it is true and the noise is known.
The mean, over that of the filter before the onset, is the *dispersion*. Where it is certainly above 1, the
log-likelihood ratios are too large by as much, and a name needs a margin so many times as large (as in
quasi-likelihood; McCullagh and Nelder 1989). Where it is far above 1, and after some time still is, nothing explains
the readings. The same holds when a third name follows two others within a few seconds.

Then no name is given, and those of the last seconds are withdrawn. The filter goes on with the parameters from before,
and takes its levels from the readings, with so large a walk that nothing can be found or learned. Beside it, trial
filters without that freedom start again and again; when one of them explains the readings, it becomes the filter.
Why: `docs/decisions/0035-unknown.md`.
"""

from __future__ import annotations

from math import isfinite, nan, sqrt

import numpy as np

from hil.core.diagnosis.glr import declaration, kernels, stuck_check
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, READING, WALK, StepResult, whitened
from hil.core.diagnosis.glr.growth import NO_GROWTH
from hil.core.diagnosis.glr.hypotheses import JUMPS, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Checkpoint, Suspicion, Told, Unknown
from hil.core.diagnosis.glr.model import BIAS, LEVEL, PUMP, Array, N
from hil.core.diagnosis.glr.noise_learning import RATIO
from hil.core.diagnosis.glr.refilter import RING
from hil.core.types import UNKNOWN, Alarm, Quad

BAD_RATIO, BAD_STDS = 2.5, 4.0
"""The best hypothesis explains nothing if its dispersion is above the one, and its sum of squares so many standard
deviations above what is expected of it."""

SURE_STDS = 3.0
"""The dispersion that enlarges the margin is the measured one over what a true hypothesis exceeds by chance."""

WAIT_S = 2.0
"""An alarm stays open for so long before it is called unknown: its onset may be wrong at first."""

CONTRADICTION_S, MAX_NAMES = 10.0, 2
"""More than so many different names within this time contradict each other."""

FREE_WALK_CM_SQRT_S = 0.3
"""Random walk of the levels with which the filter follows its readings."""

TRIAL_WALKS = (1.0, RATIO**4, RATIO**8)
"""Walks of the trial filters, over that from before."""

TRIAL_S, TRIAL_RATIO, TRIAL_STDS = 10.0, 1.5, 4.0
"""A trial filter starts at the readings, and has explained them if its dispersion over this time is below the ratio and
no sensor's mean innovation differs from 0 by so many standard deviations. A steady misfit is no noise."""

AGAIN_S = 120.0
"""What is found so soon after something unknown is that again, and gets no name: at rest swapped plugs show nothing."""

COUNT_DOWN = 0.1
"""What is over is forgotten with this share of a second in a second."""

MAX_SQUARE = 30.0
UNKNOWN_LEVEL_CM = 5.0
CLOSE_EVIDENCE = 12.0
MAX_LOOKS = 3

_RESULT = StepResult.empty()


def dispersion(m: Memory, row: int) -> float:
    """By how much the log-likelihood ratios of a replay are certainly too large, at least 1."""
    squares, count = _squares(m, row, at_fit=False)
    if count == 0.0:
        return 1.0
    part = 2.0 / (9.0 * count)
    return float(max(squares / (count * (1.0 - part + SURE_STDS * sqrt(part)) ** 3), 1.0))


def fits_badly(m: Memory, row: int, *, at_fit: bool) -> bool:
    """Whether a replay does not explain the readings since its onset. at_fit : up to the step at which it last did."""
    squares, count = _squares(m, row, at_fit=at_fit)
    return count > 0.0 and squares > BAD_RATIO * count and _stds(squares, count) > BAD_STDS


def contradicts(m: Memory, winner: int) -> bool:
    """Whether a new name would follow too many others within a few seconds."""
    if stuck_check.has_found(m):
        return False  # nothing may take that back
    if m.t_s - m.unknown_until_s < AGAIN_S:
        return all(j not in m.declared for j in jumps_of(winner))
    jump = JUMPS[jumps_of(winner)[0]]
    kinds = {f"{kind} {jump.target}" for kind in (jump.rises, jump.falls)}
    others = {told.name for told in _recent(m)}
    return len(others) >= MAX_NAMES and others.isdisjoint(kinds)


def note(m: Memory, alarms: list[Alarm]) -> None:
    """Note the name that a verdict has just given; two faults at once have two alarms, but are one name."""
    if m.checkpoint is not None and not alarms[0].is_recovery:
        name = f"{alarms[0].kind} {alarms[0].target}"
        m.told = (*_recent(m), *(Told(m.t_s, name, alarm.number, m.checkpoint) for alarm in alarms))


def first_checkpoint(m: Memory) -> Checkpoint | None:
    """The filter from before the first name of the last seconds, which what is unknown now throws doubt on, or None."""
    return next((told.checkpoint for told in _recent(m)), None)


def walk(m: Memory) -> Array:
    """(4,) variance of the levels' walk that the filter uses, cm^2/s; a level without a sensor keeps its own."""
    if m.unknown is None:
        return m.noise.walk
    return np.where(m.usable, FREE_WALK_CM_SQRT_S**2, m.noise.walk)


def possible_V(config: DetectorConfig, m: Memory) -> Quad | None:  # noqa: N802 - a unit
    """(4,) the levels by the model alone while something is unknown, V."""
    if m.unknown is None:
        return None
    h1, h2, h3, h4 = (config.model.level_gain_V_cm * m.unknown.model_x[LEVEL : LEVEL + 4]).tolist()
    return h1, h2, h3, h4


def declare(
    config: DetectorConfig, m: Memory, suspicion: Suspicion, row: int, order: list[int], checkpoint: Checkpoint
) -> list[Alarm]:
    """Nothing explains the readings: withdraw the names since the checkpoint, let the filter follow the readings."""
    number = suspicion.number
    if suspicion.is_quiet:
        suspicion.detected_s = m.t_s
    if number is None:
        m.alarms += 1
        number = m.alarms
    near = [n for n in order if m.replays.evidence[n] >= m.replays.evidence[row] - CLOSE_EVIDENCE]
    names = declaration.unresolved(m, suspicion, near or [row])
    alarm = Alarm(
        detected_s=suspicion.detected_s,
        kind=UNKNOWN,
        target=0,
        size=nan,
        onset_s=m.time_of(int(m.replays.onset[row])),
        candidates=names.candidates,
        number=number,
        looks=_looks(m, row, names.candidates),
    )
    withdrawn = _withdraw(m, checkpoint)
    _follow_readings(config, m, alarm, checkpoint)
    return [*withdrawn, alarm]


def step(config: DetectorConfig, m: Memory) -> list[Alarm]:
    """One step of the model and of the trial filters; the alarm that says that it is over."""
    unknown = m.unknown
    if unknown is None and m.unknown_s <= 0.0:
        return []
    dt = float(m.entry[PERIOD])
    if unknown is None:
        m.unknown_s = max(m.unknown_s - COUNT_DOWN * dt, 0.0)
        return []
    m.unknown_s += dt
    _model_step(config, m, unknown, m.now)
    entry = m.entry.copy()
    for n, (x, P, levels_walk) in enumerate(unknown.trials):
        entry[WALK : WALK + 4] = dt * levels_walk
        kernels.filter_step(config.model, x, P, entry, _RESULT)
        _count_innovations(unknown, n, entry, _RESULT)
    if (m.now - unknown.tried) * dt < TRIAL_S:
        return []
    for n, (x, P, levels_walk) in enumerate(unknown.trials):
        count = unknown.count[n]
        is_white = np.all(unknown.sums[n] ** 2 <= TRIAL_STDS**2 * count)
        if is_white and 0.0 < unknown.squares[n].sum() < TRIAL_RATIO * count.sum():
            return [_end(m, unknown, x, P, levels_walk)]
    _start_trials(config, m, unknown)
    return []


def _recent(m: Memory) -> tuple[Told, ...]:
    return tuple(told for told in m.told if m.t_s - told.t_s <= CONTRADICTION_S)


def _squares(m: Memory, row: int, *, at_fit: bool) -> tuple[float, float]:
    """Sum of the squared innovations of a replay, over what they were before its onset, and their number."""
    own = (m.replays.squares_fit if at_fit else m.replays.squares)[row]
    before = max(m.calm_squares[int(m.replays.onset[row]) % RING], 1.0)
    return float(own[:4].sum()) / before, float(own[4])


def _stds(squares: float, count: float) -> float:
    """By how many standard deviations a sum of squares is above what is expected (Wilson and Hilferty 1931)."""
    part = 2.0 / (9.0 * count)
    return float(((squares / count) ** (1.0 / 3.0) - (1.0 - part)) / sqrt(part))


def _looks(m: Memory, row: int, names: tuple[str, ...]) -> str:
    """What it looks like, as a sentence."""
    own = m.replays.squares[row]
    each = own[:4] / max(float(own[4]) / 4.0, 1.0)
    where = [str(i + 1) for i in range(4) if each[i] > max(BAD_RATIO, 0.5 * float(each.max()))] or ["1 to 4"]
    like = " or ".join(names[:MAX_LOOKS]) or "no known fault"
    return (
        f"it looks most like {like}, but then the readings' variance is {float(each.mean()):.1f} times that of noise, "
        f"most of all at sensor{'s' if len(where) > 1 else ''} {', '.join(where)}"
    )


def _withdraw(m: Memory, checkpoint: Checkpoint) -> list[Alarm]:
    """Withdraw the names that were given since the checkpoint, and use the sensors again that were lost by them."""
    alarms = []
    numbers = {told.number for told in m.told if told.checkpoint.step >= checkpoint.step}
    for j in [j for j, fault in m.declared.items() if fault.number in numbers and fault.kind != stuck_check.STUCK_ON]:
        fault = m.declared.pop(j)
        alarms.append(_over(m, fault.kind, JUMPS[j].target, fault.number))
    for sensor in [i for i, lost in m.lost.items() if lost.number in numbers and lost.kind == "sensor_drift"]:
        alarms.append(_over(m, "sensor_drift", sensor + 1, m.lost.pop(sensor).number))
        m.usable[sensor] = True
    return list({alarm.number: alarm for alarm in alarms}.values())


def _over(m: Memory, kind: str, target: int, number: int) -> Alarm:
    return Alarm(
        detected_s=m.t_s,
        kind=kind,
        target=target,
        size=nan,
        onset_s=m.t_s,
        isolated_s=m.t_s,
        candidates=(f"{kind} {target}",),
        number=number,
        is_recovery=True,
    )


def _follow_readings(config: DetectorConfig, m: Memory, alarm: Alarm, checkpoint: Checkpoint) -> None:
    """The filter goes on with the parameters from before, and its levels are those of the readings."""
    unknown = Unknown(
        number=alarm.number,
        detected_s=alarm.detected_s,
        x=checkpoint.x.copy(),
        P=checkpoint.P.copy(),
        model_x=checkpoint.x.copy(),
        model_P=checkpoint.P.copy(),
        trials=[],
        sums=np.zeros((len(TRIAL_WALKS), 4)),
        squares=np.zeros((len(TRIAL_WALKS), 4)),
        count=np.zeros((len(TRIAL_WALKS), 4)),
        tried=m.now,
    )
    for passed in range(max(checkpoint.step, m.now - RING + 1) + 1, m.now + 1):
        _model_step(config, m, unknown, passed)
    unknown.x[PUMP : PUMP + 2] = unknown.model_x[PUMP : PUMP + 2]
    m.x[:], m.P[:] = _at_readings(config, m, unknown)
    m.growing, m.suspicion, m.rival, m.checkpoint, m.unproven = NO_GROWTH, None, None, None, None
    m.stuck_checks, m.told, m.verdicts_s, m.mean_square = {}, (), (), 1.0
    m.unknown = unknown
    m.restart_bank()
    _start_trials(config, m, unknown)


def _model_step(config: DetectorConfig, m: Memory, unknown: Unknown, at: int) -> None:
    """The model without readings, one step of the history."""
    entry = m.history.entries[at % RING].copy()
    entry[READING : READING + 4] = nan
    config.filter_beside(unknown.model_x, unknown.model_P, entry, NO_GROWTH)


def _start_trials(config: DetectorConfig, m: Memory, unknown: Unknown) -> None:
    """Let the trial filters begin at these readings, with the parameters from before."""
    unknown.x[PUMP : PUMP + 2] = unknown.model_x[PUMP : PUMP + 2]
    most = m.noise.candidate[-1]
    x, P = _at_readings(config, m, unknown)
    P = np.diag(
        np.concatenate([P.diagonal()[:4], np.zeros(N - 4)])
    )  # what is learned of the rig may not explain it away
    unknown.trials = [(x.copy(), P.copy(), np.minimum(share**2 * m.noise.walk, most)) for share in TRIAL_WALKS]
    unknown.sums[:] = unknown.squares[:] = unknown.count[:] = 0.0
    unknown.tried = m.now


def _at_readings(config: DetectorConfig, m: Memory, unknown: Unknown) -> tuple[Array, Array]:
    """State and covariance with the parameters from before, and levels that the next readings decide."""
    x, P = unknown.x.copy(), unknown.P.copy()
    for i in range(4):
        state, reading_V = LEVEL + i, float(m.entry[READING + i])
        P[state, :] = P[:, state] = 0.0
        P[state, state] = UNKNOWN_LEVEL_CM**2
        is_read = m.usable[i] and isfinite(reading_V)
        shown_cm = (reading_V - float(x[BIAS + i])) / config.model.level_gain_V_cm
        x[state] = max(shown_cm, 0.0) if is_read else unknown.model_x[state]
    return x, P


def _count_innovations(unknown: Unknown, n: int, entry: Array, result: StepResult) -> None:
    for i in range(4):
        if isfinite(entry[READING + i]):
            value = float(whitened(result.whitener, result.innovation, i))
            unknown.sums[n, i] += value
            unknown.squares[n, i] += min(value * value, MAX_SQUARE)
            unknown.count[n, i] += 1.0


def _end(m: Memory, unknown: Unknown, x: Array, P: Array, levels_walk: Array) -> Alarm:
    """A trial filter becomes the filter: the model explains the readings again."""
    m.x[:], m.P[:] = x, unknown.P
    m.P[:4, :] = m.P[:, :4] = 0.0
    m.P[:4, :4] = P[:4, :4]
    m.unknown, m.unknown_until_s = None, m.t_s
    m.noise.walk[:] = levels_walk
    m.noise.evidence[:] = 0.0
    m.mean_square = 1.0
    m.restart_bank()
    return _over(m, UNKNOWN, 0, unknown.number)
