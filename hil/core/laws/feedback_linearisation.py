"""Feedback linearisation of the lower levels, with a reference model.

Exact input-output linearisation (A. Isidori, Nonlinear Control Systems, Springer 1989). Each output has relative degree
one, and only pump i acts on y_i at once, so that

    v_i = (A_i n_i / k_c + out_i - out_above) / (gamma_i k_i)      gives      y_i' = n_i

The upper tanks are the zero dynamics. Their own levels do not come back to the flows that this asks for unless
gamma1 + gamma2 > 1: with less, they run away, and the law does not exist.

Ours: n = m' + a (m - y) + b integral of (m - y) around a reference model m' = c (r - m), which waits for pumps at their
limits; a and b from one pole a/2 taken twice, drives divided by the diagnosed effectiveness.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp

from hil.core.control_law import Authority, LawInputs, LawRequest
from hil.core.eigenstructure import DesignError
from hil.core.laws.law_plant import (
    TAKEOVER_S,
    LawPlant,
    SteadyAim,
    change_events,
    known_effectiveness,
    pump_drives,
    steady_aim,
)
from hil.core.tanks import outflows
from hil.core.types import Pair


@dataclass(frozen=True, slots=True)
class LinearisingMemory:
    """model_V : (2,) outputs m of the reference model. integral_V_s : (2,) b times the integral of m - y, V/s.

    offset_V : (2,) what is left of the difference to drives that were taken over, effective.
    """

    model_V: Pair
    integral_V_s: Pair
    aim: SteadyAim
    aim_for: tuple[Pair, Pair]
    offset_V: Pair = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class FeedbackLinearisation:
    """reference_1_s : c. feedback_1_s : a. use_diagnosis : whether drives are divided by diagnosed effectiveness.

    Raises DesignError for gamma1 + gamma2 <= 1.
    """

    plant: LawPlant
    reference_1_s: float
    feedback_1_s: float
    use_diagnosis: bool = True

    def __post_init__(self) -> None:
        if sum(self.plant.model.valve_split) <= 1.0:
            raise DesignError(
                "feedback linearisation needs gamma1 + gamma2 > 1: with valve splits of {:.3g} and {:.3g} the upper "
                "tanks, its zero dynamics, are unstable".format(*self.plant.model.valve_split)
            )

    def start(self, inputs: LawInputs) -> LinearisingMemory:
        """The reference model begins at the outputs; pumps that run are taken over."""
        theta = known_effectiveness(inputs.followed, self.use_diagnosis)
        aim = steady_aim(self.plant, inputs.reference_V, theta)
        memory = LinearisingMemory(self._outputs(inputs), (0.0, 0.0), aim, (inputs.reference_V, theta))
        return memory if inputs.given_V == (0.0, 0.0) else self._taken_over(memory, inputs)

    def step(self, memory: LinearisingMemory, inputs: LawInputs) -> tuple[LinearisingMemory, LawRequest]:
        """One step: the drives that give the rates n, within what the pumps have; the model moves as they do."""
        theta = known_effectiveness(inputs.followed, self.use_diagnosis)
        before = aim = memory.aim
        if memory.aim_for != (inputs.reference_V, theta):
            aim = steady_aim(self.plant, inputs.reference_V, theta)
        memory = replace(memory, aim=aim, aim_for=(inputs.reference_V, theta))
        if inputs.authority is Authority.OPERATOR:
            memory = self._taken_over(memory, inputs)
        asked = self._asked(memory, inputs)
        (v1, v2), (o1, o2) = self._drives(inputs, asked), memory.offset_V
        effective_V = (v1 + o1, v2 + o2)
        limits = (aim.effectiveness[0] * self.plant.limit_V[0], aim.effectiveness[1] * self.plant.limit_V[1])
        v1, v2 = (min(max(v, 0.0), limit) for v, limit in zip(effective_V, limits, strict=True))
        can = self._rates(inputs, (v1, v2))
        request = LawRequest(
            drive_V=pump_drives(aim, effective_V),
            target_V=aim.target_V,
            reason=aim.reason,
            events=change_events(before, aim),
            shown={"model_1_V": memory.model_V[0], "model_2_V": memory.model_V[1]},
        )
        return self._moved(memory, inputs, asked, can), request

    def _asked(self, memory: LinearisingMemory, inputs: LawInputs) -> Pair:
        """(2,) n in V/s."""
        first, second = (
            self.reference_1_s * (r - m) + self.feedback_1_s * (m - y) + integral
            for r, m, y, integral in zip(
                memory.aim.target_V, memory.model_V, self._outputs(inputs), memory.integral_V_s, strict=True
            )
        )
        return first, second

    def _moved(self, memory: LinearisingMemory, inputs: LawInputs, asked: Pair, can: Pair) -> LinearisingMemory:
        """Reference model and integrals after the coming period; the model does without what the pumps can't give."""
        T, b = self.plant.period_s, self.feedback_1_s**2 / 4.0
        m1, m2 = (
            m + T * (self.reference_1_s * (r - m) + possible - n)
            for m, r, n, possible in zip(memory.model_V, memory.aim.target_V, asked, can, strict=True)
        )
        i1, i2 = (
            i + b * T * (m - y)
            for i, m, y in zip(memory.integral_V_s, memory.model_V, self._outputs(inputs), strict=True)
        )
        fading = exp(-T / TAKEOVER_S)
        offset = (memory.offset_V[0] * fading, memory.offset_V[1] * fading)
        return replace(memory, model_V=(m1, m2), integral_V_s=(i1, i2), offset_V=offset)

    def _taken_over(self, memory: LinearisingMemory, inputs: LawInputs) -> LinearisingMemory:
        """The memory from which this law gives the drives that the pumps have; the model is at the outputs."""
        memory = replace(memory, model_V=self._outputs(inputs))
        (t1, t2), (v1, v2) = memory.aim.effectiveness, inputs.given_V
        wanted = self._drives(inputs, self._asked(memory, inputs))
        return replace(memory, offset_V=(t1 * v1 - wanted[0], t2 * v2 - wanted[1]))

    def _outputs(self, inputs: LawInputs) -> Pair:
        k = self.plant.model.level_gain_V_cm
        return k * inputs.level_cm[0], k * inputs.level_cm[1]

    def _drives(self, inputs: LawInputs, rate_V_s: Pair) -> Pair:
        """(2,) effective drives at which the outputs change at these rates, V/s."""
        model, (n1, n2) = self.plant.model, self._losses(inputs)
        (k1, k2), (g1, g2), kc = model.pump_gain_cm3_Vs, model.valve_split, model.level_gain_V_cm
        return (
            (model.area_cm2[0] * rate_V_s[0] / kc + n1) / (g1 * k1),
            (model.area_cm2[1] * rate_V_s[1] / kc + n2) / (g2 * k2),
        )

    def _rates(self, inputs: LawInputs, effective_V: Pair) -> Pair:
        """(2,) rates of the outputs in V/s at these effective drives."""
        model, (n1, n2) = self.plant.model, self._losses(inputs)
        (k1, k2), (g1, g2), kc = model.pump_gain_cm3_Vs, model.valve_split, model.level_gain_V_cm
        return (
            kc * (g1 * k1 * effective_V[0] - n1) / model.area_cm2[0],
            kc * (g2 * k2 * effective_V[1] - n2) / model.area_cm2[1],
        )

    def _losses(self, inputs: LawInputs) -> Pair:
        """(2,) what the lower tanks lose without pumps, cm^3/s."""
        model = self.plant.model
        h1, h2, h3, h4 = (max(level, 0.0) for level in inputs.level_cm)
        out1, out2, out3, out4 = outflows(model, (h1, h2, h3, h4), inputs.given_V)
        return out1 - model.arriving[0] * out3, out2 - model.arriving[1] * out4
