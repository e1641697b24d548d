"""The paper's state feedback with integral action, with gains that are computed again for what the diagnosis finds.

Its memory has the integrals. They are advanced at the beginning of a step, when it is known what the pumps were given
for the last one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from hil.core import state_feedback
from hil.core.control_law import Authority, FeedbackRecord, LawInputs, LawRequest
from hil.core.following import HEALTHY
from hil.core.gain_design import closed_loop_poles, gain_matrix
from hil.core.reconfiguration import FAILURES, MIN_LINEARISED_CM, Reconfiguration
from hil.core.start_phase import StartPhase
from hil.core.state_feedback import StateFeedback
from hil.core.tanks import TankModel, equilibrium, linearise, nearest_reachable
from hil.core.types import Event, Pair, Quad, Severity, Waterways

Task = tuple[Pair, Pair, Pair | None, Waterways | None]
"""Reference, effectiveness, valve splits and waterways that a state feedback is computed for."""


@dataclass(frozen=True, slots=True)
class FeedbackMemory:
    """What the law remembers between two steps.

    feedback : in force at the last step. base : the same, as it is at the end of a start phase. task : what it was
    computed for. integral_Vs, level_cm : integrals and levels of the last step. waterways : those followed then.
    """

    feedback: StateFeedback
    base: StateFeedback
    task: Task
    integral_Vs: Pair
    level_cm: Quad
    waterways: Waterways | None = None


@dataclass(frozen=True)
class StateFeedbackLaw:
    """Configuration: how gains and operating points are found, the control period, and the time of the anti-windup.

    anti_windup_s : see `state_feedback.advance_integral`.
    """

    reconfiguration: Reconfiguration
    period_s: float
    anti_windup_s: float

    @property
    def model(self) -> TankModel:
        """The tanks as in the rig file."""
        return self.reconfiguration.model

    def start(self, inputs: LawInputs) -> FeedbackMemory:
        """From pumps at rest the integrals start at zero: v0 plus the feedback on x, within the rate limit.

        Pumps that already run are taken over bumplessly, at the drives they have.
        """
        task = _task(inputs)
        base = self.reconfiguration.law(*task)
        feedback = self._moved(inputs.references.start, base, inputs.t_s)
        integral = (0.0, 0.0)
        if inputs.given_V != (0.0, 0.0):
            integral = state_feedback.bumpless_integral(feedback, inputs.level_cm, inputs.given_V)
        return FeedbackMemory(feedback, base, task, integral, inputs.level_cm, inputs.followed.waterways)

    def step(self, memory: FeedbackMemory, inputs: LawInputs) -> tuple[FeedbackMemory, LawRequest]:
        """The drives wanted. A change of gains or operating point is bumpless."""
        integral, level_cm = self.advanced(memory, inputs), inputs.level_cm
        base, task = memory.base, _task(inputs)
        if task != memory.task:
            base = self.reconfiguration.law(*task)
        feedback = self._moved(inputs.references.start, base, inputs.t_s)
        if base is not memory.base:
            effective = state_feedback.effective_voltage(memory.feedback, integral, level_cm)
            integral = state_feedback.bumpless_integral(feedback, level_cm, effective)
            ways = self._newly_identified(memory, inputs)
            if ways is not None and not feedback.problem:
                integral = self.reconfiguration.settling_integral(feedback, ways, level_cm)
        effective_V = state_feedback.effective_voltage(feedback, integral, level_cm)
        new = FeedbackMemory(feedback, base, task, integral, level_cm, inputs.followed.waterways)
        return new, LawRequest(
            drive_V=state_feedback.pump_voltage(feedback, effective_V),
            target_V=feedback.target_V,
            reason=feedback.reason,
            problem=feedback.problem,
            events=_events(memory, new, inputs),
            feedback=FeedbackRecord(feedback.operating_V, integral, feedback.pump_gain),
        )

    def advanced(self, memory: FeedbackMemory, inputs: LawInputs) -> Pair:
        """The integrals (2,) after the last step, from what the pumps were given for it.

        In MANUAL they follow the operator's drives, so that the return to AUTO is bumpless.
        """
        feedback, integral, level_cm = memory.feedback, memory.integral_Vs, memory.level_cm
        if inputs.authority is Authority.NOBODY:
            return integral
        if inputs.authority is Authority.OPERATOR:
            (theta1, theta2), (drive1, drive2) = feedback.effectiveness, inputs.given_V
            return state_feedback.bumpless_integral(feedback, level_cm, (theta1 * drive1, theta2 * drive2))
        k, (h1, h2, _, _) = self.model.level_gain_V_cm, level_cm
        error = (feedback.target_V[0] - k * h1, feedback.target_V[1] - k * h2)
        excess = inputs.excess_V
        if feedback.standby_V != (None, None):
            effective = state_feedback.effective_voltage(feedback, integral, level_cm)
            excess = state_feedback.undelivered(feedback, effective, excess)
        return state_feedback.advance_integral(feedback, integral, error, excess, self.period_s, self.anti_windup_s)

    def check(self, reference_V: Pair) -> None:
        """There is a feedback for the reference, and it stabilises the rig with healthy pumps.

        Raises ValueError, ArithmeticError or LinAlgError that say why not.
        """
        try:
            slowest = self._slowest_pole(reference_V)
        except FAILURES:
            raise
        except Exception as error:
            raise ValueError(f"the design fails with {type(error).__name__}: {error}") from error
        if not slowest.real < 0.0:
            raise ValueError(
                "the design's gain does not stabilise this rig: "
                f"its slowest closed-loop pole lies at {slowest.real:+.4g} 1/s, it must be negative"
            )

    def _slowest_pole(self, reference_V: Pair) -> complex:
        """Of the closed loop with healthy pumps where they come nearest to the reference, 1/s."""
        rule, k = self.reconfiguration, self.model.level_gain_V_cm
        gains = rule.law(reference_V, HEALTHY).gains
        reached = nearest_reachable(rule.model, (reference_V[0] / k, reference_V[1] / k), rule.limit_V)
        v1, v2 = (max(voltage, 0.0) for voltage in reached.holding_V)
        h1, h2, h3, h4 = (max(level_cm, MIN_LINEARISED_CM) for level_cm in equilibrium(rule.model, (v1, v2)))
        linear = linearise(rule.model, (h1, h2, h3, h4))
        return complex(closed_loop_poles(linear, gain_matrix(gains))[0])

    def _newly_identified(self, memory: FeedbackMemory, inputs: LawInputs) -> Waterways | None:
        """The waterways if the operating point has just become theirs: the integrals then have nothing to correct."""
        new = inputs.followed.waterways
        return new if self.reconfiguration.design.follows_reference and new is not memory.waterways else None

    def _moved(self, phase: StartPhase | None, base: StateFeedback, t_s: float) -> StateFeedback:
        """The feedback with target and operating point of this moment of a start phase; after its ramp, as it is."""
        if phase is None or phase.is_past_ramp(t_s):
            return base
        k, (y1, y2), (r1, r2) = self.model.level_gain_V_cm, phase.toward(t_s, base.target_V), base.target_V
        now_V, end_V = phase.drives(self.model, t_s, base.target_V)
        (_, _, now3, now4), (_, _, end3, end4) = equilibrium(self.model, now_V), equilibrium(self.model, end_V)
        h1, h2, h3, h4 = base.operating_level_cm
        return replace(
            base,
            operating_level_cm=(h1 + (y1 - r1) / k, h2 + (y2 - r2) / k, h3 + now3 - end3, h4 + now4 - end4),
            operating_V=(
                base.operating_V[0] + now_V[0] - end_V[0],
                base.operating_V[1] + now_V[1] - end_V[1],
            ),
            target_V=(y1, y2),
        )


def _task(inputs: LawInputs) -> Task:
    followed = inputs.followed
    return inputs.requested_V, followed.effectiveness, followed.valve_split, followed.waterways


def _events(old: FeedbackMemory, new: FeedbackMemory, inputs: LawInputs) -> tuple[Event, ...]:
    if new.base is old.base and inputs.period_s > 0.0:
        return ()
    events: list[Event] = []
    if new.feedback.effectiveness != old.feedback.effectiveness:
        e1, e2 = new.feedback.effectiveness
        text = f"gains recomputed for effectiveness {e1:.3f}, {e2:.3f}"
        events.append(Event(Severity.INFO, "reconfigured", text, {"effectiveness": [e1, e2]}))
    if new.feedback.reason:
        (r1, r2), reason = new.base.target_V, new.feedback.reason
        text = f"reference can't be reached ({reason}): aiming at {r1:.4f}, {r2:.4f} V"
        events.append(Event(Severity.WARNING, "target", text, {"target_V": [r1, r2], "reason": reason}))
    return tuple(events)
