"""The four-tank process: K. H. Johansson's quadruple tank (IEEE Trans. Control Systems Technology 8(3), 2000).

State h = (h1, h2, h3, h4), levels in cm: tanks 1 and 2 below, 3 above 1, 4 above 2. Input v = (v1, v2), pump
voltages in V; for a pump with a curve its drive, see `hil.core.pumps`. Outputs y1, y2: level signals k_c h1, k_c h2 in
V, see `hil.core.sensors`. Hajiani and Poshtan (2012), eq. (1):

    A1 h1' = -a1 sqrt(2 g h1) + a3 sqrt(2 g h3) +     g1 k1 v1
    A2 h2' = -a2 sqrt(2 g h2) + a4 sqrt(2 g h4) +     g2 k2 v2
    A3 h3' = -a3 sqrt(2 g h3)                   + (1-g2) k2 v2
    A4 h4' = -a4 sqrt(2 g h4)                   + (1-g1) k1 v1

g1, g2 are the valve splits. A pump with effectiveness theta_j moves theta_j k_j v_j; nothing else changes. Where an
outlet, or the end of its hose, lies d_i below the zero of its tank (the datum), h_i + d_i takes the place of h_i as
long as there is water; an empty tank lets out no more than flows in. Where tank 3 or 4 leaks, a share of its outflow
arrives below (`arriving`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.core.types import Pair, Quad

Array = NDArray[np.float64]

NO_DATUM: Quad = (0.0, 0.0, 0.0, 0.0)
"""Every outlet lies at the zero of its tank."""


@dataclass(frozen=True, slots=True)
class TankModel:
    """Parameters of eq. (1), tables 1 and 2 of the paper.

    area_cm2, outlet_cm2 : (4,) A_i and a_i. pump_gain_cm3_Vs : (2,) k_j. valve_split : (2,) gamma_j in (0, 1).
    level_gain_V_cm : k_c of the level signals. height_cm : (4,) of the rims. gravity_cm_s2 : g. datum_cm : (4,) d_i.
    arriving : (2,) share of the outflow of tanks 3 and 4 that arrives in tanks 1 and 2. outlet_flow : (4,)
    a_i sqrt(2 g), from the others: it is needed several times at every step.
    """

    area_cm2: Quad = (28.0, 32.0, 28.0, 32.0)
    outlet_cm2: Quad = (0.071, 0.057, 0.071, 0.057)
    pump_gain_cm3_Vs: Pair = (3.33, 3.35)
    valve_split: Pair = (0.70, 0.60)
    level_gain_V_cm: float = 0.5
    height_cm: Quad = (20.0, 20.0, 20.0, 20.0)
    gravity_cm_s2: float = 981.0
    datum_cm: Quad = (0.0, 0.0, 0.0, 0.0)
    arriving: Pair = (1.0, 1.0)
    outlet_flow: Quad = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        (a1, a2, a3, a4), s = self.outlet_cm2, sqrt(2.0 * self.gravity_cm_s2)
        object.__setattr__(self, "outlet_flow", (a1 * s, a2 * s, a3 * s, a4 * s))


@dataclass(frozen=True, eq=False)
class LinearModel:
    """x' = A x + B u, y = C x around a point; x in cm, u and y in V.

    A : (4, 4) in 1/s. B : (4, 2) in cm/(V s). C : (2, 4) in V/cm.
    """

    A: Array
    B: Array
    C: Array

    def __post_init__(self) -> None:
        for name in ("A", "B", "C"):
            matrix = np.array(getattr(self, name), dtype=float)
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)


def pump_matrix(model: TankModel) -> Array:
    """(4, 2) flow into each tank per volt at each pump, cm^3/(V s): the input terms of eq. (1) times A_i."""
    (k1, k2), (g1, g2) = model.pump_gain_cm3_Vs, model.valve_split
    return np.array([[g1 * k1, 0.0], [0.0, g2 * k2], [0.0, (1 - g2) * k2], [(1 - g1) * k1, 0.0]])


def level_rates(model: TankModel, level_cm: Quad, pump_V: Pair) -> Quad:
    """Eq. (1): dh/dt in cm/s. pump_V is the *effective* voltage theta_j v_j."""
    A1, A2, A3, A4 = model.area_cm2
    (k1, k2), (g1, g2) = model.pump_gain_cm3_Vs, model.valve_split
    q1, q2 = k1 * pump_V[0], k2 * pump_V[1]
    out1, out2, out3, out4 = outflows(model, level_cm, pump_V)
    return (
        (model.arriving[0] * out3 - out1 + g1 * q1) / A1,
        (model.arriving[1] * out4 - out2 + g2 * q2) / A2,
        ((1.0 - g2) * q2 - out3) / A3,
        ((1.0 - g1) * q1 - out4) / A4,
    )


def outflows(model: TankModel, level_cm: Quad, pump_V: Pair) -> Quad:
    """(4,) what flows out of each tank, cm^3/s; an empty one lets out what flows in, as far as its datum draws it."""
    f1, f2, f3, f4 = model.outlet_flow
    d1, d2, d3, d4 = model.datum_cm
    h1, h2, h3, h4 = level_cm
    if h1 > 0.0 and h2 > 0.0 and h3 > 0.0 and h4 > 0.0:
        return f1 * sqrt(h1 + d1), f2 * sqrt(h2 + d2), f3 * sqrt(h3 + d3), f4 * sqrt(h4 + d4)
    out3 = f3 * sqrt(h3 + d3) if h3 > 0.0 else 0.0
    out4 = f4 * sqrt(h4 + d4) if h4 > 0.0 else 0.0
    out1 = f1 * sqrt(h1 + d1) if h1 > 0.0 else 0.0
    out2 = f2 * sqrt(h2 + d2) if h2 > 0.0 else 0.0
    if model.datum_cm != NO_DATUM:
        (k1, k2), (g1, g2) = model.pump_gain_cm3_Vs, model.valve_split
        q1, q2 = k1 * pump_V[0], k2 * pump_V[1]
        if h3 <= 0.0:
            out3 = min(f3 * sqrt(d3), (1.0 - g2) * q2)
        if h4 <= 0.0:
            out4 = min(f4 * sqrt(d4), (1.0 - g1) * q1)
        if h1 <= 0.0:
            out1 = min(f1 * sqrt(d1), out3 + g1 * q1)
        if h2 <= 0.0:
            out2 = min(f2 * sqrt(d2), out4 + g2 * q2)
    return out1, out2, out3, out4


def clean_outflow(model: TankModel, tank: int, level_cm: float) -> float:
    """Flow out of a tank with water in it through its clean outlet, cm^3/s. tank : 0..3."""
    return model.outlet_flow[tank] * sqrt(level_cm + model.datum_cm[tank])


class WaterBalance(NamedTuple):
    """The water of all tanks between two steps, in cm^3/s, as the monitors of the interlocks use it.

    direct : (2,) what the pumps send to tanks 1 and 2, by the file. across : (2,) what they send to tanks 3 and 4.
    outflow : (4,) through clean outlets, at the later levels. growth : (4,) change of the volumes.
    """

    direct: Pair
    across: Pair
    outflow: Quad
    growth: Quad

    @property
    def lower_outflow(self) -> Pair:
        """(2,) what must have left tanks 1 and 2: what came from the pumps and from above, less what has stayed."""
        return (
            self.outflow[2] + self.direct[0] - self.growth[0],
            self.outflow[3] + self.direct[1] - self.growth[1],
        )

    @property
    def upper_inflow(self) -> Pair:
        """(2,) what must have come into tanks 3 and 4: what has left, and what has stayed."""
        return self.outflow[2] + self.growth[2], self.outflow[3] + self.growth[3]


def water_balance(model: TankModel, before_cm: Quad, level_cm: Quad, pump_V: Pair, period_s: float) -> WaterBalance:
    """The balance of a period of period_s > 0 from the levels before and after. pump_V : (2,) effective drives."""
    (g1, g2), (k1, k2) = model.valve_split, model.pump_gain_cm3_Vs
    q1, q2 = k1 * pump_V[0], k2 * pump_V[1]
    h1, h2, h3, h4 = level_cm
    b1, b2, b3, b4 = before_cm
    A1, A2, A3, A4 = model.area_cm2
    return WaterBalance(
        direct=(g1 * q1, g2 * q2),
        across=((1.0 - g2) * q2, (1.0 - g1) * q1),
        outflow=outflows(model, level_cm, pump_V),
        growth=(
            A1 * (h1 - b1) / period_s,
            A2 * (h2 - b2) / period_s,
            A3 * (h3 - b3) / period_s,
            A4 * (h4 - b4) / period_s,
        ),
    )


def through_flow_matrix(model: TankModel) -> Array:
    """(4, 2) M with a_i sqrt(2 g (h_i + d_i)) = M v at rest: lower tanks pass on what the upper ones let through."""
    inflow, (part3, part4) = pump_matrix(model), model.arriving
    return np.array([inflow[0] + part3 * inflow[2], inflow[1] + part4 * inflow[3], inflow[2], inflow[3]])


def equilibrium(model: TankModel, pump_V: Pair) -> Quad:
    """Levels in cm at which constant effective pump voltages hold the tanks: eq. (1) with dh/dt = 0.

    A tank whose datum draws out more than flows in is empty. Raises ValueError for a negative voltage.
    """
    if min(pump_V) < 0.0:
        raise ValueError(f"pump voltages {pump_V} V: no equilibrium below 0 V")
    flow = through_flow_matrix(model) @ np.array(pump_V)
    heads_cm = (flow / np.array(model.outlet_cm2)) ** 2 / (2.0 * model.gravity_cm_s2)
    h1, h2, h3, h4 = np.maximum(heads_cm - np.array(model.datum_cm), 0.0).tolist()
    return (h1, h2, h3, h4)


def holding_voltages(model: TankModel, lower_cm: Pair) -> Pair:
    """Effective pump voltages in V that hold the two lower levels; negative where no real pump could.

    At rest the outflows of tanks 1, 2 are linear in v (two equations, two unknowns). Raises ValueError for a
    negative level or a singular valve setting (gamma1 + gamma2 = 1), at which the lower levels can't be set apart.
    """
    h1, h2 = lower_cm
    if h1 < 0.0 or h2 < 0.0:
        raise ValueError(f"lower levels {lower_cm} cm: below 0 cm")
    s = sqrt(2.0 * model.gravity_cm_s2)
    d1, d2 = model.datum_cm[:2]
    f1, f2 = model.outlet_cm2[0] * s * sqrt(h1 + d1), model.outlet_cm2[1] * s * sqrt(h2 + d2)
    (k1, k2), (g1, g2), (part3, part4) = model.pump_gain_cm3_Vs, model.valve_split, model.arriving
    split = g1 + g2 - 1.0
    if model.arriving != (1.0, 1.0):
        split = g1 * g2 - part3 * part4 * (1.0 - g1) * (1.0 - g2)
    if abs(split) < 1e-9:
        raise ValueError(f"valve splits {model.valve_split} add up to 1: the lower levels can't be set apart")
    return (g2 * f1 - part3 * (1.0 - g2) * f2) / (k1 * split), (g1 * f2 - part4 * (1.0 - g1) * f1) / (k2 * split)


def linearise(model: TankModel, level_cm: Quad) -> LinearModel:
    """Eq. (2) and (3) at any levels above 0 cm (ValueError otherwise): T_i = A_i/a_i sqrt(2 (h_i + d_i)/g)."""
    if min(level_cm) <= 0.0:
        raise ValueError(f"levels {level_cm} cm: an empty tank has no linear model")
    area = np.array(model.area_cm2)
    heads_cm = np.array(level_cm) + np.array(model.datum_cm)
    decay = np.array(model.outlet_cm2) / area * np.sqrt(model.gravity_cm_s2 / (2.0 * heads_cm))
    A = np.diag(-decay)
    A[0, 2] = area[2] / area[0] * decay[2] * model.arriving[0]
    A[1, 3] = area[3] / area[1] * decay[3] * model.arriving[1]
    C = np.zeros((2, 4))
    C[0, 0] = C[1, 1] = model.level_gain_V_cm
    return LinearModel(A, pump_matrix(model) / area[:, None], C)


def printed_linear_model() -> LinearModel:
    """Eq. (4) as printed, rounding and all; the calibrated design needs it to the digit."""
    A = np.diag([-0.0159, -0.0111, -0.0419, -0.0333])
    A[0, 2], A[1, 3] = 0.0419, 0.0333
    B = np.array([[0.0833, 0.0], [0.0, 0.0628], [0.0, 0.0479], [0.0312, 0.0]])
    C = np.array([[0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0]])
    return LinearModel(A, B, C)


def transmission_zeros(linear: LinearModel) -> Array:
    """(2,) zeros from u to y, sorted; real for every quadruple tank.

    With C = [c I, 0] and A, B of the four-tank shape, eliminating x1, x2 from the Rosenbrock pencil leaves
    the 2x2 matrix A22 - B2 B1^-1 A12 acting on the upper tanks: its eigenvalues are the zeros.
    """
    A, B = linear.A, linear.B
    pencil = A[2:, 2:] - B[2:] @ np.linalg.solve(B[:2], A[:2, 2:])
    return np.sort(np.linalg.eigvals(pencil).real)


def relative_gains(linear: LinearModel) -> Array:
    """(2, 2) RGA at rest, G(0) times the transpose of its inverse, element by element; rows outputs, columns pumps.

    Without unit; its size grows without limit towards gamma1 + gamma2 = 1. There G(0) has no inverse, and the entries
    are infinite. E. H. Bristol, IEEE Trans. Automatic Control 11(1), 1966.
    """
    G = linear.C @ np.linalg.solve(linear.A, linear.B)
    straight, crossed = float(G[0, 0] * G[1, 1]), float(G[0, 1] * G[1, 0])
    apart = straight - crossed
    first = straight / apart if apart != 0.0 else np.inf
    return np.array([[first, 1.0 - first], [1.0 - first, first]])
