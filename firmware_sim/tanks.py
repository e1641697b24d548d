"""The plant: K. H. Johansson's four tanks with two pumps, after Hajiani and Poshtan (2012), eq. (1).

State: levels h1 .. h4 in cm (1, 2 lower; 3 drains into 1, 4 into 2) and flow voltages w1, w2 in V.

    A1 h1' = -a1 sqrt(2 g h1) + a3 sqrt(2 g h3) + gamma1 k1 e1 w1
    A2 h2' = -a2 sqrt(2 g h2) + a4 sqrt(2 g h4) + gamma2 k2 e2 w2
    A3 h3' = -a3 sqrt(2 g h3) + (1 - gamma2) k2 e2 w2
    A4 h4' = -a4 sqrt(2 g h4) + (1 - gamma1) k1 e1 w1
    lag w' = v - w

v is the voltage at the pump's terminals, e its effectiveness (1: healthy). A blocked outlet has a smaller a; a leak is
a second hole in the bottom, with the same square-root law, whose water leaves the rig. The lag is solved exactly
for a constant v, the levels by the classical Runge-Kutta method. A tank that is full stays full and spills the rest
out of the rig; an empty tank has no outflow. Volumes are counted with the weights of the integration, so that

    pumped + stirred = drained + spilled + change of contents

holds except for rounding, in every case. Drained is the water through the lower outlets and through leaks, stirred the
water that turbulence added or removed.
"""

import math
from collections.abc import Callable
from copy import copy
from dataclasses import replace

from firmware_sim.faults.effects import Effects
from firmware_sim.parameter_spread import parts
from firmware_sim.settings import EmulatorSettings, equilibrium_cm

MAX_STEP_S = 0.02

Slopes = Callable[[float, float, float, float, float, float], tuple[float, float, float, float, float, float]]


def slopes_of(settings: EmulatorSettings, effects: Effects) -> Slopes:
    """Eq. (1) as a function (h1, h2, h3, h4, e1 w1, e2 w2) -> (h1', h2', h3', h4', outflow 1, outflow 2).

    All six results are in cm/s; the outflows are those of the lower tanks over their own areas, each with the leaks of
    its side.
    """
    if any(effects.leak):
        return _leaking_slopes_of(settings, effects)
    A1, A2, A3, A4 = settings.tanks.area_cm2
    a = _outlets_cm2(settings, effects)
    (k1, k2), (gamma1, gamma2) = settings.pumps.gain_cm3_Vs, _splits(settings, effects)
    speed = math.sqrt(2.0 * settings.tanks.gravity_cm_s2)
    c1, c2, c3, c4 = a[0] * speed / A1, a[1] * speed / A2, a[2] * speed / A3, a[3] * speed / A4
    r31, r42 = A3 / A1, A4 / A2
    b1, b2, b3, b4 = gamma1 * k1 / A1, gamma2 * k2 / A2, (1.0 - gamma2) * k2 / A3, (1.0 - gamma1) * k1 / A4
    sqrt = math.sqrt

    def slopes(
        h1: float, h2: float, h3: float, h4: float, f1: float, f2: float
    ) -> tuple[float, float, float, float, float, float]:
        q1 = c1 * sqrt(h1) if h1 > 0.0 else 0.0
        q2 = c2 * sqrt(h2) if h2 > 0.0 else 0.0
        q3 = c3 * sqrt(h3) if h3 > 0.0 else 0.0
        q4 = c4 * sqrt(h4) if h4 > 0.0 else 0.0
        return r31 * q3 - q1 + b1 * f1, r42 * q4 - q2 + b2 * f2, b3 * f2 - q3, b4 * f1 - q4, q1, q2

    return slopes


def _leaking_slopes_of(settings: EmulatorSettings, effects: Effects) -> Slopes:
    """As `slopes_of`, for tanks with leaks: the leaked water is counted as outflow."""
    tight = slopes_of(settings, replace(effects, leak=[0.0] * 4))
    A1, A2, A3, A4 = areas_cm2 = settings.tanks.area_cm2
    speed = math.sqrt(2.0 * settings.tanks.gravity_cm_s2)
    holes = zip(effects.leak, settings.tanks.outlet_cm2, areas_cm2, strict=True)
    c1, c2, c3, c4 = (share * a * speed / area_cm2 for share, a, area_cm2 in holes)
    r31, r42 = A3 / A1, A4 / A2
    sqrt = math.sqrt

    def slopes(
        h1: float, h2: float, h3: float, h4: float, f1: float, f2: float
    ) -> tuple[float, float, float, float, float, float]:
        s1, s2, s3, s4, q1, q2 = tight(h1, h2, h3, h4, f1, f2)
        l1 = c1 * sqrt(h1) if h1 > 0.0 else 0.0
        l2 = c2 * sqrt(h2) if h2 > 0.0 else 0.0
        l3 = c3 * sqrt(h3) if h3 > 0.0 else 0.0
        l4 = c4 * sqrt(h4) if h4 > 0.0 else 0.0
        return s1 - l1, s2 - l2, s3 - l3, s4 - l4, q1 + l1 + r31 * l3, q2 + l2 + r42 * l4

    return slopes


def _followed(dt_s: float, lag_s: float, flow_V: float, applied_V: float) -> tuple[float, float, float]:
    """Flow voltage of one pump at the start, middle and end of a step."""
    if lag_s <= 0.0:
        return applied_V, applied_V, applied_V
    half = math.exp(-0.5 * dt_s / lag_s)
    return flow_V, applied_V + (flow_V - applied_V) * half, applied_V + (flow_V - applied_V) * half * half


def _outlets_cm2(settings: EmulatorSettings, effects: Effects) -> tuple[float, ...]:
    outlets = zip(settings.tanks.outlet_cm2, effects.blocked, strict=True)
    return tuple(a * (1.0 - blocked) for a, blocked in outlets)


def _splits(settings: EmulatorSettings, effects: Effects) -> tuple[float, float]:
    (own1, own2), (new1, new2) = settings.pumps.valve_split, effects.valve_split
    return own1 if new1 is None else new1.of(own1), own2 if new2 is None else new2.of(own2)


class Tanks:
    """Levels, flow voltages and volume counters; starts in the equilibrium of start_V, pumps at rest."""

    def __init__(self, settings: EmulatorSettings) -> None:
        self._settings = settings
        self._slopes = slopes_of(settings, Effects())
        self._area_cm2 = settings.tanks.area_cm2
        self._height_cm = settings.tanks.height_cm
        self._gain = settings.pumps.gain_cm3_Vs
        self._lags_s = self._own_lags_s = parts(settings.pumps.lag_s, 2)
        self.levels_cm = equilibrium_cm(settings)
        self.flow_V = (0.0, 0.0)
        self.pumped_cm3 = 0.0
        self.drained_cm3 = 0.0
        self.spilled_cm3 = 0.0
        self.stirred_cm3 = 0.0

    @property
    def contents_cm3(self) -> float:
        """Water in all four tanks."""
        return sum(area * level for area, level in zip(self._area_cm2, self.levels_cm, strict=True))

    def apply_effects(self, effects: Effects) -> None:
        """Use the leaks, blocked outlets, valve splits and lags of these effects from now on."""
        self._slopes = slopes_of(self._settings, effects)
        lags = zip(self._own_lags_s, effects.lag_s, strict=True)
        self._lags_s = tuple(own_s if new_s is None else new_s.of(own_s) for own_s, new_s in lags)

    def stir(self, volumes_cm3: list[float]) -> None:
        """Add a volume to each tank (negative: remove it), within 0 .. height."""
        top_cm = self._height_cm
        levels_cm = []
        for level_cm, area_cm2, volume_cm3 in zip(self.levels_cm, self._area_cm2, volumes_cm3, strict=True):
            levels_cm.append(min(max(level_cm + volume_cm3 / area_cm2, 0.0), top_cm))
            self.stirred_cm3 += (levels_cm[-1] - level_cm) * area_cm2
        h1, h2, h3, h4 = levels_cm
        self.levels_cm = (h1, h2, h3, h4)

    def copy(self) -> "Tanks":
        """Return a second plant in the same state, which consists of immutable values."""
        return copy(self)

    def advance(self, dt_s: float, applied_V: tuple[float, float], effectiveness: list[float]) -> None:
        """Advance by dt_s with constant inputs, in equal steps of at most 20 ms."""
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
        is_inside = min(h1, h2, h3, h4) >= 0.0 and max(h1, h2, h3, h4) <= self._height_cm
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
        A1, A2, A3, A4 = self._area_cm2
        if h3 < 0.0:
            h1, h3 = h1 + h3 * A3 / A1, 0.0
        if h4 < 0.0:
            h2, h4 = h2 + h4 * A4 / A2, 0.0
        if h1 < 0.0:
            self.drained_cm3, h1 = self.drained_cm3 + h1 * A1, 0.0
        if h2 < 0.0:
            self.drained_cm3, h2 = self.drained_cm3 + h2 * A2, 0.0
        top_cm = self._height_cm
        for level_cm, area_cm2 in ((h1, A1), (h2, A2), (h3, A3), (h4, A4)):
            if level_cm > top_cm:
                self.spilled_cm3 += (level_cm - top_cm) * area_cm2
        return min(h1, top_cm), min(h2, top_cm), min(h3, top_cm), min(h4, top_cm)
