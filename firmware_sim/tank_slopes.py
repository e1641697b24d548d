"""Eq. (1) of Hajiani and Poshtan (2012) as a function of levels and flow voltages; see `firmware_sim.tanks`."""

import math
from collections.abc import Callable
from dataclasses import replace

from firmware_sim.faults.effects import Effects
from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings

Slopes = Callable[[float, float, float, float, float, float], tuple[float, float, float, float, float, float]]


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
    """As `slopes_of`, for outlets and leaks at a datum below the zero of their tanks.

    At level h the water leaves a tank with the head h + datum; an empty tank lets out no more than flows in, through
    outlet and leak in proportion to their areas.
    """
    A1, A2, A3, A4 = settings.tanks.area_cm2
    d1, d2, d3, d4 = parts(settings.tanks.datum_cm, 4)
    speed = math.sqrt(2.0 * settings.tanks.gravity_cm_s2)
    open_cm2 = _outlets_cm2(settings, effects)
    holes_cm2 = [share * a for share, a in zip(effects.leak, settings.tanks.outlet_cm2, strict=True)]
    both_cm2 = [a + hole for a, hole in zip(open_cm2, holes_cm2, strict=True)]
    c1, c2, c3, c4 = (both * speed / A for both, A in zip(both_cm2, settings.tanks.area_cm2, strict=True))
    kept3, kept4 = (open_cm2[at] / both_cm2[at] if both_cm2[at] > 0.0 else 0.0 for at in (2, 3))
    r31, r42 = A3 / A1, A4 / A2
    (k1, k2), (gamma1, gamma2) = settings.pumps.gain_cm3_Vs, _splits(settings, effects)
    b1, b2, b3, b4 = gamma1 * k1 / A1, gamma2 * k2 / A2, (1.0 - gamma2) * k2 / A3, (1.0 - gamma1) * k1 / A4
    sqrt = math.sqrt

    def slopes(
        h1: float, h2: float, h3: float, h4: float, f1: float, f2: float
    ) -> tuple[float, float, float, float, float, float]:
        i3, i4 = b3 * f2, b4 * f1
        q3 = c3 * sqrt(h3 + d3) if h3 > 0.0 else min(c3 * sqrt(d3), i3)
        q4 = c4 * sqrt(h4 + d4) if h4 > 0.0 else min(c4 * sqrt(d4), i4)
        i1, i2 = r31 * kept3 * q3 + b1 * f1, r42 * kept4 * q4 + b2 * f2
        q1 = c1 * sqrt(h1 + d1) if h1 > 0.0 else min(c1 * sqrt(d1), i1)
        q2 = c2 * sqrt(h2 + d2) if h2 > 0.0 else min(c2 * sqrt(d2), i2)
        out1, out2 = q1 + r31 * (1.0 - kept3) * q3, q2 + r42 * (1.0 - kept4) * q4
        return i1 - q1, i2 - q2, i3 - q3, i4 - q4, out1, out2

    return slopes


def _outlets_cm2(settings: EmulatorSettings, effects: Effects) -> tuple[float, ...]:
    outlets = zip(settings.tanks.outlet_cm2, effects.blocked, strict=True)
    return tuple(a * (1.0 - blocked) for a, blocked in outlets)


def _splits(settings: EmulatorSettings, effects: Effects) -> tuple[float, float]:
    (own1, own2), (new1, new2) = settings.pumps.valve_split, effects.valve_split
    return own1 if new1 is None else new1.of(own1), own2 if new2 is None else new2.of(own2)
