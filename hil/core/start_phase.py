"""Start phase: the lower levels are brought to the first reference before time 0 of the run.

A run that begins with tanks far below its first reference, as every run on a real rig does, first has the reference
move from the levels found to the first reference: linearly, both outputs together, at most at `rate_cm_s`, and then
stay there for `settle_s`. The gains are those of the first reference from the beginning, only target and operating
point of the law move. So nothing changes at the end, neither gains nor integrals. The length of the phase is known when
it begins, so that run time counts up to 0 in it without a jump. If the levels are not at the reference then, the run
ends in an orderly way.
Why: docs/decisions/0026-start-phase.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import ceil, inf, sqrt

import numpy as np

from hil.core.inflow_watch import LEARN_S
from hil.core.tanks import TankModel, equilibrium, linearise, through_flow_matrix, transmission_zeros
from hil.core.types import NAMELESS, Alarm, Event, Pair, Quad, Severity

Doubts = tuple[tuple[int, tuple[str, ...], float], ...]
"""Alarms that are not resolved, and named leaks of a lower tank: number, candidates, run time since when."""

DOUBT_S = 15.0
"""An open alarm that may hide a level is waited for so long; the end of the phase does not wait."""

DOUBTED_UNTIL_S = LEARN_S
"""Such alarms still end the run so long after time 0: until then nothing has learned what holds the tanks at rest."""

FAR_BELOW = 0.5
"""A lower level below this share of its first reference is far below it. A rig whose outlets and pumps are 10 % off its
file has levels between 0.55 and 1.6 times the file's at the file's voltages."""

LEVEL_MARGIN_CM = 2.0
"""In the phase no level may come closer to `level_max_cm` than this, by the model."""

DRIVE_SHARE = 0.9
"""Nor a pump's drive above this share of its largest."""

ZERO_RAMP, ZERO_SETTLE = 3.0, 2.0
"""With an unstable zero z the ramp lasts ZERO_RAMP/z at least, and the outputs have ZERO_SETTLE/z to settle: before the
upper tanks have filled the levels can't be where a faster ramp wants them, and they rise too high afterwards."""

MAX_ZERO_S = 1000.0
"""Largest 1/z that counts."""

MAX_HALVINGS = 6
"""The rate is halved so often at the most to meet these limits."""

LEAKS = frozenset({"leak 1", "leak 2"})
HIDES_LEVEL = LEAKS | {"sensor_drift 1", "sensor_drift 2"}
"""Explanations with which a lower tank is fuller than its sensor shows, or may be."""

AT_LIMIT_V = 0.1
PERIOD_TOLERANCE = 1e-9


class When(StrEnum):
    """When a run begins with a start phase: if a lower level is far below its first reference, or always, or never."""

    AUTO = "auto"
    ALWAYS = "always"
    NEVER = "never"


@dataclass(frozen=True, slots=True)
class StartConfig:
    """Configuration of the start phase, from the rig file's [start], [safety] and [pumps].

    rate_cm_s : fastest change of a lower level's reference. settle_s : time at the first reference. tolerance_cm : how
    far from it a lower level may be at the end. level_max_cm : that trips. max_drives : (2,) largest
    drive of each pump. max_V : a pump's largest voltage.
    """

    when: When = When.NEVER
    rate_cm_s: float = 0.1
    settle_s: float = 60.0
    tolerance_cm: float = 0.5
    level_max_cm: float = inf
    max_drives: Pair = (inf, inf)
    max_V: float = inf


@dataclass(frozen=True, slots=True)
class StartPhase:
    """A start phase that has begun.

    from_V : (2,) outputs found. ramp_s : time of the ramp. length_s : of the phase. period_s : of the control.
    """

    from_V: Pair
    ramp_s: float
    length_s: float
    period_s: float

    @property
    def length_ns(self) -> int:
        """The length in ns."""
        return round(self.length_s * 1e9)

    def toward(self, t_s: float, target_V: Pair) -> Pair:
        """(2,) the outputs to aim at, V, on the way to target_V, at run time t_s, s (0 at the end of the phase)."""
        elapsed_s = t_s + self.length_s
        if elapsed_s >= self.ramp_s:
            return target_V
        share = max(elapsed_s / self.ramp_s, 0.0)  # the first step's time may lie before it by rounding
        (a1, a2), (b1, b2) = self.from_V, target_V
        return a1 + share * (b1 - a1), a2 + share * (b2 - a2)

    def is_past_ramp(self, t_s: float) -> bool:
        """Whether the outputs to aim at have arrived at run time t_s."""
        return t_s + self.length_s >= self.ramp_s

    def drives(self, model: TankModel, t_s: float, target_V: Pair) -> tuple[Pair, Pair]:
        """(2,) drives that keep the lower levels on the ramp to target_V, upper tanks at rest: now, and at its end."""
        k, (y1, y2), (r1, r2) = model.level_gain_V_cm, self.toward(t_s, target_V), target_V
        rate_cm_s = (r1 - self.from_V[0]) / k / self.ramp_s, (r2 - self.from_V[1]) / k / self.ramp_s
        now_V = _ramp_voltages(model, (y1 / k, y2 / k), rate_cm_s)
        return now_V, _ramp_voltages(model, (r1 / k, r2 / k), (0.0, 0.0))


def plan(
    config: StartConfig, model: TankModel, level_cm: Quad, reference_V: Pair, period_s: float
) -> StartPhase | None:
    """The start phase for the levels found, or None. Its length is a whole number of control periods."""
    k = model.level_gain_V_cm
    wanted_cm = (reference_V[0] / k, reference_V[1] / k)
    found_cm = (max(level_cm[0], 0.0), max(level_cm[1], 0.0))
    is_far = any(found < FAR_BELOW * wanted for found, wanted in zip(found_cm, wanted_cm, strict=True))
    if config.when is When.NEVER or (config.when is When.AUTO and not is_far):
        return None
    zero_s = _unstable_zero_s(model, wanted_cm)
    ramp_s = max(ramp_time_s(config, model, found_cm, wanted_cm), ZERO_RAMP * zero_s)
    periods = ceil((ramp_s + max(config.settle_s, ZERO_SETTLE * zero_s)) / period_s - PERIOD_TOLERANCE)
    return StartPhase((k * found_cm[0], k * found_cm[1]), ramp_s, periods * period_s, period_s)


def _unstable_zero_s(model: TankModel, wanted_cm: Pair) -> float:
    """1/z in s of the zero in the right half plane when the lower levels are held; 0 if both zeros are stable."""
    levels = equilibrium(model, _ramp_voltages(model, wanted_cm, (0.0, 0.0)))
    if min(levels) <= 0.0:
        return 0.0
    zero = float(transmission_zeros(linearise(model, levels)).max())
    return min(1.0 / zero, MAX_ZERO_S) if zero > 0.0 else 0.0


def ramp_time_s(config: StartConfig, model: TankModel, found_cm: Pair, wanted_cm: Pair) -> float:
    """Time of the ramp in s, at the fastest rate that keeps upper levels and pump voltages within their limits."""
    way_cm = (wanted_cm[0] - found_cm[0], wanted_cm[1] - found_cm[1])
    ramp_s = max(abs(way_cm[0]), abs(way_cm[1])) / config.rate_cm_s
    held_V = _ramp_voltages(model, wanted_cm, (0.0, 0.0))
    highest_cm = max(config.level_max_cm - LEVEL_MARGIN_CM, *equilibrium(model, held_V))
    highest_V = [max(DRIVE_SHARE * most, held) for most, held in zip(config.max_drives, held_V, strict=True)]
    for _ in range(MAX_HALVINGS):
        if ramp_s == 0.0:
            break
        volts = _ramp_voltages(model, wanted_cm, (way_cm[0] / ramp_s, way_cm[1] / ramp_s))
        is_slow = all(drive <= most for drive, most in zip(volts, highest_V, strict=True))
        if is_slow and max(equilibrium(model, volts)[2:]) <= highest_cm:
            break
        ramp_s *= 2.0
    return ramp_s


def problem(phase: StartPhase, config: StartConfig, level_cm: Sequence[float], target_cm: Pair, command_V: Pair) -> str:
    """Why the first reference was not reached by the end of the phase; "" if it was. command_V : (2,) the last."""
    off = [
        f"level {tank + 1} is {level_cm[tank]:.2f} cm, want {target_cm[tank]:.2f} cm"
        for tank in (0, 1)
        if not abs(level_cm[tank] - target_cm[tank]) <= config.tolerance_cm
    ]
    if not off:
        return ""
    weak = [f"{pump + 1}" for pump in (0, 1) if command_V[pump] >= config.max_V - AT_LIMIT_V]
    reason = (
        f"pump {' and '.join(weak)} at {config.max_V:g} V: too weak, or the tank leaks"
        if weak
        else "if the levels still move, give it more time (start.settle_s)"
    )
    return f"after {phase.length_s:.0f} s {' and '.join(off)}; {reason}"


def open_doubts(before: Doubts, alarms: Sequence[Alarm], t_s: float) -> Doubts:
    """The doubts after these alarms, at run time t_s."""
    if not alarms:
        return before
    open_ = {number: (candidates, since_s) for number, candidates, since_s in before}
    for alarm in alarms:
        _, since_s = open_.pop(alarm.number, ((), t_s))
        name = f"{alarm.kind} {alarm.target}"
        if alarm.is_recovery:
            continue
        if alarm.kind in NAMELESS:
            open_[alarm.number] = (alarm.candidates, since_s)
        elif name in LEAKS:
            open_[alarm.number] = ((name,), since_s)
    return tuple((number, candidates, since_s) for number, (candidates, since_s) in open_.items())


def hidden_level(doubts: Doubts, t_s: float, balanced: tuple[bool, bool] = (False, False), *, is_over: bool) -> str:
    """Why a lower tank may be fuller than its sensor shows; "" if no doubt says so.

    A sensor that drifts downwards while the tanks fill looks like a leak or a valve, and the tank overflows if it is
    taken for one. The worst explanation counts: for a named leak at once, for an open alarm after DOUBT_S, and for
    both when the phase is_over. An open alarm doesn't count for a tank whose water is balanced, see `filling_watch`.
    """
    hides = frozenset(name for name in HIDES_LEVEL if not balanced[int(name[-1]) - 1])
    for _, candidates, since_s in doubts:
        is_named = len(candidates) == 1
        if HIDES_LEVEL.isdisjoint(candidates) if is_named else hides.isdisjoint(candidates):
            continue
        if is_over or is_named or t_s - since_s >= DOUBT_S:
            found = " or ".join(candidates)
            what = f"{found} was found" if len(candidates) == 1 else f"it is not known what has failed: {found}"
            return f"{what}; a lower tank may be fuller than it shows"
    return ""


def lost_sensor(trusted: tuple[bool, ...]) -> str:
    """Why no tank is filled without its sensor. trusted : of each sensor, a lower one is not."""
    lost = 1 if not trusted[0] else 2
    return f"the sensor of tank {lost} is lost: how full a tank is that is being filled can't be left to the model"


def begins(phase: StartPhase, reference_V: Pair) -> Event:
    """The event at the beginning of the phase."""
    (y1, y2), (r1, r2) = phase.from_V, reference_V
    text = f"start phase: outputs from {y1:.2f}, {y2:.2f} to {r1:.2f}, {r2:.2f} V; time 0 in {phase.length_s:.1f} s"
    data: dict[str, object] = {"phase": "begin", "length_s": phase.length_s, "ramp_s": phase.ramp_s}
    return Event(Severity.INFO, "start_phase", text, data)


def ends(problem: str) -> Event:
    """The event at the end of the phase."""
    if problem:
        return Event(Severity.ERROR, "start_phase", f"start phase has failed: {problem}", {"phase": "failed"})
    return Event(Severity.INFO, "start_phase", "start phase is over: time 0 of the run", {"phase": "end"})


def _ramp_voltages(model: TankModel, lower_cm: Pair, rate_cm_s: Pair) -> Pair:
    """(2,) drives, not below 0 V, that move the lower levels at these rates, the upper tanks at rest."""
    s = sqrt(2.0 * model.gravity_cm_s2)
    flows = [
        model.outlet_cm2[i] * s * sqrt(lower_cm[i] + model.datum_cm[i]) + model.area_cm2[i] * rate_cm_s[i]
        for i in (0, 1)
    ]
    v1, v2 = np.linalg.solve(through_flow_matrix(model)[:2], np.array(flows)).tolist()
    return max(v1, 0.0), max(v2, 0.0)
