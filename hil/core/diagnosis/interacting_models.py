"""An interacting-multiple-model filter over the gains of the pumps.

H. A. P. Blom and Y. Bar-Shalom, The interacting multiple model algorithm for systems with Markovian switching
coefficients, IEEE Trans. Automatic Control 33(8), 1988. A mode for each pair of gains from GAINS; each has an extended
Kalman filter of the four levels, driven by the flows of its gains. The mean gains of the modes, by their probabilities,
go to `gain_alarms`.

Ours: the modes, and the process noise, which stands for what rig and file differ in.

What it can't do: gains between those of GAINS come out near the next one; a sensor that fails, a leak and a blocked
outlet are taken for a pump, or for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from hil.core.diagnosis.dedicated_observers import MAX_PERIOD_S, mean_of, readings_cm
from hil.core.diagnosis.gain_alarms import HEALTHY_PUMPS, GainAlarms, judge
from hil.core.estimator import Estimate
from hil.core.tanks import Array, TankModel, pump_matrix
from hil.core.types import Diagnosis, Measurement, Pair

GAINS = (1.0, 0.75, 0.5, 0.25, 0.0)
MODES = np.array(list(product(GAINS, GAINS)))
"""(25, 2) gains of both pumps in each mode, the healthy mode first."""

MIN_LEVEL_CM = 0.05
"""Lower limit of the levels in the linearisation."""

MIN_PROBABILITY = 1e-12


@dataclass(frozen=True, eq=False)
class ModesMemory:
    """probability : (25,). level_cm : (25, 4). covariance_cm2 : (25, 4, 4). After t_s; lagged_V : (2,) drives then."""

    t_s: float | None = None
    probability: Array = field(default_factory=lambda: np.eye(1, len(MODES))[0])
    level_cm: Array = field(default_factory=lambda: np.zeros((len(MODES), 4)))
    covariance_cm2: Array = field(default_factory=lambda: np.zeros((len(MODES), 4, 4)))
    lagged_V: Pair = (0.0, 0.0)
    alarms: GainAlarms = HEALTHY_PUMPS


@dataclass(frozen=True, slots=True)
class InteractingModels:
    """noise_V : of a step's readings. walk_cm_sqrt_s : process noise of each level. sojourn_s : mean time in a mode."""

    model: TankModel
    noise_V: float
    walk_cm_sqrt_s: float = 0.02
    sojourn_s: float = 200.0

    def start(self) -> ModesMemory:
        """Healthy pumps, nothing seen yet."""
        return ModesMemory()

    def step(
        self, memory: ModesMemory, t_s: float, measurement: Measurement, estimate: Estimate, applied_V: Pair
    ) -> tuple[ModesMemory, Diagnosis]:
        """Mix, filter each mode, weigh the modes; then judge the mean gains."""
        readings = readings_cm(self.model, measurement)
        if readings is None:
            return memory, Diagnosis(effectiveness=memory.alarms.told)
        variance = (self.noise_V / self.model.level_gain_V_cm) ** 2
        y, n = np.array(readings), len(MODES)
        if memory.t_s is None or t_s - memory.t_s > MAX_PERIOD_S:
            fresh = ModesMemory(
                t_s, memory.probability, np.tile(y, (n, 1)), np.tile(variance * np.eye(4), (n, 1, 1)),
                estimate.pump_V, memory.alarms,
            )  # fmt: skip
            return fresh, Diagnosis(effectiveness=memory.alarms.told)
        period_s = t_s - memory.t_s
        predicted, x, P = self._mixed(memory, period_s)
        x, P = self._predicted(x, P, mean_of(memory.lagged_V, estimate.pump_V), period_s)
        S = P + variance * np.eye(4)
        innovation = y - x
        weighted = np.linalg.solve(S, innovation[:, :, None])[:, :, 0]
        x = x + np.einsum("mij,mj->mi", P, weighted)
        P = P - P @ np.linalg.solve(S, P)
        exponent = -0.5 * np.einsum("mi,mi->m", innovation, weighted) - 0.5 * np.linalg.slogdet(S)[1]
        probability = predicted * np.exp(exponent - exponent.max())
        probability = np.maximum(probability / probability.sum(), MIN_PROBABILITY)
        probability /= probability.sum()
        mean = probability @ MODES
        std = np.sqrt(probability @ (MODES - mean) ** 2)
        alarms, diagnosis = judge(memory.alarms, t_s, mean.tolist(), std.tolist())
        return ModesMemory(t_s, probability, x, P, estimate.pump_V, alarms), diagnosis

    def _mixed(self, memory: ModesMemory, period_s: float) -> tuple[Array, Array, Array]:
        """Predicted probabilities (25,), and mixed levels and covariances: each mode goes to any other alike."""
        n = len(MODES)
        leave = period_s / self.sojourn_s
        transition = np.full((n, n), leave / (n - 1))
        np.fill_diagonal(transition, 1.0 - leave)
        predicted = memory.probability @ transition
        share = memory.probability[:, None] * transition / predicted
        x = share.T @ memory.level_cm
        apart = memory.level_cm[:, None, :] - x[None, :, :]
        P = np.einsum("ij,iab->jab", share, memory.covariance_cm2)
        P += np.einsum("ij,ija,ijb->jab", share, apart, apart)
        return predicted, x, P

    def _predicted(self, x: Array, P: Array, drive_V: Pair, period_s: float) -> tuple[Array, Array]:
        """Levels and covariances a period later: Euler's rule on eq. (1), and its derivative."""
        model = self.model
        A, a, datum = np.array(model.area_cm2), np.array(model.outlet_cm2), np.array(model.datum_cm)
        head = np.maximum(x, MIN_LEVEL_CM) + datum
        out = a * np.sqrt(2.0 * model.gravity_cm_s2 * head) * (x > 0.0)
        inflow = (MODES * drive_V) @ pump_matrix(model).T
        inflow[:, 0] += model.arriving[0] * out[:, 2]
        inflow[:, 1] += model.arriving[1] * out[:, 3]
        decay = out / (2.0 * head)
        F = np.zeros((len(MODES), 4, 4))
        for tank in range(4):
            F[:, tank, tank] = 1.0 - period_s * decay[:, tank] / A[tank]
        F[:, 0, 2] = period_s * model.arriving[0] * decay[:, 2] / A[0]
        F[:, 1, 3] = period_s * model.arriving[1] * decay[:, 3] / A[1]
        x = np.maximum(x + period_s * (inflow - out) / A, 0.0)
        return x, F @ P @ np.swapaxes(F, 1, 2) + period_s * self.walk_cm_sqrt_s**2 * np.eye(4)
