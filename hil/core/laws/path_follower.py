"""The feedforward of the state feedback: it keeps the path of `hil.core.feedforward` over changes of all kinds.

the reference changes      the path goes on from where it is, to the new target
a pump's effectiveness     a large change, and while it is refined: it begins again from the lower levels estimated
                           and the flows that the pumps have now, and leads back within what is left of them. So the
                           integrals learn nothing of a loss. Otherwise, and where the outputs can't be moved each by
                           its own pump, the path goes on
tanks as found             the path keeps its lower levels; upper levels and drives move by as much as those that hold
                           the target
what feedback adds         is left to it of the pumps' ranges: on a rig weaker than its file the path is slower
MANUAL                     the path is where the rig is: lower levels as estimated, drives such that feedback and path
                           together give what the operator set. So the return is without a jump
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from hil.core import feedforward, state_feedback
from hil.core.control_law import Authority, LawInputs
from hil.core.feedforward import FeedforwardPath, PathLimits, Target
from hil.core.reconfiguration import Reconfiguration
from hil.core.state_feedback import StateFeedback
from hil.core.tanks import TankModel
from hil.core.types import Pair, Quad, Waterways

Found = tuple[Pair, Pair | None, Waterways | None]
"""Effectiveness, valve splits and waterways that are followed."""

NEAR_CM = 0.5
"""A run that begins with its lower levels so close to the reference begins with a path at rest there."""

NEAR_COUPLED_CM = 2.0
"""The same where the outputs can't be moved each by its own pump: what the model does not know of the rig moves the
levels by more there, and feedback on the whole deviation learns it sooner than feedback on that from a path."""


class PathState(NamedTuple):
    """A path on its way: target, tanks and limits for which it was continued last, and what they were found for."""

    path: FeedforwardPath
    target: Target
    target_V: Pair
    model: TankModel
    limits: PathLimits
    found: Found


@dataclass(frozen=True)
class PathFollower:
    """Configuration: operating points by `reconfiguration`; limits of healthy pumps."""

    reconfiguration: Reconfiguration
    limits: PathLimits

    def begin(self, base: StateFeedback, inputs: LawInputs) -> PathState:
        """At rest at the target; from the levels found if they are far from it."""
        rest = self.at_rest(base, inputs)
        near_cm = NEAR_CM if rest.target.gain is None else NEAR_COUPLED_CM
        is_near = all(
            abs(h - wanted) <= near_cm for h, wanted in zip(inputs.level_cm[:2], rest.target.level_cm[:2], strict=True)
        )
        if is_near:
            return rest
        (t1, t2), (v1, v2) = base.effectiveness, inputs.given_V
        return rest._replace(path=feedforward.taken_over(inputs.level_cm, (t1 * v1, t2 * v2), rest.limits))

    def at_rest(self, base: StateFeedback, inputs: LawInputs) -> PathState:
        """The path that has arrived."""
        found = _found(inputs)
        model, limits = self._rig(found)
        target, target_V = self._target(model, base, inputs, found)
        return PathState(feedforward.at_rest(target, limits), target, target_V, model, limits, found)

    def step(self, state: PathState, base: StateFeedback, inputs: LawInputs, feedback_V: Pair) -> PathState:
        """The path at this step. feedback_V : (2,) effective drives of the feedback at the last step."""
        found = _found(inputs)
        model, limits = (state.model, state.limits) if found == state.found else self._rig(found)
        target, target_V = self._target(model, base, inputs, found, state)
        path = state.path if model is state.model else _shifted(state.path, state.target, target)
        periods = round(inputs.period_s / limits.period_s)
        if inputs.authority is Authority.LAW or inputs.period_s <= 0.0:
            k, (rate1, rate2) = model.level_gain_V_cm, inputs.references.rate(inputs.t_s)
            (f1, f2), (dead1, dead2) = feedback_V, base.is_dead
            f1, f2 = 0.0 if dead1 else f1, 0.0 if dead2 else f2
            estimate_cm: Quad | None = inputs.estimate.level_cm
            if self._is_replanned(state, found, target, inputs):
                path = _from_the_rig(path, model, limits, base, inputs, (f1, f2))
                estimate_cm, periods = None, 0
            rate_cm_s = (rate1 / k, rate2 / k)
            path = feedforward.advance(model, limits, path, target, estimate_cm, rate_cm_s, periods, (f1, f2))
        else:
            path = self._taken_along(path, model, limits, base, inputs, feedback_V)
        return PathState(path, target, target_V, model, limits, found)

    def _is_replanned(self, state: PathState, found: Found, target: Target, inputs: LawInputs) -> bool:
        """Whether the path begins again from where the rig is: a large change of a pump, and its refinements."""
        is_large = inputs.t_s <= inputs.followed.refined_until_s
        return is_large and found[0] != state.found[0] and target.gain is None and inputs.period_s > 0.0

    def _taken_along(
        self,
        path: FeedforwardPath,
        model: TankModel,
        limits: PathLimits,
        base: StateFeedback,
        inputs: LawInputs,
        feedback_V: Pair,
    ) -> FeedforwardPath:
        """The path where the rig is, while somebody else gives the drives."""
        (t1, t2), (v1, v2) = base.effectiveness, inputs.given_V
        drive_V = (t1 * v1 - feedback_V[0], t2 * v2 - feedback_V[1])
        path = feedforward.moved(model, limits, path._replace(drive_V=drive_V))
        h1, h2, _, _ = inputs.estimate.level_cm
        return path._replace(level_cm=(h1, h2, *path.level_cm[2:]))

    def _rig(self, found: Found) -> tuple[TankModel, PathLimits]:
        return self.reconfiguration.tanks(*found), self.limits.with_effectiveness(found[0])

    def _target(
        self, model: TankModel, base: StateFeedback, inputs: LawInputs, found: Found, before: PathState | None = None
    ) -> tuple[Target, Pair]:
        """Where the path leads, and its outputs in V."""
        is_moving = inputs.references.rate(inputs.t_s) != (0.0, 0.0)
        if not is_moving and self.reconfiguration.design.follows_reference:
            level_cm, drive_V, target_V = base.operating_level_cm, base.operating_V, base.target_V
        else:
            point = self.reconfiguration.operating_point(model, inputs.reference_V, found[0])
            level_cm, drive_V, target_V = point.level_cm, point.drive_V, point.target_V
        if before is not None and model is before.model and level_cm == before.target.level_cm:
            return before.target, target_V
        gain = before.target.gain if before is not None and is_moving and model is before.model else None
        gain = gain or feedforward.coupled_gain(model, level_cm)
        return feedforward.target_at(model, level_cm, drive_V, gain), target_V


def _from_the_rig(
    path: FeedforwardPath,
    model: TankModel,
    limits: PathLimits,
    base: StateFeedback,
    inputs: LawInputs,
    feedback_V: Pair,
) -> FeedforwardPath:
    """The path from the lower levels and pump flows as they are, with what is left of the pumps."""
    (t1, t2), (v1, v2), (p1, p2) = base.effectiveness, inputs.given_V, inputs.estimate.pump_V
    moved = feedforward.moved(model, limits, path)
    h1, h2, _, _ = inputs.estimate.level_cm
    return moved._replace(
        level_cm=(h1, h2, *moved.level_cm[2:]),
        flow_V=(t1 * p1 - feedback_V[0], t2 * p2 - feedback_V[1]),
        drive_V=(t1 * v1 - feedback_V[0], t2 * v2 - feedback_V[1]),
    )


def with_path(base: StateFeedback, state: PathState) -> StateFeedback:
    """The feedback around the path."""
    k, path = state.model.level_gain_V_cm, state.path
    level_cm = path.level_cm
    return base.around(level_cm, path.drive_V, (k * level_cm[0], k * level_cm[1]))


def feedback_part(feedback: StateFeedback, integral_Vs: Pair, level_cm: Quad) -> Pair:
    """(2,) what feedback adds to the drives of the path, effective, V."""
    v1, v2 = state_feedback.effective_voltage(feedback, integral_Vs, level_cm)
    return v1 - feedback.operating_V[0], v2 - feedback.operating_V[1]


def _shifted(path: FeedforwardPath, old: Target, new: Target) -> FeedforwardPath:
    """The path in tanks that have turned out to be others."""
    (h1, h2, h3, h4), (_, _, old3, old4), (_, _, new3, new4) = path.level_cm, old.level_cm, new.level_cm
    d1, d2 = new.drive_V[0] - old.drive_V[0], new.drive_V[1] - old.drive_V[1]
    return FeedforwardPath(
        level_cm=(h1, h2, max(h3 + new3 - old3, 0.0), max(h4 + new4 - old4, 0.0)),
        flow_V=(path.flow_V[0] + d1, path.flow_V[1] + d2),
        drive_V=(path.drive_V[0] + d1, path.drive_V[1] + d2),
        under_way=(
            tuple(drive + d1 for drive in path.under_way[0]),
            tuple(drive + d2 for drive in path.under_way[1]),
        ),
    )


def _found(inputs: LawInputs) -> Found:
    followed = inputs.followed
    return followed.effectiveness, followed.valve_split, followed.waterways
