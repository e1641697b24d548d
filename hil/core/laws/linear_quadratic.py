"""Linear-quadratic state feedback with integral action.

The gain K of u = -K [h - h0; q], q' = r - y, minimises the integral of x'Qx + u'Ru: K = R^-1 B'P, where scipy solves
the Riccati equation for P. Textbook: K. J. Åström and R. M. Murray, Feedback Systems, Princeton University Press 2008:
it has a state feedback with integral action and the feedforward of the reference.

`reference_weight` is how much of a change of reference goes to the pumps at once, because the operating point moves;
the rest is left to the integrals (bumpless). That is ours, as are anti-windup, bumpless transfer and drives divided by
effectiveness, which this law has in common with the project's own: see `hil.core.state_feedback`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_are

from hil.core import state_feedback
from hil.core.control_law import Authority, FeedbackRecord, LawInputs, LawRequest
from hil.core.eigenstructure import DesignError, augment
from hil.core.following import HEALTHY
from hil.core.gain_design import Gains
from hil.core.laws.law_plant import change_events
from hil.core.reconfiguration import Reconfiguration
from hil.core.state_feedback import StateFeedback
from hil.core.tanks import LinearModel
from hil.core.types import Pair, Waterways


@dataclass(frozen=True, slots=True)
class LinearQuadraticDesign:
    """A `GainDesign`. Weights: lower levels, upper levels (1/cm^2), integrals (1/(V s)^2), drives (1/V^2)."""

    lower_weight: float
    upper_weight: float
    integral_weight: float
    drive_weight: float = 1.0
    follows_reference: bool = True

    def gains(self, linear: LinearModel) -> Gains:
        """The optimal gains at this operating point. Raises DesignError where there are none."""
        A, B = augment(linear)
        Q = np.diag([self.lower_weight] * 2 + [self.upper_weight] * 2 + [self.integral_weight] * 2)
        try:
            P = solve_continuous_are(A, B, Q, self.drive_weight * np.eye(2))
        except np.linalg.LinAlgError as error:
            raise DesignError(f"the Riccati equation has no stabilising solution here: {error}") from None
        return Gains.from_matrix(B.T @ P / self.drive_weight)


@dataclass(frozen=True, slots=True)
class WeightedMemory:
    """law : in force, for these references, effectiveness, splits and waterways. integral_Vs : (2,) q."""

    law: StateFeedback
    law_for: tuple[Pair, Pair, Pair | None, Waterways | None]
    integral_Vs: Pair


@dataclass(frozen=True, slots=True)
class WeightedFeedback:
    """State feedback with any gain design, and a reference that acts on the pumps with reference_weight (0 to 1).

    anti_windup_s : see `state_feedback.advance_integral`. use_diagnosis : whether pumps, splits and outlets found by
    the diagnosis are used.
    """

    reconfiguration: Reconfiguration
    period_s: float
    anti_windup_s: float
    reference_weight: float
    use_diagnosis: bool = True

    def start(self, inputs: LawInputs) -> WeightedMemory:
        """From pumps at rest with integrals of zero; otherwise from the drives that they have."""
        law_for = self._law_for(inputs, inputs.reference_V)
        memory = WeightedMemory(self.reconfiguration.law(*law_for), law_for, (0.0, 0.0))
        return memory if inputs.given_V == (0.0, 0.0) else taken_over(memory, inputs)

    def step(self, memory: WeightedMemory, inputs: LawInputs) -> tuple[WeightedMemory, LawRequest]:
        """One step towards the reference."""
        return self.step_to(memory, inputs, inputs.reference_V)

    def step_to(
        self, memory: WeightedMemory, inputs: LawInputs, reference_V: Pair
    ) -> tuple[WeightedMemory, LawRequest]:
        """One step towards a reference (2,) that need not be that of the run."""
        before = memory.law
        memory = self._changed(self._integrated(memory, inputs), inputs, reference_V)
        if inputs.authority is Authority.OPERATOR:
            memory = taken_over(memory, inputs)
        law, (q1, q2) = memory.law, memory.integral_Vs
        effective = state_feedback.effective_voltage(law, memory.integral_Vs, inputs.level_cm)
        drive_V = state_feedback.pump_voltage(law, effective)
        return memory, LawRequest(
            drive_V=drive_V,
            target_V=law.target_V,
            reason=law.reason,
            problem=law.problem,
            shown={"integral_1_Vs": q1, "integral_2_Vs": q2},
            events=change_events(before, law),
            feedback=FeedbackRecord(law.operating_V, (q1, q2), law.pump_gain),
        )

    def _law_for(self, inputs: LawInputs, reference_V: Pair) -> tuple[Pair, Pair, Pair | None, Waterways | None]:
        if not self.use_diagnosis:
            return reference_V, HEALTHY, None, None
        found = inputs.followed
        return reference_V, found.effectiveness, found.valve_split, found.waterways

    def _integrated(self, memory: WeightedMemory, inputs: LawInputs) -> WeightedMemory:
        """The integrals after the last period, with what the pumps were not given."""
        if inputs.period_s <= 0.0:
            return memory
        law, k = memory.law, self.reconfiguration.model.level_gain_V_cm
        error = (law.target_V[0] - k * inputs.level_cm[0], law.target_V[1] - k * inputs.level_cm[1])
        excess = inputs.excess_V
        if law.standby_V != (None, None):
            effective = state_feedback.effective_voltage(law, memory.integral_Vs, inputs.level_cm)
            excess = state_feedback.undelivered(law, effective, excess)
        integral = state_feedback.advance_integral(
            law, memory.integral_Vs, error, excess, inputs.period_s, self.anti_windup_s
        )
        return WeightedMemory(law, memory.law_for, integral)

    def _changed(self, memory: WeightedMemory, inputs: LawInputs, reference_V: Pair) -> WeightedMemory:
        """The law for what is wanted and known now; the integrals keep reference_weight of a change of reference."""
        law_for = self._law_for(inputs, reference_V)
        if law_for == memory.law_for:
            return memory
        law = self.reconfiguration.law(*law_for)
        effective = state_feedback.effective_voltage(memory.law, memory.integral_Vs, inputs.level_cm)
        (b1, b2), (q1, q2) = state_feedback.bumpless_integral(law, inputs.level_cm, effective), memory.integral_Vs
        w = self.reference_weight if law_for[0] != memory.law_for[0] else 0.0
        return WeightedMemory(law, law_for, (w * q1 + (1.0 - w) * b1, w * q2 + (1.0 - w) * b2))


def taken_over(memory: WeightedMemory, inputs: LawInputs) -> WeightedMemory:
    """The memory from which the law gives the drives that the pumps have."""
    (t1, t2), (v1, v2) = memory.law.effectiveness, inputs.given_V
    integral = state_feedback.bumpless_integral(memory.law, inputs.level_cm, (t1 * v1, t2 * v2))
    return WeightedMemory(memory.law, memory.law_for, integral)
