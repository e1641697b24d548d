"""A command governor around a state feedback: it moves the reference such that no limit will be met.

At each step the command g nearest to the reference r is applied for which the linear closed loop, with g kept from now
on, stays within the limits of drives and levels at all of the times TIMES_S ahead:

    min |g - r|^2      such that      0 <= w(t) <= theta v_max,   h(t) <= rim - margin      for t in TIMES_S

Idea: A. Bemporad, A. Casavola and E. Mosca, Nonlinear control of constrained linear systems via predictive reference
management, IEEE Trans. Automatic Control 42(3), 1997. Under a fault the same program is solved with what is left of the
pumps, so that the command waits for them.

Ours: a state feedback with integral action inside (see `linear_quadratic`), a finite set of times, and no command that
changes while the program has no solution.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from hil.core.control_law import Authority, LawInputs, LawRequest
from hil.core.eigenstructure import augment
from hil.core.gain_design import gain_matrix
from hil.core.laws.law_plant import LawPlant, known_effectiveness, steady_aim
from hil.core.laws.linear_quadratic import WeightedFeedback, WeightedMemory
from hil.core.laws.quadratic_program import require_solver, solve_qp
from hil.core.reconfiguration import MIN_LINEARISED_CM
from hil.core.state_feedback import StateFeedback
from hil.core.tanks import Array, TankModel, linearise
from hil.core.types import Pair

TIMES_S = (0.0, 0.5, 1.0, 2.0, 4.0, 7.0, 12.0, 20.0, 35.0, 60.0)
"""Times ahead at which the limits are checked."""

CHANGE_V = 1e-4
"""A smaller change of the command is not made: each one computes the gains again."""


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Drives and levels at TIMES_S: rows @ [levels - levels of g; integrals], stacked; both move with g.

    state : (6n, 6) drives (2n), then levels less those of g (4n). of_command : (6n, 2) by how much they move at once
    with g, at the same levels and integrals. law : that it was computed for.
    """

    law: StateFeedback
    state: Array
    of_command: Array


@dataclass(frozen=True, slots=True)
class GovernorMemory:
    """inner : of the state feedback. command_V : (2,) g. loop : the closed loop around it."""

    inner: WeightedMemory
    command_V: Pair
    loop: ClosedLoop


@dataclass(frozen=True, slots=True)
class CommandGovernor:
    """feedback : what is governed. rim_margin_cm, drive_margin_V : distances from the rims and the drives' limits.

    Raises MissingSolverError where DAQP is not installed.
    """

    plant: LawPlant
    feedback: WeightedFeedback
    rim_margin_cm: float = 1.5
    drive_margin_V: float = 0.05

    def __post_init__(self) -> None:
        require_solver()

    def start(self, inputs: LawInputs) -> GovernorMemory:
        """The command begins at the reference."""
        inner = self.feedback.start(inputs)
        return GovernorMemory(
            inner, inputs.reference_V, closed_loop(self.plant.model, inner.law, self.feedback.reference_weight)
        )

    def step(self, memory: GovernorMemory, inputs: LawInputs) -> tuple[GovernorMemory, LawRequest]:
        """The nearest command that keeps the limits, and a step of the state feedback towards it."""
        theta = known_effectiveness(inputs.followed, self.feedback.use_diagnosis)
        aim = steady_aim(self.plant, inputs.reference_V, theta)
        command = memory.command_V
        if inputs.authority is Authority.OPERATOR:
            command = aim.target_V
        elif command != aim.target_V:
            command = self._governed(memory, inputs, aim.target_V, theta)
        inner, request = self.feedback.step_to(memory.inner, inputs, command)
        loop = memory.loop
        if inner.law is not loop.law:
            loop = closed_loop(self.plant.model, inner.law, self.feedback.reference_weight)
        shown = {**request.shown, "command_1_V": command[0], "command_2_V": command[1]}
        governed = replace(request, target_V=aim.target_V, reason=aim.reason, shown=shown)
        return GovernorMemory(inner, command, loop), governed

    def _governed(self, memory: GovernorMemory, inputs: LawInputs, target_V: Pair, theta: Pair) -> Pair:
        """The command nearest to the target; the old one where none keeps the limits."""
        law, loop, n = memory.inner.law, memory.loop, len(TIMES_S)
        state = np.concatenate([np.array(inputs.level_cm) - law.operating_level_cm, memory.inner.integral_Vs])
        now = loop.state @ state + np.concatenate([np.tile(law.operating_V, n), np.tile(law.operating_level_cm, n)])
        limit = np.array(theta) * np.array(self.plant.limit_V) - self.drive_margin_V
        rim = np.array(self.plant.model.height_cm) - self.rim_margin_cm
        low = np.concatenate([np.full(2 * n, self.drive_margin_V), np.full(4 * n, -np.inf)]) - now
        high = np.concatenate([np.tile(limit, n), np.tile(rim, n)]) - now
        wanted = np.array(target_V) - memory.command_V
        c1, c2 = memory.command_V
        bounds = np.concatenate([[-c1, -c2], low]), np.concatenate([[1e3, 1e3], high])  # no output below an empty tank
        change = solve_qp(np.eye(2), -wanted, *bounds, loop.of_command)
        if change is None or float(np.abs(change).max()) < CHANGE_V:
            return memory.command_V
        if float(np.abs(change - wanted).max()) < CHANGE_V:
            return target_V
        return max(c1 + float(change[0]), 0.0), max(c2 + float(change[1]), 0.0)


def closed_loop(model: TankModel, law: StateFeedback, reference_weight: float) -> ClosedLoop:
    """The linear closed loop at the operating point of a law, whose integrals take what is not the weight's."""
    h1, h2, h3, h4 = (max(level, MIN_LINEARISED_CM) for level in law.operating_level_cm)
    linear, K = linearise(model, (h1, h2, h3, h4)), gain_matrix(law.gains)
    A, B = augment(linear)
    rest = np.linalg.solve(np.block([[linear.A, linear.B], [linear.C, np.zeros((2, 2))]]), np.eye(6)[:, 4:])
    ahead = [expm(t_s * (A - B @ K)) for t_s in TIMES_S]
    state = np.vstack([*(-K @ part for part in ahead), *(part[:4] for part in ahead)])
    bumpless = np.linalg.solve(K[:, 4:], rest[4:] + K[:, :4] @ rest[:4])
    moved = np.vstack([-rest[:4], (1.0 - reference_weight) * bumpless])
    held = np.vstack([*[rest[4:]] * len(TIMES_S), *[rest[:4]] * len(TIMES_S)])
    return ClosedLoop(law, state, state @ moved + held)
