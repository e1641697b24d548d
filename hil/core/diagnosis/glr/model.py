"""The process as the diagnosis models it: the layout of the filter's state, and its prediction over one control period.

State, N = 33 numbers; the constants below are the index of the first number of each group:

    h   4  levels, cm                        k    2  pump gains over the rig file's, 1 when nominal
    p   2  drives behind the pump lag, V     g    2  valve splits, likewise
    tau 2  pump lags, likewise               a    4  outlet areas, likewise
    leak 2  tanks 3, 4: outflow to the floor over what the outlet passes on
    b   4  sensor biases, V                  d    4  sensor drifts, V/s
    r   1  rate at which one of k, g, a or leak grows, 1/s, see `growth`
    z   2  dead zones of the pumps, V          c    2  bend of the pumps' curves, 1/V

Levels follow eq. (1) of Hajiani and Poshtan (2012), see `hil.core.tanks`; p' = (f(v) - p)/(lag_s tau) with
f(v) = x (1 + c x), x = v - z, 0 below the dead zone; b' = d. All voltages of pumps are drives, see `hil.core.pumps`,
and all of sensors level signals, see `hil.core.sensors`. Parameters
vary as slow random walks. Leaks, biases, drifts and the rate have zero variance, and so stay 0, until a fault
hypothesis gives them some; a leak of tank 1 or 2 is a wider outlet, by the very same equations.

The transition matrix is the identity but for its first six rows, which are kept as A (MOVING, N), and the drifts'
effect on the biases.
"""

from __future__ import annotations

from math import erf, exp, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.core.diagnosis.glr.compiled import compiled

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

N = 33
LEVEL, PUMP, GAIN, SPLIT, LAG, OUTLET, LEAK, BIAS, DRIFT, RATE = 0, 4, 6, 8, 10, 12, 16, 18, 22, 26
ZONE, BEND, SCALE = 27, 29, 31

MOVING = 6
"""Levels and lagged voltages: the states whose rows of the transition matrix are not the identity's."""

SHALLOW_CM = 0.05
"""Below this level sqrt(h) is not linearised any more."""


class FilterModel(NamedTuple):
    """The rig file's numbers as the compiled functions need them.

    area_cm2 : (4,). outlet_flow : (4,) a_i sqrt(2 g), so that outflow = outlet_flow sqrt(h + datum), cm3/s.
    pump_gain_cm3_Vs : (2,). valve_split : (2,). walk : (N,) variance that each state gains in a control period; 0 for
    the levels, whose walk is learned. lag_s : (2,) of each pump. height_cm, datum_cm : (4,) of each tank.
    """

    area_cm2: Array
    outlet_flow: Array
    pump_gain_cm3_Vs: Array
    valve_split: Array
    walk: Array
    lag_s: Array
    level_gain_V_cm: float
    height_cm: Array
    datum_cm: Array


SHARP_V, NEAR_STDS = 1e-6, 5.0
"""A dead zone ends in a corner if its end is known so well, or if the voltage is so many standard deviations away."""


class MeanPumps(NamedTuple):
    """The lagged flow voltages, mean of a period: (2,) V each; their derivatives by p, tau, z and c at its start."""

    voltage_V: Array
    by_p: Array
    by_lag: Array
    by_zone: Array
    by_bend: Array


@compiled
def predict(model: FilterModel, x: Array, zone_std_V: Array, voltage_V: Array, dt: float, A: Array) -> None:
    """Move the state on by one period, and linearise that.

    x : (N,), changed in place. zone_std_V : (2,) of the dead zones, see `flow_voltage`. voltage_V : (2,) applied during
    the period. dt : s. A : (MOVING, N), written.
    """
    A[:, :] = 0.0
    mean = MeanPumps(np.empty(2), np.empty(2), np.empty(2), np.empty(2), np.empty(2))
    _predict_pumps(model, x, zone_std_V, voltage_V, dt, A, mean)
    outflow, slope = np.empty(4), np.empty(4)
    for i in range(4):
        h = max(x[LEVEL + i], 0.0) + model.datum_cm[i]
        outflow[i] = model.outlet_flow[i] * np.sqrt(h)
        slope[i] = 0.5 * model.outlet_flow[i] / np.sqrt(max(h, SHALLOW_CM))
    # midpoint rule for the levels, derivatives at the start of the period
    rate, passed = np.empty(4), np.empty(2)
    for j in range(2):
        passed[j] = _limit_outflow(model, x, mean.voltage_V, dt, outflow, j)
    _level_rates(model, x, mean.voltage_V, outflow, rate)
    _linearise(model, x, dt, A, outflow, slope, mean, passed)
    for i in range(4):
        h = max(x[LEVEL + i] + 0.5 * dt * rate[i], 0.0) + model.datum_cm[i]
        outflow[i] = model.outlet_flow[i] * np.sqrt(h)
    for j in range(2):
        _limit_outflow(model, x, mean.voltage_V, dt, outflow, j)
    _level_rates(model, x, mean.voltage_V, outflow, rate)
    for i in range(4):
        x[LEVEL + i] = min(max(x[LEVEL + i] + dt * rate[i], 0.0), model.height_cm[i])
        x[BIAS + i] += dt * x[DRIFT + i]


@compiled
def _predict_pumps(
    model: FilterModel, x: Array, zone_std_V: Array, voltage_V: Array, dt: float, A: Array, mean: MeanPumps
) -> None:
    """The pump lag, exact over the period; writes the arrays of `mean`."""
    for j in range(2):
        tau = model.lag_s[j] * x[LAG + j]
        decay = np.exp(-dt / tau)
        share = (1.0 - decay) * tau / dt
        flow_V, by_zone, by_bend = flow_voltage(x, j, voltage_V[j], zone_std_V[j])
        gap = x[PUMP + j] - flow_V
        mean.voltage_V[j] = flow_V + gap * share
        mean.by_p[j] = share
        mean.by_lag[j] = gap * model.lag_s[j] * ((1.0 - decay) / dt - decay / tau)
        mean.by_zone[j], mean.by_bend[j] = by_zone * (1.0 - share), by_bend * (1.0 - share)
        x[PUMP + j] = flow_V + gap * decay
        A[PUMP + j, PUMP + j] = decay
        A[PUMP + j, ZONE + j], A[PUMP + j, BEND + j] = by_zone * (1.0 - decay), by_bend * (1.0 - decay)
        A[PUMP + j, LAG + j] = gap * decay * dt / (tau * tau) * model.lag_s[j]


@compiled
def flow_voltage(x: Array, pump: int, voltage_V: float, zone_std_V: float) -> tuple[float, float, float]:
    """The voltage of a straight pump without dead zone that gives as much, V; its derivatives by z and by c.

    x : (N,) state. pump : 0 or 1. voltage_V : what is applied for long. zone_std_V : standard deviation of the dead
    zone. While that may end on either side of the voltage, the mean of what is above it counts, and the derivative of
    this mean (statistical linearisation): a pump that gives nothing says that its dead zone is longer, not how long.
    """
    if voltage_V <= 0.0:
        return 0.0, 0.0, 0.0
    over = voltage_V - x[ZONE + pump]
    at = over / max(zone_std_V, SHARP_V)
    if abs(at) < NEAR_STDS:
        gives = 0.5 * (1.0 + erf(at / sqrt(2.0)))
        over = over * gives + zone_std_V * exp(-0.5 * at * at) / sqrt(2.0 * pi)
    else:
        gives = 1.0 if over > 0.0 else 0.0
        over = max(over, 0.0)
    bend = x[BEND + pump]
    return over * (1.0 + bend * over), -gives * (1.0 + 2.0 * bend * over), over * over


@compiled
def _level_rates(model: FilterModel, x: Array, mean_V: Array, outflow: Array, rate: Array) -> None:
    """Eq. (1). outflow : (4,) of clean outlets, cm3/s. rate : (4,) cm/s, written."""
    area, gain, split = model.area_cm2, model.pump_gain_cm3_Vs, model.valve_split
    q1, q2 = gain[0] * x[GAIN] * x[SCALE] * mean_V[0], gain[1] * x[GAIN + 1] * x[SCALE + 1] * mean_V[1]
    g1, g2 = split[0] * x[SPLIT], split[1] * x[SPLIT + 1]
    o1, o2 = x[OUTLET] * outflow[0], x[OUTLET + 1] * outflow[1]
    o3, o4 = x[OUTLET + 2] * outflow[2], x[OUTLET + 3] * outflow[3]
    rate[0] = (o3 - o1 + g1 * q1) / area[0]
    rate[1] = (o4 - o2 + g2 * q2) / area[1]
    rate[2] = ((1.0 - g2) * q2 - o3 - x[LEAK] * outflow[2]) / area[2]
    rate[3] = ((1.0 - g1) * q1 - o4 - x[LEAK + 1] * outflow[3]) / area[3]


@compiled
def _limit_outflow(model: FilterModel, x: Array, mean_V: Array, dt: float, outflow: Array, j: int) -> float:
    """Limit what leaves the upper tank that pump j feeds, if it is empty at the end of the period, to what flows in.

    That is so only with a datum, which draws water out of an empty tank. outflow : (4,) of clean outlets, changed.
    Returns the share of the pump's water that the tank below gets, 0 if the tank is not empty.
    """
    i = 3 - j
    if model.datum_cm[i] <= 0.0:
        return 0.0
    outlet, leak = max(x[OUTLET + i], 0.0), max(x[LEAK + i - 2], 0.0)
    wanted = (outlet + leak) * outflow[i]
    inflow = (1.0 - model.valve_split[j] * x[SPLIT + j]) * model.pump_gain_cm3_Vs[j] * x[GAIN + j] * mean_V[j]
    if wanted <= max(inflow, 0.0) + model.area_cm2[i] * max(x[LEVEL + i], 0.0) / dt:
        return 0.0
    outflow[i] *= max(inflow, 0.0) / wanted
    return float(outlet / (outlet + leak))


@compiled
def _linearise(
    model: FilterModel, x: Array, dt: float, A: Array, outflow: Array, slope: Array, mean: MeanPumps, passed: Array
) -> None:
    """Rows of the levels. passed : (2,) by pump, of `_limit_outflow`; what it passes on changes the tank below."""
    for j in range(2):
        if passed[j] > 0.0:
            outflow[3 - j] = slope[3 - j] = 0.0
    _linearise_outflows(model, x, dt, A, outflow, slope)
    _linearise_inflows(model, x, dt, A, mean)
    for j in range(2):
        i = 3 - j
        if passed[j] > 0.0:
            for state in (PUMP + j, LAG + j, GAIN + j, SPLIT + j):
                A[i - 2, state] += passed[j] * model.area_cm2[i] / model.area_cm2[i - 2] * A[i, state]
                A[i, state] = 0.0


@compiled
def _linearise_outflows(model: FilterModel, x: Array, dt: float, A: Array, outflow: Array, slope: Array) -> None:
    """Rows of the levels, 1 + dt d(rate)/dx: by levels, outlets and leaks. slope : (4,) d(outflow)/dh."""
    for i in range(4):
        over = dt / model.area_cm2[i]
        own = x[OUTLET + i] + (x[LEAK + i - 2] if i >= 2 else 0.0)
        A[i, i] = 1.0 - over * own * slope[i]
        A[i, OUTLET + i] = -over * outflow[i]
    for lower in range(2):
        upper = lower + 2
        over = dt / model.area_cm2[lower]
        A[lower, upper] = over * x[OUTLET + upper] * slope[upper]
        A[lower, OUTLET + upper] = over * outflow[upper]
        A[upper, LEAK + lower] = -dt / model.area_cm2[upper] * outflow[upper]


@compiled
def _linearise_inflows(model: FilterModel, x: Array, dt: float, A: Array, mean: MeanPumps) -> None:
    """Rows of the levels: by lagged voltages, lags, gains and splits."""
    for j in range(2):
        split, gain = model.valve_split[j] * x[SPLIT + j], x[GAIN + j] * x[SCALE + j]
        far = 3 - j
        for i, share, sign in ((j, split, 1.0), (far, 1.0 - split, -1.0)):
            flow = dt / model.area_cm2[i] * model.pump_gain_cm3_Vs[j]
            A[i, PUMP + j] = flow * share * gain * mean.by_p[j]
            A[i, LAG + j] = flow * share * gain * mean.by_lag[j]
            A[i, GAIN + j] = flow * share * x[SCALE + j] * mean.voltage_V[j]
            A[i, SCALE + j] = flow * share * x[GAIN + j] * mean.voltage_V[j]
            A[i, ZONE + j] = flow * share * gain * mean.by_zone[j]
            A[i, BEND + j] = flow * share * gain * mean.by_bend[j]
            A[i, SPLIT + j] = sign * flow * model.valve_split[j] * gain * mean.voltage_V[j]
