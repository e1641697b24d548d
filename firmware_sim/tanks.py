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

from firmware_sim.equations import bounded, followed, pumped, runge_kutta
from firmware_sim.faults.effects import Effects
from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings, equilibrium_cm
from firmware_sim.tank_slopes import slopes_of

MAX_STEP_S = 0.02


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
        start, middle, self.flow_V = self._flow_through(dt_s, applied_V)
        flows_V = (
            e1 * start[0],
            e2 * start[1],
            e1 * middle[0],
            e2 * middle[1],
            e1 * self.flow_V[0],
            e2 * self.flow_V[1],
        )
        h1, h2, h3, h4, out1, out2 = runge_kutta(self._slopes, dt_s, h1, h2, h3, h4, *flows_V)
        self.drained_cm3 += self._area_cm2[0] * out1 + self._area_cm2[1] * out2
        self.pumped_cm3 += pumped(dt_s, *self._gain, *flows_V)
        t1, t2, t3, t4 = self._heights_cm
        if not (0.0 <= h1 <= t1 and 0.0 <= h2 <= t2 and 0.0 <= h3 <= t3 and 0.0 <= h4 <= t4):
            h1, h2, h3, h4, drained_cm3, spilled_cm3, caught_cm3 = bounded(
                h1, h2, h3, h4, *self._area_cm2, *self._heights_cm, *self._caught
            )
            self.drained_cm3 += drained_cm3
            self.spilled_cm3 += spilled_cm3
            self.caught_cm3 += caught_cm3
        self.levels_cm = (h1, h2, h3, h4)

    def _flow_through(
        self, dt_s: float, applied_V: tuple[float, float]
    ) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
        """Flow voltages at the start, middle and end of a step: w = v + (w0 - v) exp(-t / lag)."""
        v1, v2 = applied_V
        lag1_s, lag2_s = self._lags_s
        if lag1_s != lag2_s:
            first, second = followed(dt_s, lag1_s, self.flow_V[0], v1), followed(dt_s, lag2_s, self.flow_V[1], v2)
            return (first[0], second[0]), (first[1], second[1]), (first[2], second[2])
        if lag1_s <= 0.0:
            return applied_V, applied_V, applied_V
        w1, w2 = self.flow_V
        half = math.exp(-0.5 * dt_s / lag1_s)
        full = half * half
        middle = (v1 + (w1 - v1) * half, v2 + (w2 - v2) * half)
        return self.flow_V, middle, (v1 + (w1 - v1) * full, v2 + (w2 - v2) * full)
