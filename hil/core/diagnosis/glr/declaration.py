"""From a verdict to an alarm: kind and size of a fault, in the words and units of a scenario.

Why this method: `docs/decisions/0009-diagnosis-by-likelihood-ratios.md`.
"""

from __future__ import annotations

from math import inf, nan, sqrt

from hil.core.diagnosis.glr import growth, inflow_check, strength, stuck_check
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, VOLTAGE
from hil.core.diagnosis.glr.growth import NO_GROWTH
from hil.core.diagnosis.glr.hypotheses import BOTH, JUMPS, LAGS, PUMPS, SPLITS, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Declared, Lost, Suspicion
from hil.core.diagnosis.glr.model import BIAS, DRIFT, GAIN, LAG, LEAK, OUTLET, PUMP, RATE, SPLIT, Array
from hil.core.types import UNRESOLVED, Alarm, Pair

MAX_EFFECTIVENESS = 2.0
"""The control law assumes no more; a pump that seems to give more is more likely to be stuck than that strong."""

IDLE_V = 0.5
"""Below this voltage a pump's effectiveness does not show."""

FOLLOW_S, FOLLOW_SIZE = 5.0, 0.02
"""A fault that grows is reported again after this time when its size has changed by this much."""

LAG_CHANGE, SURE_LAG = 0.2, 0.1
"""A lag is reported again when it has changed by this share, and is known to the second."""

AGAIN_S, SMALL_STEP = 20.0, 0.05
"""A fault that is found larger again within this time, or by less than this, has grown: it is no new fault."""

PROVEN_S, PROVEN_SHARE = 1.0, 0.1
"""A pump that has been driven for this time without an alarm works; with a smaller share of its gain it does not."""

PROVEN_STDS = 2.0
"""A weak pump at rest has that share for sure if its gain is larger by so many standard deviations."""

BLIND_S, QUIET_BLIND_S = 3.0, 5.5
"""How long an alarm may be unresolved while a lower tank has no sensor, and something that may be the rig's own."""

STILL_THERE = 0.7
"""A fault that has kept more than this share of its size is not over."""

RECOVERED_STDS = 3.0
RECOVERED_PUMP = 0.03
"""A pump is back when its effectiveness is this close to 1."""


def declare(config: DetectorConfig, m: Memory, j: int, before: Array, onset: int, suspicion: Suspicion) -> Alarm:
    """Note that state j of JUMPS has jumped, from what it was before to what the filter now says; the alarm."""
    jump = JUMPS[j]
    now, std = float(m.x[jump.state]), sqrt(max(m.P[jump.state, jump.state], 0.0))
    known = m.declared.get(j)
    healthy = known.healthy if known else float(before[jump.state])
    total = now - healthy
    kind = known.kind if known else (jump.rises if total > 0.0 else jump.falls)
    least = RECOVERED_PUMP if jump.state < SPLIT else jump.fall[0]
    is_recovery = known is not None and _is_over(known, total, max(RECOVERED_STDS * std, least))
    shown, unit = _shown(config, m, j, healthy)
    onset_s = m.time_of(onset)
    grows = growth.covers(m.growing, j)
    goes_on = grows or (known is not None and (known.grows or _has_grown(config, m, known, total)))
    number, detected_s = _number(m, known, suspicion, is_update=is_recovery or goes_on)
    if is_recovery:
        del m.declared[j]
        if jump.state >= LEAK:
            m.forget(jump.state)
    else:
        m.declared[j] = Declared(
            kind=kind,
            size=total,
            healthy=healthy,
            number=number,
            detected_s=detected_s,
            declared_s=m.t_s,
            shown=shown,
            grows=grows,
        )
    if grows:
        m.followed_s = m.t_s
    if kind == "sensor_drift" and not is_recovery:
        _exclude_sensor(m, jump.target - 1, kind, number)
    if j in PUMPS:
        if is_recovery:
            m.stuck_checks.pop(j, None)
        elif kind == "pump_effectiveness":
            stuck_check.begin(config, m, j, number, detected_s, onset_s)
    return Alarm(
        detected_s=suspicion.detected_s if is_recovery else detected_s,
        kind=kind,
        target=jump.target,
        size=shown,
        size_std=std * unit,
        onset_s=onset_s,
        isolated_s=m.t_s,
        candidates=(f"{kind} {jump.target}",),
        number=number,
        is_recovery=is_recovery,
    )


def _is_over(known: Declared, total: float, near: float) -> bool:
    """Whether what is left of a fault is nearly nothing: a small fault that has become no smaller goes on."""
    return abs(total) < near and abs(total) < STILL_THERE * abs(known.size)


def _has_grown(config: DetectorConfig, m: Memory, known: Declared, total: float) -> bool:
    """Whether a verdict on a known fault is more of the same: just declared, or found larger soon or by little."""
    if m.t_s - known.declared_s < config.tuning.sharpen_s:
        return True
    is_soon = m.t_s - known.declared_s < AGAIN_S
    return total * known.size > 0.0 and 0.0 < abs(total) - abs(known.size) < (inf if is_soon else SMALL_STEP)


def _number(m: Memory, known: Declared | None, suspicion: Suspicion, *, is_update: bool) -> tuple[int, float]:
    """Number and time of the alarm: those of the fault that is over or updated, or else new ones."""
    if known is not None and is_update:
        return known.number, known.detected_s
    number, taken = suspicion.number, {fault.number for fault in m.declared.values()}
    if number is None or number in taken:
        m.alarms += 1
        number = m.alarms
    return number, suspicion.detected_s


def unresolved(m: Memory, suspicion: Suspicion, numbers: list[int]) -> Alarm:
    """The alarm while several hypotheses remain, the likeliest first."""
    names: dict[str, None] = {}
    for number in numbers:
        for j in jumps_of(number):
            state = JUMPS[j].state
            size = m.replays.x[number, state] - m.replays.before[number, state]
            if number <= BOTH and m.best.slot[number] >= 0 and m.best.ratio[number] > 0.0:
                size = m.bank.match[j, m.best.slot[number]]
            kind = JUMPS[j].rises if size > 0.0 else JUMPS[j].falls
            if kind:
                names[f"{kind} {JUMPS[j].target}"] = None
    onset_s = m.time_of(int(m.replays.onset[numbers[0]])) if numbers else nan
    return Alarm(
        detected_s=suspicion.detected_s,
        kind=UNRESOLVED,
        target=0,
        size=nan,
        onset_s=onset_s,
        candidates=tuple(names),
        number=suspicion.number or 0,
    )


def follow_growth(config: DetectorConfig, m: Memory) -> list[Alarm]:
    """New sizes of a fault that grows, under the number of its alarm; the filter follows it all the time."""
    alarms: list[Alarm] = []
    if m.growing == NO_GROWTH or m.suspicion is not None or m.t_s - m.followed_s < FOLLOW_S:
        return alarms
    for j, fault in m.declared.items():
        if not growth.covers(m.growing, j):
            continue
        shown, unit = _shown(config, m, j, fault.healthy)
        if abs(shown - fault.shown) < FOLLOW_SIZE:
            continue
        fault.shown, fault.size = shown, float(m.x[JUMPS[j].state]) - fault.healthy
        m.followed_s = m.t_s
        alarms.append(_update(m, j, fault, sqrt(max(m.P[JUMPS[j].state, JUMPS[j].state], 0.0)) * unit))
    return alarms


def follow_lags(config: DetectorConfig, m: Memory) -> list[Alarm]:
    """New sizes of lags, once later movements have taught that the first was wrong, under the number of their alarm."""
    alarms: list[Alarm] = []
    if m.declared.keys().isdisjoint(LAGS) or m.suspicion is not None or m.unknown is not None:
        return alarms
    if m.t_s - m.followed_s < FOLLOW_S:
        return alarms
    for j in [j for j in LAGS if j in m.declared]:
        fault = m.declared[j]
        shown, unit = _shown(config, m, j, fault.healthy)
        std = sqrt(max(m.P[JUMPS[j].state, JUMPS[j].state], 0.0)) * unit
        if abs(shown - fault.shown) < LAG_CHANGE * fault.shown or std > SURE_LAG * shown:
            continue
        fault.shown, fault.size = shown, float(m.x[JUMPS[j].state]) - fault.healthy
        alarms.append(_update(m, j, fault, std))
        m.followed_s = m.t_s
    return alarms


def _update(m: Memory, j: int, fault: Declared, std: float) -> Alarm:
    return Alarm(
        detected_s=fault.detected_s,
        kind=fault.kind,
        target=JUMPS[j].target,
        size=fault.shown,
        size_std=std,
        isolated_s=m.t_s,
        candidates=(f"{fault.kind} {JUMPS[j].target}",),
        number=fault.number,
    )


def end_growth(m: Memory) -> None:
    """Let nothing grow that is not declared."""
    if m.growing != NO_GROWTH and not any(growth.covers(m.growing, j) for j in m.declared):
        m.forget(RATE)
        m.growing = NO_GROWTH


def close(m: Memory, suspicion: Suspicion, alarms: list[Alarm]) -> list[Alarm]:
    """The end of an unresolved alarm whose fault turned out to have a number already."""
    if suspicion.number is None or any(alarm.number == suspicion.number for alarm in alarms):
        return []
    return [withdrawn(m, suspicion.number, alarms[0].candidates)]


def withdrawn(m: Memory, number: int, candidates: tuple[str, ...]) -> Alarm:
    """The end of an unresolved alarm. candidates : what it turned out to be, none if there is no fault."""
    return Alarm(
        detected_s=m.t_s,
        kind=UNRESOLVED,
        target=0,
        size=nan,
        onset_s=m.t_s,
        candidates=candidates,
        number=number,
        is_recovery=True,
    )


def effectiveness(m: Memory) -> Pair:
    """(2,) each pump's gain over that of the rig file; exactly 1 unless a difference or a change was declared."""
    if m.declared.keys().isdisjoint(PUMPS):
        return strength.effectiveness(m)
    left = list(strength.effectiveness(m))
    for pump in PUMPS:
        fault = m.declared.get(pump)
        if fault is not None and fault.kind == "pump_effectiveness":
            left[pump] *= min(max(float(m.x[GAIN + pump]) / fault.healthy, 0.0), MAX_EFFECTIVENESS)
    return left[0], left[1]


def valve_split(config: DetectorConfig, m: Memory) -> Pair | None:
    """(2,) the valves' splits if a shift of one was declared, otherwise None."""
    if m.declared.keys().isdisjoint(SPLITS):
        return None
    first, second = (
        float(config.model.valve_split[valve] * (m.x[SPLIT + valve] if SPLITS[valve] in m.declared else 1.0))
        for valve in range(2)
    )
    return min(max(first, 0.0), 1.0), min(max(second, 0.0), 1.0)


def watch_unproven(m: Memory) -> None:
    """Whether the pump that was at rest when the other one failed has been seen to work since."""
    if m.unproven is None:
        return
    pump, driven_s = m.unproven
    if m.entry[VOLTAGE + pump] >= IDLE_V and m.suspicion is None:
        driven_s += float(m.entry[PERIOD])
    m.unproven = None if driven_s >= PROVEN_S or PUMPS[1 - pump] not in m.declared else (pump, driven_s)


def unproven(config: DetectorConfig, m: Memory) -> tuple[bool, bool]:
    """(2,) pumps that may deliver no water.

    A pump that was at rest when the other failed and has not been seen to work since, one that is dead if the likeliest
    hypothesis is true, one whose upper tank receives no water from it, and one that has failed with the other, and
    stands still before it was known how much it has left.
    """
    if m.unproven is None and m.declared.keys().isdisjoint(PUMPS):
        return False, False
    doubts = [m.unproven is not None and m.unproven[0] == pump for pump in PUMPS]
    if m.suspicion is not None and m.suspicion.leader is not None:
        for pump in PUMPS:
            left = float(m.replays.x[m.suspicion.leader, GAIN + pump])
            doubts[pump] |= pump in m.declared and left < PROVEN_SHARE * m.declared[pump].healthy
    for pump in PUMPS:
        doubts[pump] |= PUMPS[1 - pump] in m.declared and inflow_check.is_missing(config, m, pump)
        doubts[pump] |= PUMPS[1 - pump] in m.declared and _may_be_dead_at_rest(m, pump)
    return doubts[0], doubts[1]


def _may_be_dead_at_rest(m: Memory, pump: int) -> bool:
    """Whether a pump was declared weak, and is at rest before its gain was known well enough to say that it works."""
    fault = m.declared.get(pump)
    if fault is None or fault.kind != "pump_effectiveness" or float(m.entry[VOLTAGE + pump]) >= IDLE_V:
        return False
    std = sqrt(max(float(m.P[GAIN + pump, GAIN + pump]), 0.0))
    return float(m.x[GAIN + pump]) - PROVEN_STDS * std < PROVEN_SHARE * fault.healthy


def is_blind(m: Memory) -> bool:
    """Whether the level of a lower tank is known neither from a sensor nor from the model.

    The flow that the tank gets from its own pump and valve shows only in the sensor of that tank: the upper tank gets
    the rest, and a weaker pump and a shifted valve look the same there.
    """
    for sensor, lost in m.lost.items():
        if sensor in PUMPS:
            if m.unknown is not None:
                return True
            if m.suspicion is not None and _is_open_too_long(m, m.suspicion):
                return True
            if any(m.declared[j].declared_s > lost.since_s for j in (sensor, SPLITS[sensor]) if j in m.declared):
                return True
    return False


def _is_open_too_long(m: Memory, suspicion: Suspicion) -> bool:
    open_s = m.t_s - suspicion.detected_s + suspicion.quiet_s
    return open_s > (QUIET_BLIND_S if suspicion.is_quiet else BLIND_S)


def _shown(config: DetectorConfig, m: Memory, j: int, healthy: float) -> tuple[float, float]:
    """The size as a scenario gives it, and that unit per unit of the state."""
    jump = JUMPS[j]
    now, model = float(m.x[jump.state]), config.model
    if jump.state < SPLIT:
        stuck = j in m.declared and m.declared[j].kind == "pump_stuck_on"
        unit = (float(m.x[PUMP + jump.target - 1]) if stuck else 1.0) / healthy
        low, high = config.range_V[jump.target - 1] if stuck else (0.0, inf)
        return min(max(now * unit, low), high), unit
    if jump.state < OUTLET:
        unit = float((model.valve_split if jump.state < LAG else model.lag_s)[jump.target - 1])
        return now * unit, unit
    if jump.state < LEAK:
        return abs(now - healthy) / healthy, 1.0 / healthy
    if jump.state < BIAS:
        unit = 1.0 / _clean_outlet(m, jump.target)
        return (now - healthy) * unit, unit
    return now, 1.0


def _clean_outlet(m: Memory, tank: int) -> float:
    """A tank's outlet over the rig file's, before it was blocked if it is."""
    state = OUTLET + tank - 1
    blocked = (fault.healthy for j, fault in m.declared.items() if JUMPS[j].state == state)
    return next(blocked, float(m.x[state]))


def _exclude_sensor(m: Memory, sensor: int, kind: str, number: int) -> None:
    """Stop using a sensor that drifts."""
    m.usable[sensor] = False
    m.lost[sensor] = Lost(kind=kind, number=number, since_s=m.t_s)
    m.agrees[sensor] = 0
    m.forget(BIAS + sensor)
    m.forget(DRIFT + sensor)
    for j in [j for j in m.declared if JUMPS[j].state in (BIAS + sensor, DRIFT + sensor)]:
        del m.declared[j]
