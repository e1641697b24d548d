"""Inflow watch: a lower tank may be fuller than its sensor shows if ever more water is needed to hold the reading.

A sensor that drifts downwards very slowly is held at its reference by the integral action, and the tank fills up. If
the drift is so slow that the diagnosis takes it for a change of the rig's parameters, the only sign is the balance: the
outlet seems to let through more than it did. With the outlet as it was, the level would be higher by the square of
that ratio.

Inflow is the smaller of what the voltages and what the upper levels say, so that a weak pump or a clogged upper outlet
alone do not count. What a pump gives for its voltage is first learned from the upper levels: without this, pumps with
other gains, dead zones or curves made the ratio rise whenever a voltage changed. The ratio is compared with that of the
first LEARN_S, which no error of the rig file changes, and learned again after each fault that the diagnosis names: a
leak is such a reason. It begins after the start phase, in which `filling_watch` counts the water.
Why: docs/decisions/0022-veto-of-a-live-sensor.md.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from hil.core.tanks import TankModel, WaterBalance, clean_outflow, water_balance
from hil.core.types import Diagnosis, Pair, Quad

LEARN_S = 120.0
LEARN_PUMPS_S, PUMP_SMOOTHING_S = 30.0, 20.0
"""Of these, the first are for what the pumps give; the ratio begins after them."""

SMOOTHING_S = 60.0
"""A fault that the diagnosis finds is found within this time."""

MIN_RATIO = 1.1
"""A smaller increase is not judged: a rig is not linear."""

RANGE = (0.2, 5.0)
"""Limits for what one step may contribute to the ratio."""

MIN_LEVEL_CM = 1.0
"""Below this level the outflow says little."""

NOT_RISEN = (1.0, 1.0)


class InflowWatch(NamedTuple):
    """State of the watch for the two lower tanks.

    ratio : (2,) outflow by the balance over that of a clean outlet, smoothed. learned : (2,) the ratio after LEARN_S,
    (0, 0) before. age_s : time since learning began. level_cm : (4,) levels at watched_ns, None at first. came_cm3_s,
    sent_cm3_s : (2,) what each pump sends to the upper tank across, by that level and by its voltage, smoothed. given :
    (2,) the first over the second after LEARN_PUMPS_S.
    """

    ratio: Pair = (1.0, 1.0)
    learned: Pair = (0.0, 0.0)
    age_s: float = 0.0
    level_cm: Quad | None = None
    watched_ns: int = 0
    came_cm3_s: Pair = (0.0, 0.0)
    sent_cm3_s: Pair = (0.0, 0.0)
    given: Pair = (1.0, 1.0)

    @property
    def counted(self) -> Pair:
        """(2,) share of what comes by the upper level of each pump that its voltage explains; 1 while it is learned."""
        if self.learned == (0.0, 0.0):
            return 1.0, 1.0
        return self._counted(0), self._counted(1)

    def _counted(self, pump: int) -> float:
        explained, came = self.given[pump] * self.sent_cm3_s[pump], self.came_cm3_s[pump]
        return min(explained / came, 1.0) if came > explained > 0.0 else 1.0

    def possible_cm(self, model: TankModel, level_cm: Quad, diagnosis: Diagnosis) -> Pair:
        """(2,) the levels that the lower tanks may have, in cm; -inf where nothing speaks against those given."""
        trusted = diagnosis.trusted
        first = self._possible_cm(model, level_cm, 0) if trusted[0] else -inf
        return first, self._possible_cm(model, level_cm, 1) if trusted[1] else -inf

    def _possible_cm(self, model: TankModel, level_cm: Quad, tank: int) -> float:
        ratio, learned, datum_cm = self.ratio[tank], self.learned[tank], model.datum_cm[tank]
        if not ratio > MIN_RATIO * learned > 0.0:
            return -inf
        return (level_cm[tank] + datum_cm) * max(ratio / learned, 1.0) ** 2 - datum_cm


def watch_inflow(
    model: TankModel,
    watch: InflowWatch,
    level_cm: Quad,
    effective_V: Pair,
    diagnosis: Diagnosis,
    now_ns: int,
    risen: Pair = NOT_RISEN,
) -> InflowWatch:
    """Update from the balance since the last step.

    effective_V : (2,) what the pumps deliver, as nominal voltages. risen : (2,) by how much the ratio had risen before,
    see `filling_watch`; what is learned is so much smaller.
    """
    period_s = (now_ns - watch.watched_ns) * 1e-9
    alarms = diagnosis.new_alarms
    begins = bool(alarms) and any(alarm.isolated_s is not None for alarm in alarms)
    if watch.level_cm is None or period_s <= 0.0 or begins:
        return InflowWatch(level_cm=level_cm, watched_ns=now_ns)
    age_s = watch.age_s + period_s
    balance = water_balance(model, watch.level_cm, level_cm, effective_V, period_s)
    (into3, into4), (sent3, sent4) = balance.upper_inflow, balance.across
    pump_weight = min(period_s / min(age_s, PUMP_SMOOTHING_S), 1.0)
    came_cm3_s = _smoothed(watch.came_cm3_s, (into4, into3), pump_weight)
    sent_cm3_s = _smoothed(watch.sent_cm3_s, (sent4, sent3), pump_weight)
    given = _given(came_cm3_s, sent_cm3_s) if age_s <= LEARN_PUMPS_S else watch.given
    weight = min(period_s / min(max(age_s - LEARN_PUMPS_S, period_s), SMOOTHING_S), 1.0)
    low, high = RANGE
    now1, now2 = _ratios(model, balance, watch.counted, level_cm)
    ratio = _smoothed(watch.ratio, (min(max(now1, low), high), min(max(now2, low), high)), weight)
    learned = watch.learned
    if learned == (0.0, 0.0) and age_s >= LEARN_S:
        learned = (ratio[0] / risen[0], ratio[1] / risen[1])
    return InflowWatch(ratio, learned, age_s, level_cm, now_ns, came_cm3_s, sent_cm3_s, given)


def _smoothed(before: Pair, now: Pair, weight: float) -> Pair:
    return before[0] + weight * (now[0] - before[0]), before[1] + weight * (now[1] - before[1])


def _given(came_cm3_s: Pair, sent_cm3_s: Pair) -> Pair:
    """(2,) what each pump gives for its voltage, over what the file says."""
    low, high = RANGE
    first, second = (
        min(max(came / sent, low), high) if sent > 0.0 else 1.0
        for came, sent in zip(came_cm3_s, sent_cm3_s, strict=True)
    )
    return first, second


def _ratios(model: TankModel, balance: WaterBalance, counted: Pair, level_cm: Quad) -> Pair:
    """(2,) inflow less change of volume, over the outflow of a clean outlet. counted : (2,) see InflowWatch."""
    (g1, g2), (c1, c2), (into3, into4) = model.valve_split, counted, balance.upper_inflow
    _, _, out3, out4 = balance.outflow
    by_level1 = g1 / max(1.0 - g1, 1e-3) * into4  # pump 1 sends the rest to tank 4
    by_level2 = g2 / max(1.0 - g2, 1e-3) * into3
    clean1 = clean_outflow(model, 0, max(level_cm[0], MIN_LEVEL_CM))
    clean2 = clean_outflow(model, 1, max(level_cm[1], MIN_LEVEL_CM))
    return (
        (c1 * by_level1 + c2 * out3 - balance.growth[0]) / clean1,
        (c2 * by_level2 + c1 * out4 - balance.growth[1]) / clean2,
    )
