"""Eq. (1) of Hajiani and Poshtan (2012) as a function of levels and flow voltages; see `firmware_sim.tanks`.

`firmware_sim.equations` has them in full; what is here is the same for simpler rigs, and quicker.
"""

import math
from dataclasses import replace

from firmware_sim.equations import Slopes, coefficients, slopes_with
from firmware_sim.faults.effects import Effects
from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings


def slopes_of(settings: EmulatorSettings, effects: Effects) -> Slopes:
    """Eq. (1) as a function (h1, h2, h3, h4, e1 w1, e2 w2) -> (h1', h2', h3', h4', outflow 1, outflow 2).

    All six results are in cm/s; the outflows are those of the lower tanks over their own areas, each with the leaks of
    its side.
    """
    if any(parts(settings.tanks.datum_cm, 4)):
        return _deep_slopes_of(settings, effects)
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


def _deep_slopes_of(settings: EmulatorSettings, effects: Effects) -> Slopes:
    """As `slopes_of`, for outlets and leaks at a datum below the zero of their tanks: the equations in full."""
    tanks, pumps = settings.tanks, settings.pumps
    s1, s2, s3, s4 = effects.blocked
    l1, l2, l3, l4 = effects.leak
    shares = (s1, s2, s3, s4, l1, l2, l3, l4)
    pump_side = (tanks.gravity_cm_s2, *pumps.gain_cm3_Vs, *_splits(settings, effects))
    return slopes_with(
        *coefficients(*tanks.area_cm2, *tanks.outlet_cm2, *shares, *pump_side), *parts(tanks.datum_cm, 4)
    )


def _outlets_cm2(settings: EmulatorSettings, effects: Effects) -> tuple[float, ...]:
    outlets = zip(settings.tanks.outlet_cm2, effects.blocked, strict=True)
    return tuple(a * (1.0 - blocked) for a, blocked in outlets)


def _splits(settings: EmulatorSettings, effects: Effects) -> tuple[float, float]:
    (own1, own2), (new1, new2) = settings.pumps.valve_split, effects.valve_split
    return own1 if new1 is None else new1.of(own1), own2 if new2 is None else new2.of(own2)
