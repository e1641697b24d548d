"""The closed loop in continuous time, written independently from the equations: what a run must come close to.

Plant: Hajiani and Poshtan (2012), eq. (1). Controller: eq. (6), v = (v0 + u) / theta, u = -K_x x - K_q q, q' = r - y.
Everything below is numpy and scipy; nothing of it comes from the program under test. Between two instants at which
something changes (a reference, a fault, a report of the diagnosis) `solve_ivp` integrates ten states: four levels in
cm, q in V s, and the integrals of |r - y|.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

from tests.closed_loop.loop_experiment import Experiment

TOP_V = 10.0
ANTI_WINDUP_S = 5.0
NOISE_GAIN_MAX = 10.0
OUTPUT_POLES = (0.252, 0.184, 0.073, 0.06)

CALIBRATED_POLES = (-0.252, -0.184, -0.017, -0.057, -0.073, -0.021333918170845047)
CALIBRATED_ANGLES_RAD = (
    0.7827896734336633,
    0.7869097178449019,
    5.475128781964839,
    0.525534177130497,
    0.6564598272196864,
    2.9693515147784066,
)


@dataclass(frozen=True, eq=False)
class Plant:
    """Tables 1 and 2 of the paper."""

    area: Any = (28.0, 32.0, 28.0, 32.0)
    outlet: Any = (0.071, 0.057, 0.071, 0.057)
    k: Any = (3.33, 3.35)
    gamma: Any = (0.7, 0.6)
    kc: float = 0.5
    g: float = 981.0

    def inflow(self) -> Any:
        """(4, 2) cm^3/s into each tank per volt."""
        (k1, k2), (g1, g2) = self.k, self.gamma
        return np.array([[g1 * k1, 0.0], [0.0, g2 * k2], [0.0, (1 - g2) * k2], [(1 - g1) * k1, 0.0]])

    def rates(self, h: Any, v: Any) -> Any:
        """Eq. (1)."""
        out = np.array(self.outlet) * np.sqrt(2 * self.g * np.maximum(h, 0.0))
        net = self.inflow() @ v - out
        net[0] += out[2]
        net[1] += out[3]
        return net / np.array(self.area)

    def levels(self, v: Any) -> Any:
        """(4,) cm at rest."""
        inflow = self.inflow() @ np.asarray(v, dtype=float)
        inflow[0] += inflow[2]
        inflow[1] += inflow[3]
        return (inflow / np.array(self.outlet)) ** 2 / (2 * self.g)

    def voltages(self, h1: float, h2: float) -> Any:
        """(2,) V that hold the lower levels."""
        inflow = self.inflow()
        out = np.array(self.outlet[:2]) * np.sqrt(2 * self.g * np.array([h1, h2]))
        return np.linalg.solve(np.array([inflow[0] + inflow[2], inflow[1] + inflow[3]]), out)

    def jacobian(self, h: Any) -> tuple[Any, Any, Any]:
        """A, B, C around h by eq. (2), (3)."""
        decay = np.array(self.outlet) * np.sqrt(self.g / (2 * np.asarray(h)))
        flow = np.diag(-decay)
        flow[0, 2], flow[1, 3] = decay[2], decay[3]
        area = np.array(self.area)[:, None]
        return flow / area, self.inflow() / area, self.kc * np.eye(2, 4)


def calibrated_gain() -> Any:
    """(2, 6) K: w_i = (cos a_i, sin a_i), v_i = (A - l_i I)^-1 B w_i, K = W V^-1, with eq. (4) as printed."""
    A, B = np.zeros((6, 6)), np.zeros((6, 2))
    A[:4, :4] = np.diag([-0.0159, -0.0111, -0.0419, -0.0333])
    A[0, 2], A[1, 3] = 0.0419, 0.0333
    A[4, 0] = A[5, 1] = -0.5
    B[:4] = [[0.0833, 0.0], [0.0, 0.0628], [0.0, 0.0479], [0.0312, 0.0]]
    W = np.array([[np.cos(a), np.sin(a)] for a in CALIBRATED_ANGLES_RAD]).T
    V = np.column_stack([np.linalg.inv(A - p * np.eye(6)) @ B @ w for p, w in zip(CALIBRATED_POLES, W.T, strict=True)])
    return W @ np.linalg.inv(V)


def decoupling_gain(model: Plant, h: Any, poles: tuple[tuple[float, float], tuple[float, float]]) -> Any:
    """(2, 6) K of u = (C B)^-1 [-C A x - (a + b) y + a b q]: each output a second-order lag with poles -a, -b.

    C B is diagonal, so each pump looks after its own output.
    """
    A, B, C = model.jacobian(h)
    total, product = np.diag([a + b for a, b in poles]), np.diag([a * b for a, b in poles])
    return np.linalg.solve(C @ B, np.hstack([C @ A + total @ C, -product]))


def pole_pairs(model: Plant) -> tuple[tuple[float, float], tuple[float, float]]:
    """How the four poles are shared out at 3.00 V: best conditioned eigenvectors within the bound on noise gain."""
    h = model.levels((3.0, 3.0))
    A, B, C = model.jacobian(h)
    A6 = np.block([[A, np.zeros((4, 2))], [-C, np.zeros((2, 2))]])
    B6 = np.vstack([B, np.zeros((2, 2))])
    best, pairs = np.inf, None
    for i, j in combinations(range(4), 2):
        a, b = (OUTPUT_POLES[n] for n in range(4) if n not in (i, j))
        candidate = ((OUTPUT_POLES[i], OUTPUT_POLES[j]), (a, b))
        K = decoupling_gain(model, h, candidate)
        noise = np.linalg.norm(K[:, :4], axis=1).max() / model.kc
        condition = np.linalg.cond(np.linalg.eig(A6 - B6 @ K)[1])
        if noise <= NOISE_GAIN_MAX and condition < best:
            best, pairs = condition, candidate
    assert pairs is not None
    return pairs


@dataclass(frozen=True, eq=False)
class Law:
    """What the loop runs on between two changes. target : outputs aimed at, V."""

    K: Any
    h0: Any
    v0: Any
    target: Any
    theta: Any

    def effective(self, h: Any, q: Any) -> Any:
        """v0 + u."""
        return self.v0 - self.K[:, :4] @ (h - self.h0) - self.K[:, 4:] @ q

    def integral_for(self, h: Any, effective: Any) -> Any:
        """The q at which `effective` comes out."""
        return np.linalg.solve(self.K[:, 4:], self.v0 - self.K[:, :4] @ (h - self.h0) - effective)


class Reference:
    """The loop of one experiment. model : what the controller believes; truth : what the tanks are."""

    def __init__(self, experiment: Experiment, truth: Plant | None = None) -> None:
        self.experiment = experiment
        self.model = Plant()
        self.truth = truth or self.model
        self._pairs = pole_pairs(self.model)
        self._calibrated = calibrated_gain()

    def law(self, r: Any, theta: Any) -> Law:
        """The law for a reference in V and what is believed to be left of the pumps."""
        model = self.model
        wanted = np.asarray(r) / model.kc
        holding = model.voltages(*wanted)
        target = np.asarray(r)
        if np.any(holding > np.asarray(theta) * TOP_V + 1e-9) or np.any(holding < -1e-9):
            holding = self._nearest(wanted, np.asarray(theta) * TOP_V)
            target = model.kc * model.levels(holding)[:2]
        if self.experiment.design == "calibrated":
            v0 = np.array([3.0, 3.0])
            return Law(self._calibrated, model.levels(v0), v0, target, np.asarray(theta))
        h0 = model.levels(holding)
        return Law(decoupling_gain(model, h0, self._pairs), h0, holding, target, np.asarray(theta))

    def _nearest(self, wanted_cm: Any, limit_V: Any) -> Any:
        """Voltages within 0..limit that hold the lower levels nearest to the wanted ones, by search."""
        found = [
            minimize(
                lambda v: float(np.sum((self.model.levels(v)[:2] - wanted_cm) ** 2)),
                np.array(start) * limit_V,
                bounds=[(0.0, limit) for limit in limit_V],
                method="L-BFGS-B",
                options={"ftol": 1e-15, "gtol": 1e-12},
            )
            for start in ((0.5, 0.5), (0.9, 0.9), (0.1, 0.9), (0.9, 0.1))
        ]
        return min(found, key=lambda result: result.fun).x

    def window_iae(self) -> dict[str, tuple[float, float]]:
        """IAE in V s of every window of the experiment."""
        experiment = self.experiment
        changes = {0.0, experiment.duration_s} | {step.at_s for step in experiment.steps}
        for loss in experiment.losses:
            for at_s in (loss.at_s, loss.until_s):
                changes |= set() if at_s is None else {at_s, at_s + experiment.delay_s}
        changes |= {edge for _, *edges in experiment.windows for edge in edges}
        times = sorted(t for t in changes if t <= experiment.duration_s)
        h, q = self.truth.levels((3.0, 3.0)), np.zeros(2)
        law: Law | None = None
        law_for: tuple[Any, tuple[float, float]] | None = None
        integrals = {0.0: np.zeros(2)}
        iae = np.zeros(2)
        for start, end in pairwise(times):
            r = self._asked(start)
            believed = self._left(start - experiment.delay_s) if experiment.reconfigure else (1.0, 1.0)
            if law is None or (tuple(r), believed) != law_for:
                new = self.law(r, believed)
                if law is not None:
                    q = new.integral_for(h, law.effective(h, q))
                law, law_for = new, (tuple(r), believed)
            h, q, iae = self._integrate(law, r, np.array(self._left(start)), (start, end), h, q, iae)
            integrals[end] = iae
        return {name: tuple(integrals[to_s] - integrals[from_s]) for name, from_s, to_s in experiment.windows}

    def _asked(self, t: float) -> Any:
        r = self.model.kc * self.model.levels((3.0, 3.0))[:2]
        for step in self.experiment.steps:
            if step.at_s <= t:
                given = np.array(step.values)
                r = {"change_V": r + given, "levels_V": given, "levels_cm": self.model.kc * given}[step.kind]
        return r

    def _left(self, t: float) -> tuple[float, float]:
        left = [1.0, 1.0]
        for loss in self.experiment.losses:
            if loss.at_s <= t + 1e-9 and (loss.until_s is None or t + 1e-9 < loss.until_s):
                left[loss.target - 1] = loss.value
        return left[0], left[1]

    def _integrate(self, law: Law, r: Any, left: Any, span: tuple[float, float], h: Any, q: Any, iae: Any) -> Any:
        back = np.linalg.inv(law.K[:, 4:]) @ np.diag(law.theta) / ANTI_WINDUP_S

        def slopes(_: float, state: Any) -> Any:
            levels, integral = state[:4], state[4:6]
            y = self.truth.kc * levels[:2]
            wanted = law.effective(levels, integral) / law.theta
            v = np.clip(wanted, 0.0, TOP_V)
            return np.concatenate(
                [self.truth.rates(levels, left * v), law.target - y + back @ (wanted - v), np.abs(r - y)]
            )

        state = np.concatenate([h, q, iae])
        solution = solve_ivp(slopes, span, state, rtol=1e-8, atol=1e-10, max_step=1.0)
        assert solution.success, solution.message
        end = solution.y[:, -1]
        return end[:4], end[4:6], end[6:]


def plant_of(experiment: Experiment) -> Plant:
    """The true plant of a experiment whose [emulator] table changes its parameters."""
    names = {
        "tanks.area_cm2": "area",
        "tanks.outlet_cm2": "outlet",
        "pumps.gain_cm3_Vs": "k",
        "pumps.valve_split": "gamma",
    }
    return replace(Plant(), **{names[key]: value for key, value in experiment.emulator.items()})
