"""The equations of the plant on plain numbers; `firmware_sim.tanks` says what they mean.

The emulator calls these functions, and `firmware_sim.fmu` translates them into the C of a co-simulation unit, so that
both have one source. They use only what `firmware_sim.fmu.c_from_python` knows: assignments, arithmetic, `if`, min,
max, sqrt, exp and each other. The letters are those of eq. (1) of Hajiani and Poshtan (2012).
"""

from collections.abc import Callable
from math import exp, sqrt

Slopes = Callable[[float, float, float, float, float, float], tuple[float, float, float, float, float, float]]
Six = tuple[float, float, float, float, float, float]
Seven = tuple[float, float, float, float, float, float, float]
Twelve = tuple[float, float, float, float, float, float, float, float, float, float, float, float]


def flow_voltage(applied_V: float, dead_zone_V: float, curve_1_V: float) -> float:
    """Flow of a pump in the steady state, divided by its gain, in V: the voltage itself for a straight pump."""
    x = max(0.0, applied_V - dead_zone_V)
    return x * (1.0 + curve_1_V * x)


def left_by_wear(wear_per_h: float, run_h: float) -> float:
    """Share of its gain as new that a pump has after run_h hours."""
    return max(0.0, 1.0 - wear_per_h * run_h)


def followed(dt_s: float, lag_s: float, flow_V: float, applied_V: float) -> tuple[float, float, float]:
    """Flow voltage of one pump at the start, middle and end of a step: w = v + (w0 - v) exp(-t / lag)."""
    if lag_s <= 0.0:
        return applied_V, applied_V, applied_V
    half = exp(-0.5 * dt_s / lag_s)
    return flow_V, applied_V + (flow_V - applied_V) * half, applied_V + (flow_V - applied_V) * half * half


# fmt: off
def coefficients(
    A1: float, A2: float, A3: float, A4: float,
    a1: float, a2: float, a3: float, a4: float,
    blocked1: float, blocked2: float, blocked3: float, blocked4: float,
    leak1: float, leak2: float, leak3: float, leak4: float,
    gravity: float, k1: float, k2: float, gamma1: float, gamma2: float,
) -> Twelve:
    """Those of `slopes_with`, from areas and outlets in cm2, shares blocked and leaking, gains and splits of pumps."""
    speed = sqrt(2.0 * gravity)
    open3, open4 = a3 * (1.0 - blocked3), a4 * (1.0 - blocked4)
    both1, both2 = a1 * (1.0 - blocked1) + leak1 * a1, a2 * (1.0 - blocked2) + leak2 * a2
    both3, both4 = open3 + leak3 * a3, open4 + leak4 * a4
    kept3 = open3 / both3 if both3 > 0.0 else 0.0
    kept4 = open4 / both4 if both4 > 0.0 else 0.0
    c1, c2, c3, c4 = both1 * speed / A1, both2 * speed / A2, both3 * speed / A3, both4 * speed / A4
    b1, b2, b3, b4 = gamma1 * k1 / A1, gamma2 * k2 / A2, (1.0 - gamma2) * k2 / A3, (1.0 - gamma1) * k1 / A4
    return c1, c2, c3, c4, b1, b2, b3, b4, A3 / A1, A4 / A2, kept3, kept4


def slopes_with(
    c1: float, c2: float, c3: float, c4: float, b1: float, b2: float, b3: float, b4: float,
    r31: float, r42: float, kept3: float, kept4: float, d1: float, d2: float, d3: float, d4: float,
) -> Slopes:
    """Eq. (1) with leaks and outlets at a datum d below the zero of their tanks.

    At level h the water leaves a tank with the head h + d; an empty tank lets out no more than flows in, through outlet
    and leak in proportion to their areas. kept3, kept4 : share of the outflow of an upper tank that reaches the lower
    one. See `firmware_sim.tank_slopes` for arguments and results of the function.
    """
    def slopes(h1: float, h2: float, h3: float, h4: float, f1: float, f2: float) -> Six:
        i3, i4 = b3 * f2, b4 * f1
        q3 = c3 * sqrt(h3 + d3) if h3 > 0.0 else min(c3 * sqrt(d3), i3)
        q4 = c4 * sqrt(h4 + d4) if h4 > 0.0 else min(c4 * sqrt(d4), i4)
        i1, i2 = r31 * kept3 * q3 + b1 * f1, r42 * kept4 * q4 + b2 * f2
        q1 = c1 * sqrt(h1 + d1) if h1 > 0.0 else min(c1 * sqrt(d1), i1)
        q2 = c2 * sqrt(h2 + d2) if h2 > 0.0 else min(c2 * sqrt(d2), i2)
        out1, out2 = q1 + r31 * (1.0 - kept3) * q3, q2 + r42 * (1.0 - kept4) * q4
        return i1 - q1, i2 - q2, i3 - q3, i4 - q4, out1, out2

    return slopes


def runge_kutta(
    slopes: Slopes, dt_s: float, h1: float, h2: float, h3: float, h4: float,
    start1: float, start2: float, middle1: float, middle2: float, end1: float, end2: float,
) -> Six:
    """Levels after one classical Runge-Kutta step, not bounded, and the outflows of both sides over A1 and A2, in cm.

    start1 .. end2 : flow voltage times effectiveness of both pumps at the start, middle and end of the step.
    """
    half_s, sixth_s = 0.5 * dt_s, dt_s / 6.0
    a1, a2, a3, a4, p1, p2 = slopes(h1, h2, h3, h4, start1, start2)
    b1, b2, b3, b4, q1, q2 = slopes(
        h1 + half_s * a1, h2 + half_s * a2, h3 + half_s * a3, h4 + half_s * a4, middle1, middle2
    )
    c1, c2, c3, c4, r1, r2 = slopes(
        h1 + half_s * b1, h2 + half_s * b2, h3 + half_s * b3, h4 + half_s * b4, middle1, middle2
    )
    d1, d2, d3, d4, s1, s2 = slopes(h1 + dt_s * c1, h2 + dt_s * c2, h3 + dt_s * c3, h4 + dt_s * c4, end1, end2)
    return (
        h1 + sixth_s * (a1 + 2.0 * (b1 + c1) + d1),
        h2 + sixth_s * (a2 + 2.0 * (b2 + c2) + d2),
        h3 + sixth_s * (a3 + 2.0 * (b3 + c3) + d3),
        h4 + sixth_s * (a4 + 2.0 * (b4 + c4) + d4),
        sixth_s * (p1 + 2.0 * (q1 + r1) + s1),
        sixth_s * (p2 + 2.0 * (q2 + r2) + s2),
    )


def pumped(
    dt_s: float, k1: float, k2: float,
    start1: float, start2: float, middle1: float, middle2: float, end1: float, end2: float,
) -> float:
    """Volume that both pumps move in one step, in cm3; start1 .. end2 as for `runge_kutta`."""
    return dt_s / 6.0 * (k1 * (start1 + 4.0 * middle1 + end1) + k2 * (start2 + 4.0 * middle2 + end2))


def bounded(
    h1: float, h2: float, h3: float, h4: float, A1: float, A2: float, A3: float, A4: float,
    t1: float, t2: float, t3: float, t4: float, share3: float, share4: float,
) -> Seven:
    """Levels within 0 .. t, the heights, and the volumes in cm3 that this adds to drained, spilled and caught.

    Water above a rim spills, the shares of tanks 3 and 4 into the tank below; outflow that an empty tank did not have
    is taken back.
    """
    drained = 0.0
    if h3 < 0.0:
        h1, h3 = h1 + h3 * A3 / A1, 0.0
    if h4 < 0.0:
        h2, h4 = h2 + h4 * A4 / A2, 0.0
    if h1 < 0.0:
        drained, h1 = drained + h1 * A1, 0.0
    if h2 < 0.0:
        drained, h2 = drained + h2 * A2, 0.0
    caught3, caught4 = share3 * max(h3 - t3, 0.0) * A3, share4 * max(h4 - t4, 0.0) * A4
    h1, h2 = h1 + caught3 / A1, h2 + caught4 / A2
    spilled = max(h1 - t1, 0.0) * A1 + max(h2 - t2, 0.0) * A2 + max(h3 - t3, 0.0) * A3 + max(h4 - t4, 0.0) * A4
    return min(h1, t1), min(h2, t2), min(h3, t3), min(h4, t4), drained, spilled, caught3 + caught4
# fmt: on
