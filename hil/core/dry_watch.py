"""Dry watch: whether water arrives in the upper tanks, by their levels alone.

The interlock on dry running rests on the diagnosis. When both pumps lose their flow slowly, the diagnosis may follow
them with other names and never call them dead. So the balance of both upper tanks is watched: outflow plus change of
volume, over what the pump across should send at its voltage. Without water in either for DRY_S the pumps run dry.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from hil.core.tanks import TankModel
from hil.core.types import Pair, Quad

SMOOTHING_S = 3.0
DRY_S = 10.0
"""A sudden loss is found by the diagnosis sooner."""

MIN_V = 1.0
"""A pump with less voltage is not judged: it may have a dead zone."""

MIN_SHARE = 0.1
"""Less than this share of the expected inflow is no water."""


@dataclass(frozen=True, slots=True)
class DryWatch:
    """State of the watch.

    share : (2,) what arrives of each pump's water in the upper tank across, smoothed. dry_s : for how long nothing has
    arrived of either. level_cm : (2,) of tanks 3 and 4 at watched_ns, None at first.
    """

    share: Pair = (1.0, 1.0)
    dry_s: float = 0.0
    level_cm: Pair | None = None
    watched_ns: int = 0

    @property
    def is_dry(self) -> bool:
        """Whether the pumps run dry."""
        return self.dry_s >= DRY_S


def watch_dry(
    model: TankModel, watch: DryWatch, level_cm: Quad, pump_V: Pair, trusted: tuple[bool, ...], now_ns: int
) -> DryWatch:
    """Update from the balance since the last step. pump_V : (2,) drives after the lag, whatever the pumps give."""
    h3, h4 = level_cm[2:]
    period_s = (now_ns - watch.watched_ns) * 1e-9
    is_judged = min(pump_V) >= MIN_V and trusted[2] and trusted[3]
    if watch.level_cm is None or period_s <= 0.0 or not is_judged:
        return DryWatch(level_cm=(h3, h4), watched_ns=now_ns)
    s, weight = sqrt(2.0 * model.gravity_cm_s2), min(period_s / SMOOTHING_S, 1.0)
    shares = []
    for pump, (tank, now_cm, before_cm) in enumerate(((3, h4, watch.level_cm[1]), (2, h3, watch.level_cm[0]))):
        expected = (1.0 - model.valve_split[pump]) * model.pump_gain_cm3_Vs[pump] * pump_V[pump]
        arrives = model.outlet_cm2[tank] * s * sqrt(max(now_cm, 0.0) + model.datum_cm[tank])
        if now_cm <= 0.0:  # a datum draws water out of an empty tank unseen: then it counts as arrived
            arrives = min(arrives, expected)
        arrives += model.area_cm2[tank] * (now_cm - before_cm) / period_s
        shares.append(watch.share[pump] + weight * (arrives / expected - watch.share[pump]))
    dry_s = watch.dry_s + period_s if max(shares) < MIN_SHARE else 0.0
    return DryWatch(share=(shares[0], shares[1]), dry_s=dry_s, level_cm=(h3, h4), watched_ns=now_ns)
