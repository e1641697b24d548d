"""The plant: K. H. Johansson's four tanks with two pumps, after Hajiani and Poshtan (2012), eq. (1).

State: levels h1 .. h4 in cm (1, 2 lower; 3 drains into 1, 4 into 2) and flow voltages w1, w2 in V.

    A1 h1' = -a1 sqrt(2 g h1) + a3 sqrt(2 g h3) + gamma1 k1 e1 w1
    A2 h2' = -a2 sqrt(2 g h2) + a4 sqrt(2 g h4) + gamma2 k2 e2 w2
    A3 h3' = -a3 sqrt(2 g h3) + (1 - gamma2) k2 e2 w2
    A4 h4' = -a4 sqrt(2 g h4) + (1 - gamma1) k1 e1 w1
    lag w' = v - w

v is the flow voltage that the pump has in the steady state (for a straight pump the voltage at its terminals), e its
effectiveness (1: healthy). An outlet at a datum d below its tank's zero has h + d in place of h. A blocked outlet has a
smaller a; a leak is a second hole beside the outlet, with the same law, whose water leaves the rig. The lag is solved
exactly for a constant v, the levels by the classical Runge-Kutta method. A tank that is full stays full and spills the
rest, tanks 3 and 4 a share of it into the tank below, all others out of the rig; an empty tank has no outflow beyond
what flows in. Volumes are counted with the weights of the integration, so that

    pumped + stirred + caught = drained + spilled + change of contents

holds except for rounding, in every case. Drained is the water through the lower outlets and through leaks, stirred the
water that turbulence added or removed, spilled all that went over a rim, caught the part of it that fell into a tank.
"""

import math
from copy import copy

from firmware_sim.faults.effects import Effects
from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings, equilibrium_cm
from firmware_sim.tank_slopes import slopes_of

MAX_STEP_S = 0.02


def _followed(dt_s: float, lag_s: float, flow_V: float, applied_V: float) -> tuple[float, float, float]:
    """Flow voltage of one pump at the start, middle and end of a step."""
    if lag_s <= 0.0:
        return applied_V, applied_V, applied_V
    half = math.exp(-0.5 * dt_s / lag_s)
    return flow_V, applied_V + (flow_V - applied_V) * half, applied_V + (flow_V - applied_V) * half * half


class Tanks:
    """Levels, flow voltages and volume counters; starts in the equilibrium of start_V, pumps at rest."""

    def __init__(self, settings: EmulatorSettings) -> None:
        self._settings = settings
        self._effects = Effects()
        self._slopes = slopes_of(settings, self._effects)
        self._area_cm2 = settings.tanks.area_cm2
        self._heights_cm = parts(settings.tanks.height_cm, 4)
        self._caught = parts(settings.tanks.overflow_to_lower, 2)
        self._gain = settings.pumps.gain_cm3_Vs
        self._lags_s = self._own_lags_s = parts(settings.pumps.lag_s, 2)
        self.levels_cm = equilibrium_cm(settings)
        self.flow_V = (0.0, 0.0)
        self.pumped_cm3 = 0.0
        self.drained_cm3 = 0.0
        self.spilled_cm3 = 0.0
        self.caught_cm3 = 0.0
        self.stirred_cm3 = 0.0

    @property
    def contents_cm3(self) -> float:
        """Water in all four tanks."""
        return sum(area * level for area, level in zip(self._area_cm2, self.levels_cm, strict=True))

    def apply_effects(self, effects: Effects) -> None:
        """Use the leaks, blocked outlets, valve splits and lags of these effects from now on."""
        self._effects = effects
        self._slopes = slopes_of(self._settings, effects)
        lags = zip(self._own_lags_s, effects.lag_s, strict=True)
        self._lags_s = tuple(own_s if new_s is None else new_s.of(own_s) for own_s, new_s in lags)

    def set_valve_split(self, splits: tuple[float, float]) -> None:
        """Let the valves have these splits from now on, except where a fault has set another."""
        pumps = self._settings.pumps.model_copy(update={"valve_split": splits})
        self._settings = self._settings.model_copy(update={"pumps": pumps})
        self._slopes = slopes_of(self._settings, self._effects)

    def stir(self, volumes_cm3: list[float]) -> None:
        """Add a volume to each tank (negative: remove it), within 0 .. height."""
        levels_cm: list[float] = []
        tanks = zip(self.levels_cm, self._area_cm2, self._heights_cm, volumes_cm3, strict=True)
        for level_cm, area_cm2, top_cm, volume_cm3 in tanks:
            levels_cm.append(min(max(level_cm + volume_cm3 / area_cm2, 0.0), top_cm))
            self.stirred_cm3 += (levels_cm[-1] - level_cm) * area_cm2
        h1, h2, h3, h4 = levels_cm
        self.levels_cm = (h1, h2, h3, h4)

    def copy(self) -> "Tanks":
        """Return a second plant in the same state, which consists of immutable values."""
        return copy(self)

    def advance(self, dt_s: float, applied_V: tuple[float, float], effectiveness: list[float]) -> None:
        """Advance by dt_s with constant inputs, in equal steps of at most 20 ms. applied_V : flow voltages, see v."""
        if dt_s <= 0.0:
            return
        steps = math.ceil(dt_s / MAX_STEP_S - 1e-9)
        for _ in range(steps):
            self._step(dt_s / steps, applied_V, effectiveness)

    def _step(self, dt_s: float, applied_V: tuple[float, float], effectiveness: list[float]) -> None:
        h1, h2, h3, h4 = self.levels_cm
        e1, e2 = effectiveness
        start, middle, end = self._flow_through(dt_s, applied_V)
        fm1, fm2 = e1 * middle[0], e2 * middle[1]
        slopes, half_s = self._slopes, 0.5 * dt_s
        a1, a2, a3, a4, p1, p2 = slopes(h1, h2, h3, h4, e1 * start[0], e2 * start[1])
        b1, b2, b3, b4, q1, q2 = slopes(
            h1 + half_s * a1, h2 + half_s * a2, h3 + half_s * a3, h4 + half_s * a4, fm1, fm2
        )
        c1, c2, c3, c4, r1, r2 = slopes(
            h1 + half_s * b1, h2 + half_s * b2, h3 + half_s * b3, h4 + half_s * b4, fm1, fm2
        )
        d1, d2, d3, d4, s1, s2 = slopes(
            h1 + dt_s * c1, h2 + dt_s * c2, h3 + dt_s * c3, h4 + dt_s * c4, e1 * end[0], e2 * end[1]
        )
        sixth_s = dt_s / 6.0
        h1 += sixth_s * (a1 + 2.0 * (b1 + c1) + d1)
        h2 += sixth_s * (a2 + 2.0 * (b2 + c2) + d2)
        h3 += sixth_s * (a3 + 2.0 * (b3 + c3) + d3)
        h4 += sixth_s * (a4 + 2.0 * (b4 + c4) + d4)
        out1, out2 = p1 + 2.0 * (q1 + r1) + s1, p2 + 2.0 * (q2 + r2) + s2
        self.drained_cm3 += sixth_s * (self._area_cm2[0] * out1 + self._area_cm2[1] * out2)
        k1, k2 = self._gain
        self.pumped_cm3 += sixth_s * (
            k1 * e1 * (start[0] + 4.0 * middle[0] + end[0]) + k2 * e2 * (start[1] + 4.0 * middle[1] + end[1])
        )
        self.flow_V = end
        t1, t2, t3, t4 = self._heights_cm
        is_inside = 0.0 <= h1 <= t1 and 0.0 <= h2 <= t2 and 0.0 <= h3 <= t3 and 0.0 <= h4 <= t4
        self.levels_cm = (h1, h2, h3, h4) if is_inside else self._bounded(h1, h2, h3, h4)

    def _flow_through(
        self, dt_s: float, applied_V: tuple[float, float]
    ) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
        """Flow voltages at the start, middle and end of a step: w = v + (w0 - v) exp(-t / lag)."""
        v1, v2 = applied_V
        lag1_s, lag2_s = self._lags_s
        if lag1_s != lag2_s:
            first, second = _followed(dt_s, lag1_s, self.flow_V[0], v1), _followed(dt_s, lag2_s, self.flow_V[1], v2)
            return (first[0], second[0]), (first[1], second[1]), (first[2], second[2])
        if lag1_s <= 0.0:
            return applied_V, applied_V, applied_V
        w1, w2 = self.flow_V
        half = math.exp(-0.5 * dt_s / lag1_s)
        full = half * half
        middle = (v1 + (w1 - v1) * half, v2 + (w2 - v2) * half)
        return self.flow_V, middle, (v1 + (w1 - v1) * full, v2 + (w2 - v2) * full)

    def _bounded(self, h1: float, h2: float, h3: float, h4: float) -> tuple[float, float, float, float]:
        """Keep levels in 0 .. height: water above spills; outflow that an empty tank did not have is taken back."""
        A1, A2, A3, A4 = areas_cm2 = self._area_cm2
        if h3 < 0.0:
            h1, h3 = h1 + h3 * A3 / A1, 0.0
        if h4 < 0.0:
            h2, h4 = h2 + h4 * A4 / A2, 0.0
        if h1 < 0.0:
            self.drained_cm3, h1 = self.drained_cm3 + h1 * A1, 0.0
        if h2 < 0.0:
            self.drained_cm3, h2 = self.drained_cm3 + h2 * A2, 0.0
        t1, t2, t3, t4 = tops_cm = self._heights_cm
        caught3_cm3, caught4_cm3 = self._caught[0] * max(h3 - t3, 0.0) * A3, self._caught[1] * max(h4 - t4, 0.0) * A4
        self.caught_cm3 += caught3_cm3 + caught4_cm3
        h1, h2 = h1 + caught3_cm3 / A1, h2 + caught4_cm3 / A2
        for level_cm, area_cm2, top_cm in zip((h1, h2, h3, h4), areas_cm2, tops_cm, strict=True):
            if level_cm > top_cm:
                self.spilled_cm3 += (level_cm - top_cm) * area_cm2
        return min(h1, t1), min(h2, t2), min(h3, t3), min(h4, t4)
