"""The paper's state feedback with integral action, with gains that are computed again for what the diagnosis finds.

Its memory has the integrals. They are advanced at the beginning of a step, when it is known what the pumps were given
for the last one. With feedforward the feedback acts on the deviation from a path that leads to the reference, see
`hil.core.laws.path_follower`, and the integrals integrate that deviation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import NamedTuple

from hil.core import state_feedback
from hil.core.control_law import Authority, FeedbackRecord, LawInputs, LawRequest
from hil.core.following import HEALTHY
from hil.core.gain_design import closed_loop_poles, gain_matrix
from hil.core.laws.path_follower import PathFollower, PathState, feedback_part, with_path
from hil.core.reachable import nearest_reachable
from hil.core.reconfiguration import FAILURES, MIN_LINEARISED_CM, Reconfiguration
from hil.core.start_phase import StartPhase
from hil.core.state_feedback import StateFeedback
from hil.core.tanks import TankModel, equilibrium, linearise
from hil.core.types import Event, Pair, Quad, Severity, Waterways

REGAIN_V = 0.25
"""On a ramp the gains are computed again each time that the reference has moved so far."""

SMOOTHED = 0.15
"""With a path, levels are fed back with this share of their difference to what the model predicts taken away: that much
less noise of the readings reaches the pumps. The integrals take the readings as they are, so that no offset is left."""

Task = tuple[Pair, Pair, Pair | None, Waterways | None]
"""Reference, effectiveness, valve splits and waterways that a state feedback is computed for."""


class FeedbackMemory(NamedTuple):
    """What the law remembers between two steps.

    feedback : in force at the last step. base : the same, as it is at the end of a start phase. task : what it was
    computed for. integral_Vs, level_cm : integrals and levels fed back at the last step. lower_cm : (2,) lower levels
    that the integrals compare. waterways : those followed then. path : of the feedforward, at rest in a start phase.
    """

    feedback: StateFeedback
    base: StateFeedback
    task: Task
    integral_Vs: Pair
    level_cm: Quad
    lower_cm: Pair
    waterways: Waterways | None = None
    path: PathState | None = None


@dataclass(frozen=True)
class StateFeedbackLaw:
    """Configuration: how gains and operating points are found, the control period, and the time of the anti-windup.

    anti_windup_s : see `state_feedback.advance_integral`. follower : of the path; None: no feedforward.
    """

    reconfiguration: Reconfiguration
    period_s: float
    anti_windup_s: float
    follower: PathFollower | None = None

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
        path = None
        if self.follower is not None and self._is_on_start_ramp(inputs):
            path = self.follower.at_rest(base, inputs)
        elif self.follower is not None:
            path = self.follower.begin(base, inputs)
            feedback = with_path(base, path)
        integral = (0.0, 0.0)
        if inputs.given_V != (0.0, 0.0):
            integral = state_feedback.bumpless_integral(feedback, inputs.level_cm, inputs.given_V)
        level_cm, lower_cm = inputs.level_cm, inputs.level_cm[:2]
        return FeedbackMemory(feedback, base, task, integral, level_cm, lower_cm, inputs.followed.waterways, path)

    def step(self, memory: FeedbackMemory, inputs: LawInputs) -> tuple[FeedbackMemory, LawRequest]:
        """The drives wanted. A change of gains or operating point is bumpless."""
        integral, level_cm = self.advanced(memory, inputs), self._fed_back(inputs)
        base, task = memory.base, self._task(memory, inputs)
        if task != memory.task:
            base = self.reconfiguration.law(*task)
        feedback, path = self._around(memory, base, integral, inputs)
        if base is not memory.base:
            before = memory.feedback
            is_same = path is not None and memory.path is not None and path.model is memory.path.model
            if path is not None and is_same and not self._is_on_start_ramp(inputs):
                before = with_path(before, path)  # it is the deviation from the path that goes on
            effective = state_feedback.effective_voltage(before, integral, level_cm)
            integral = state_feedback.bumpless_integral(feedback, level_cm, effective)
            ways = self._newly_identified(memory, inputs)
            if ways is not None and not feedback.problem:
                integral = self.reconfiguration.settling_integral(feedback, ways, level_cm)
        effective_V = state_feedback.effective_voltage(feedback, integral, level_cm)
        waterways, lower_cm = inputs.followed.waterways, inputs.level_cm[:2]
        new = FeedbackMemory(feedback, base, task, integral, level_cm, lower_cm, waterways, path)
        y1, y2 = feedback.target_V
        target_V, held_V = feedback.target_V, feedback.operating_V
        if path is not None and not self._is_on_start_ramp(inputs):
            target_V, held_V = path.target_V, path.target.drive_V
        return new, LawRequest(
            drive_V=state_feedback.pump_voltage(feedback, effective_V),
            target_V=target_V,
            reason=feedback.reason,
            problem=feedback.problem,
            shown={} if path is None else {"path_1_V": y1, "path_2_V": y2},
            events=_events(memory, new, inputs),
            feedback=FeedbackRecord(held_V, integral, feedback.pump_gain),
        )

    def advanced(self, memory: FeedbackMemory, inputs: LawInputs) -> Pair:
        """The integrals (2,) after the last step, from what the pumps were given for it.

        In MANUAL they follow the operator's drives, so that the return to AUTO is bumpless.
        """
        feedback, integral, level_cm = memory.feedback, memory.integral_Vs, memory.level_cm
        if inputs.authority is Authority.NOBODY:
            return integral
        if inputs.authority is Authority.OPERATOR and memory.path is not None:
            return integral  # the path follows instead
        if inputs.authority is Authority.OPERATOR:
            (theta1, theta2), (drive1, drive2) = feedback.effectiveness, inputs.given_V
            return state_feedback.bumpless_integral(feedback, level_cm, (theta1 * drive1, theta2 * drive2))
        k, (h1, h2) = self.model.level_gain_V_cm, memory.lower_cm
        error = (feedback.target_V[0] - k * h1, feedback.target_V[1] - k * h2)
        excess = inputs.excess_V
        if feedback.standby_V != (None, None):
            effective = state_feedback.effective_voltage(feedback, integral, level_cm)
            excess = state_feedback.undelivered(feedback, effective, excess)
        return state_feedback.advance_integral(feedback, integral, error, excess, self.period_s, self.anti_windup_s)

    def _fed_back(self, inputs: LawInputs) -> Quad:
        """(4,) levels to feed back, cm. A sensor that is not trusted has no innovation; its level is the model's."""
        if self.follower is None:
            return inputs.level_cm
        share = SMOOTHED / self.model.level_gain_V_cm
        (h1, h2, h3, h4), (n1, n2, n3, n4) = inputs.level_cm, inputs.estimate.innovation_V
        return (
            h1 - share * n1 if isfinite(n1) else h1,
            h2 - share * n2 if isfinite(n2) else h2,
            h3 - share * n3 if isfinite(n3) else h3,
            h4 - share * n4 if isfinite(n4) else h4,
        )

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

    def _around(
        self, memory: FeedbackMemory, base: StateFeedback, integral: Pair, inputs: LawInputs
    ) -> tuple[StateFeedback, PathState | None]:
        """The feedback around the path, and the path; in a start phase around the levels on the way, the path waits."""
        moved = self._moved(inputs.references.start, base, inputs.t_s)
        if self.follower is None or memory.path is None:
            return moved, None
        if self._is_on_start_ramp(inputs):
            return moved, memory.path if base is memory.base else self.follower.at_rest(base, inputs)
        added_V = feedback_part(memory.feedback, integral, memory.level_cm)
        path = self.follower.step(memory.path, base, inputs, added_V)
        return with_path(base, path), path

    def _is_on_start_ramp(self, inputs: LawInputs) -> bool:
        phase = inputs.references.start
        return phase is not None and not phase.is_past_ramp(inputs.t_s)

    def _task(self, memory: FeedbackMemory, inputs: LawInputs) -> Task:
        """What the feedback is to be computed for; on a ramp again only when the reference has moved far enough."""
        task, (was1, was2) = _task(inputs), memory.task[0]
        if inputs.references.rate(inputs.t_s) == (0.0, 0.0):
            return task
        (r1, r2), *found = task
        return (
            memory.task if found == list(memory.task[1:]) and max(abs(r1 - was1), abs(r2 - was2)) < REGAIN_V else task
        )

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
