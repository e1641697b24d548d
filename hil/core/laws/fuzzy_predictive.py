"""Predictive control with a fuzzy model and fuzzy weights.

The model is of the kind of T. Takagi and M. Sugeno, Fuzzy identification of systems and its applications to modeling
and control, IEEE Trans. Systems, Man, and Cybernetics 15(1), 1985: linear models at low, middle and high lower levels,
blended by how much the levels now belong to each. The weight of the moves follows four rules on error e and its change
in a second:

    e small, steady: calm        e small, moving: between        e large, steady: brisk        e large, moving: between

Ours: rules and sets (the paper that this project follows names predictive control with fuzzy logic for a three-tank
benchmark as a method, in one sentence), and everything that the law has in common with `predictive`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, log

import numpy as np

from hil.core.control_law import LawInputs, LawRequest
from hil.core.laws.predictive import Horizon, PredictiveControl, PredictiveMemory
from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Pair

LOCAL_DRIVES = (0.7, 1.0, 1.3)
"""Operating drives of the local models, low, middle and high, as shares of the rig's."""


@dataclass(frozen=True, slots=True)
class FuzzyMemory:
    """inner : of the predictive law. error_V : (2,) smoothed errors, of which the change is taken."""

    inner: PredictiveMemory
    error_V: Pair


@dataclass(frozen=True, slots=True)
class FuzzyPredictive:
    """calm_weight, brisk_weight : of the moves. large_V : an error that is large. fast_V_s : a change that is fast.

    control : the predictive law with everything else. local : its horizons at LOCAL_DRIVES.
    """

    control: PredictiveControl
    calm_weight: float
    brisk_weight: float
    large_V: float
    fast_V_s: float
    local: tuple[tuple[float, Horizon], ...]

    def start(self, inputs: LawInputs) -> FuzzyMemory:
        """As the predictive law."""
        return FuzzyMemory(self.control.start(inputs), _errors(self.control.plant.model, inputs))

    def step(self, memory: FuzzyMemory, inputs: LawInputs) -> tuple[FuzzyMemory, LawRequest]:
        """One step with the model and the weight of this moment."""
        e1, e2 = _errors(self.control.plant.model, inputs)
        share = 1.0 - exp(-inputs.period_s)
        d1, d2 = e1 - memory.error_V[0], e2 - memory.error_V[1]
        weight = self.weight(max(abs(e1), abs(e2)), max(abs(d1), abs(d2)))
        inner = replace(memory.inner, horizon=self.blended(sum(inputs.level_cm[:2]) / 2.0))
        inner, request = self.control.step_with(inner, inputs, weight)
        smoothed = (memory.error_V[0] + share * d1, memory.error_V[1] + share * d2)
        shown = {**request.shown, "move_weight": weight}
        return FuzzyMemory(inner, smoothed), replace(request, shown=shown)

    def weight(self, error_V: float, change_V_s: float) -> float:
        """The weight of the moves: the mean of the rules' weights, on a scale of logarithms, by how far each holds."""
        large, moving = min(error_V / self.large_V, 1.0), min(change_V_s / self.fast_V_s, 1.0)
        calm, brisk = log(self.calm_weight), log(self.brisk_weight)
        rules = (
            ((1.0 - large) * (1.0 - moving), calm),
            ((1.0 - large) * moving, (calm + brisk) / 2.0),
            (large * (1.0 - moving), brisk),
            (large * moving, (calm + brisk) / 2.0),
        )
        return exp(sum(holds * then for holds, then in rules))

    def blended(self, level_cm: float) -> Horizon:
        """The model at a mean lower level: of its two neighbours, by how near it is to each."""
        levels = [level for level, _ in self.local]
        upper = min(max(int(np.searchsorted(levels, level_cm)), 1), len(levels) - 1)
        (low_cm, low), (high_cm, high) = self.local[upper - 1], self.local[upper]
        m = min(max((level_cm - low_cm) / (high_cm - low_cm), 0.0), 1.0)
        F, G = (1.0 - m) * low.free + m * high.free, (1.0 - m) * low.forced + m * high.forced
        weighted = G.T * np.repeat(low.length_s, 2)
        return Horizon(F, G, low.length_s, weighted @ G, weighted @ F, low.moves)


def fuzzy_predictive(
    control: PredictiveControl, calm_weight: float, brisk_weight: float, large_V: float, fast_V_s: float
) -> FuzzyPredictive:
    """The law with its local models."""
    v1, v2 = control.plant.operating_V
    local = []
    for share in LOCAL_DRIVES:
        level_cm = equilibrium(control.plant.model, (share * v1, share * v2))
        local.append((sum(level_cm[:2]) / 2.0, control.horizon(level_cm)))
    return FuzzyPredictive(control, calm_weight, brisk_weight, large_V, fast_V_s, tuple(local))


def _errors(model: TankModel, inputs: LawInputs) -> Pair:
    k = model.level_gain_V_cm
    return inputs.reference_V[0] - k * inputs.level_cm[0], inputs.reference_V[1] - k * inputs.level_cm[1]
