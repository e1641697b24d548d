"""Linear model predictive control, free of offset, with pump gains from the diagnosis.

At each step the drives w_0 ... w_{N-1} of N coming intervals minimise

    sum of l_k |y_k - y_s|^2  +  rho sum of |w_k - w_{k-1}|^2,       0 <= w <= theta v_max

over the linear model at the target; l_k is the length of interval k, y_k the outputs at its end, w_{-1} what the pumps
have now. The first w_0 is given. Textbook: J. B. Rawlings, D. Q. Mayne and M. M. Diehl, Model Predictive Control, Nob
Hill 2017. Unknown inflows and the steady state that they leave: see `disturbance_observer`.

Ours: intervals that grow by a constant factor, so that few of them reach far; pump gains theta by the diagnosis in
model and limits; after MANUAL the difference to the operator's drives fades within TAKEOVER_S.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np
from scipy.linalg import expm

from hil.core.control_law import Authority, LawInputs, LawRequest
from hil.core.laws.disturbance_observer import Disturbed, begin, disturbed_rest, observe
from hil.core.laws.law_plant import (
    TAKEOVER_S,
    LawPlant,
    SteadyAim,
    change_events,
    known_effectiveness,
    pump_drives,
    steady_aim,
)
from hil.core.laws.quadratic_program import require_solver, solve_qp
from hil.core.reconfiguration import MIN_LINEARISED_CM
from hil.core.tanks import Array, linearise
from hil.core.types import Pair, Quad

MIN_LAG_S = 0.02
"""Shorter lags of the pumps are those of the model's."""


@dataclass(frozen=True, eq=False)
class Horizon:
    """Outputs at the ends of N intervals: Y (2N,) = free @ z + forced @ W, in V.

    z : (6,) levels and lagged drives less those of the target. W : (2N,) drives less those of the target.
    length_s : (N,). tracking : (2N, 2N) of the outputs in the Hessian. tracking_z : (2N, 6) of z in the gradient.
    moves : (2N, 2N) of the changes of drive.
    """

    free: Array
    forced: Array
    length_s: Array
    tracking: Array
    tracking_z: Array
    moves: Array


@dataclass(frozen=True, slots=True)
class PredictiveMemory:
    """seen : levels and inflows. offset_V : (2,) what is left of the difference to an operator's drives, effective."""

    seen: Disturbed
    aim: SteadyAim
    aim_for: tuple[Pair, Pair]
    horizon: Horizon
    offset_V: Pair


@dataclass(frozen=True, slots=True)
class PredictiveControl:
    """horizon_s, intervals : how far, and in how many pieces, the first of first_s. move_weight : rho, s.

    observer_s : see `disturbance_observer`. use_diagnosis : whether theta is that of the diagnosis. has_fixed_model :
    whether the model stays that of the start, or of what puts another one into the memory. Raises MissingSolverError
    where DAQP is not installed.
    """

    plant: LawPlant
    horizon_s: float
    move_weight: float
    observer_s: float
    intervals: int = 14
    first_s: float = 0.2
    use_diagnosis: bool = True
    has_fixed_model: bool = False

    def __post_init__(self) -> None:
        require_solver()

    def start(self, inputs: LawInputs) -> PredictiveMemory:
        """Levels as read; nothing else is carried over."""
        theta = known_effectiveness(inputs.followed, self.use_diagnosis)
        aim = steady_aim(self.plant, inputs.reference_V, theta)
        seen = begin(inputs.level_cm, inputs.given_V)
        return PredictiveMemory(seen, aim, (inputs.reference_V, theta), self.horizon(aim.level_cm), (0.0, 0.0))

    def step(self, memory: PredictiveMemory, inputs: LawInputs) -> tuple[PredictiveMemory, LawRequest]:
        """One step: observe, find the steady state, optimise, give the first drives."""
        return self.step_with(memory, inputs, self.move_weight)

    def step_with(
        self, memory: PredictiveMemory, inputs: LawInputs, move_weight: float
    ) -> tuple[PredictiveMemory, LawRequest]:
        """One step with another weight of the moves."""
        theta = known_effectiveness(inputs.followed, self.use_diagnosis)
        aim, horizon = memory.aim, memory.horizon
        if memory.aim_for != (inputs.reference_V, theta):
            aim = steady_aim(self.plant, inputs.reference_V, theta)
            if aim.level_cm != memory.aim.level_cm and not self.has_fixed_model:
                horizon = self.horizon(aim.level_cm)
        seen = observe(
            self.plant, memory.seen, inputs.level_cm, inputs.given_V, theta, inputs.period_s, self.observer_s
        )
        effective_V = self._optimal(horizon, seen, aim, inputs.given_V, theta, move_weight)
        fading = exp(-inputs.period_s / TAKEOVER_S)
        offset = (memory.offset_V[0] * fading, memory.offset_V[1] * fading)
        if inputs.authority is Authority.OPERATOR:
            (t1, t2), (v1, v2) = aim.effectiveness, inputs.given_V
            offset = (t1 * v1 - effective_V[0], t2 * v2 - effective_V[1])
        drive_V = pump_drives(aim, (effective_V[0] + offset[0], effective_V[1] + offset[1]))
        d1, d2, d3, d4 = seen.inflow_cm_s
        shown = {"inflow_1_cm_s": d1, "inflow_2_cm_s": d2, "inflow_3_cm_s": d3, "inflow_4_cm_s": d4}
        request = LawRequest(drive_V, aim.target_V, aim.reason, shown=shown, events=change_events(memory.aim, aim))
        return PredictiveMemory(seen, aim, (inputs.reference_V, theta), horizon, offset), request

    def horizon(self, level_cm: Quad) -> Horizon:
        """Predictions around a steady state, by the linear model there with the lag of the pumps."""
        h1, h2, h3, h4 = (max(level, MIN_LINEARISED_CM) for level in level_cm)
        linear = linearise(self.plant.model, (h1, h2, h3, h4))
        rate = np.diag([1.0 / max(lag, MIN_LAG_S) for lag in self.plant.lag_s])
        A = np.block([[linear.A, linear.B], [np.zeros((2, 4)), -rate]])
        B = np.vstack([np.zeros((4, 2)), rate])
        C = np.hstack([linear.C, np.zeros((2, 2))])
        lengths = interval_lengths(self.horizon_s, self.intervals, self.first_s)
        N = self.intervals
        state, input_, free, forced = np.eye(6), np.zeros((6, 2 * N)), [], []
        for k, length in enumerate(lengths):
            both = expm(length * np.block([[A, B], [np.zeros((2, 8))]]))
            state, input_ = both[:6, :6] @ state, both[:6, :6] @ input_
            input_[:, 2 * k : 2 * k + 2] += both[:6, 6:]
            free.append(C @ state)
            forced.append(C @ input_)
        F, G = np.vstack(free), np.vstack(forced)
        weighted = G.T * np.repeat(lengths, 2)
        change = np.eye(2 * N) - np.eye(2 * N, k=-2)
        return Horizon(F, G, lengths, weighted @ G, weighted @ F, change.T @ change)

    def _optimal(
        self, horizon: Horizon, seen: Disturbed, aim: SteadyAim, given_V: Pair, theta: Pair, move_weight: float
    ) -> Pair:
        """(2,) the effective drives of the first interval."""
        plant, k = self.plant, self.plant.model.level_gain_V_cm
        limit = np.array(theta) * np.array(plant.limit_V)
        wanted_cm = (max(aim.target_V[0] / k, 0.0), max(aim.target_V[1] / k, 0.0))
        levels, held = disturbed_rest(plant, seen, wanted_cm, (float(limit[0]), float(limit[1])))
        lagged = np.array(theta) * np.array(seen.lagged_V)
        z = np.concatenate([np.array(seen.level_cm) - levels, lagged - held])
        before = np.array(theta) * np.array(given_V) - held
        H = horizon.tracking + move_weight * horizon.moves + 1e-6 * np.eye(2 * self.intervals)
        f = horizon.tracking_z @ z
        f[:2] -= move_weight * before
        low, high = -np.tile(held, self.intervals), np.tile(limit - held, self.intervals)
        step = np.array(theta) * plant.rate_V_s * plant.period_s
        low[:2] = np.minimum(np.maximum(low[:2], before - step), high[:2])
        high[:2] = np.maximum(np.minimum(high[:2], before + step), low[:2])
        W = solve_qp(H, f, low, high)
        first = np.clip(before if W is None else W[:2], low[:2], high[:2]) + held
        return float(first[0]), float(first[1])


def interval_lengths(horizon_s: float, intervals: int, first_s: float) -> Array:
    """(N,) lengths that grow by a constant factor from first_s and add up to horizon_s."""
    low, high = 1.0, 3.0
    for _ in range(60):
        middle = (low + high) / 2.0
        total = first_s * sum(middle**k for k in range(intervals))
        low, high = (middle, high) if total < horizon_s else (low, middle)
    lengths = np.array([first_s * high**k for k in range(intervals)])
    return np.array(lengths * (horizon_s / float(lengths.sum())))
