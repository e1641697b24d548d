"""Inflow watch: a lower tank may be fuller than its sensor shows if ever more water is needed to hold the reading.

A sensor that drifts downwards very slowly is held at its reference by the integral action, and the tank fills up. If
the drift is so slow that the diagnosis takes it for a change of the rig's parameters, the only sign is the balance: the
outlet seems to let through more than it did. With the outlet as it was, the level would be higher by the square of
that ratio.

Inflow is the smaller of what the voltages and what the upper levels say, so that a weak pump or a clogged upper outlet
alone do not count. The ratio is compared with that of the first LEARN_S, which no error of the rig file changes, and
learned again after each fault that the diagnosis names: a leak is such a reason. It begins after the start phase, in
which `filling_watch` counts the water.
Why: docs/decisions/0022-veto-of-a-live-sensor.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from hil.core.tanks import TankModel, clean_outflow, water_balance
from hil.core.types import Diagnosis, Pair, Quad

LEARN_S = 120.0
SMOOTHING_S = 60.0
"""A fault that the diagnosis finds is found within this time."""

MIN_RATIO = 1.1
"""A smaller increase is not judged: a rig is not linear."""

RANGE = (0.2, 5.0)
"""Limits for what one step may contribute to the ratio."""

MIN_LEVEL_CM = 1.0
"""Below this level the outflow says little."""

NOT_RISEN = (1.0, 1.0)


@dataclass(frozen=True, slots=True)
class InflowWatch:
    """State of the watch for the two lower tanks.

    ratio : (2,) outflow by the balance over that of a clean outlet, smoothed. learned : (2,) the ratio after LEARN_S,
    (0, 0) before. age_s : time since learning began. level_cm : (4,) levels at watched_ns, None at first.
    """

    ratio: Pair = (1.0, 1.0)
    learned: Pair = (0.0, 0.0)
    age_s: float = 0.0
    level_cm: Quad | None = None
    watched_ns: int = 0

    def possible_cm(self, model: TankModel, level_cm: Quad, diagnosis: Diagnosis) -> Pair:
        """(2,) the levels that the lower tanks may have, in cm; -inf where nothing speaks against those given."""
        first, second = (
            (level_cm[tank] + model.datum_cm[tank]) * max(self.ratio[tank] / self.learned[tank], 1.0) ** 2
            - model.datum_cm[tank]
            if diagnosis.trusted[tank] and self.ratio[tank] > MIN_RATIO * self.learned[tank] > 0.0
            else -inf
            for tank in range(2)
        )
        return first, second


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
    begins = any(alarm.isolated_s is not None for alarm in diagnosis.new_alarms)
    if watch.level_cm is None or period_s <= 0.0 or begins:
        return InflowWatch(level_cm=level_cm, watched_ns=now_ns)
    age_s = watch.age_s + period_s
    weight = min(period_s / min(age_s, SMOOTHING_S), 1.0)
    low, high = RANGE
    now1, now2 = (min(max(now, low), high) for now in _ratios(model, watch.level_cm, level_cm, effective_V, period_s))
    ratio = (watch.ratio[0] + weight * (now1 - watch.ratio[0]), watch.ratio[1] + weight * (now2 - watch.ratio[1]))
    learned = watch.learned
    if learned == (0.0, 0.0) and age_s >= LEARN_S:
        learned = (ratio[0] / risen[0], ratio[1] / risen[1])
    return InflowWatch(ratio=ratio, learned=learned, age_s=age_s, level_cm=level_cm, watched_ns=now_ns)


def _ratios(model: TankModel, before_cm: Quad, level_cm: Quad, effective_V: Pair, period_s: float) -> Pair:
    """(2,) inflow less change of volume, over the outflow of a clean outlet."""
    balance = water_balance(model, before_cm, level_cm, effective_V, period_s)
    ratios = []
    for tank, other in ((0, 1), (1, 0)):
        split = model.valve_split[tank]
        by_level = split / max(1.0 - split, 1e-3) * balance.upper_inflow[other]  # this pump's other tank
        own = min(balance.direct[tank], by_level)
        above = min(balance.outflow[2 + tank], balance.across[tank])
        clean = clean_outflow(model, tank, max(level_cm[tank], MIN_LEVEL_CM))
        ratios.append((own + above - balance.growth[tank]) / clean)
    return ratios[0], ratios[1]
