"""Dry watch: whether water arrives in the upper tanks, by their levels alone.

The interlock on dry running rests on the diagnosis. When both pumps lose their flow slowly, the diagnosis may follow
them with other names and never call them dead. So the balance of both upper tanks is watched: outflow plus change of
volume, over what the pump across should send at its voltage. Without water in either for DRY_S the pumps run dry.
"""

from __future__ import annotations

from typing import NamedTuple

from hil.core.tanks import TankModel, water_balance
from hil.core.types import Pair, Quad

SMOOTHING_S = 3.0
DRY_S = 10.0
"""A sudden loss is found by the diagnosis sooner."""

MIN_V = 1.0
"""A pump with less voltage is not judged: it may have a dead zone."""

MIN_SHARE = 0.1
"""Less than this share of the expected inflow is no water."""


class DryWatch(NamedTuple):
    """State of the watch.

    share : (2,) what arrives of each pump's water in the upper tank across, smoothed. dry_s : for how long nothing has
    arrived of either. level_cm : (4,) at watched_ns, None at first.
    """

    share: Pair = (1.0, 1.0)
    dry_s: float = 0.0
    level_cm: Quad | None = None
    watched_ns: int = 0

    @property
    def is_dry(self) -> bool:
        """Whether the pumps run dry."""
        return self.dry_s >= DRY_S


def watch_dry(
    model: TankModel, watch: DryWatch, level_cm: Quad, pump_V: Pair, trusted: tuple[bool, ...], now_ns: int
) -> DryWatch:
    """Update from the balance since the last step. pump_V : (2,) drives after the lag, whatever the pumps give."""
    period_s = (now_ns - watch.watched_ns) * 1e-9
    is_judged = min(pump_V) >= MIN_V and trusted[2] and trusted[3]
    if watch.level_cm is None or period_s <= 0.0 or not is_judged:
        return DryWatch(level_cm=level_cm, watched_ns=now_ns)
    balance = water_balance(model, watch.level_cm, level_cm, pump_V, period_s)
    (into3, into4), (sent3, sent4), (share1, share2) = balance.upper_inflow, balance.across, watch.share
    weight = min(period_s / SMOOTHING_S, 1.0)
    share = (share1 + weight * (into4 / sent4 - share1), share2 + weight * (into3 / sent3 - share2))
    dry_s = watch.dry_s + period_s if max(share) < MIN_SHARE else 0.0
    return DryWatch(share=share, dry_s=dry_s, level_cm=level_cm, watched_ns=now_ns)
