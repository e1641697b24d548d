"""The control law for a reference and a diagnosis: gains, operating voltages, the target that the pumps can reach.

Hajiani and Poshtan (2012), section 4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from hil.core.eigenstructure import augment
from hil.core.gain_design import GainDesign, closed_loop_poles, gain_matrix
from hil.core.pumps import STRAIGHT, PumpPath
from hil.core.reachable import nearest_reachable
from hil.core.state_feedback import StateFeedback
from hil.core.tanks import TankModel, equilibrium, holding_voltages, linearise
from hil.core.types import Pair, Quad, Waterways

MIN_EFFECTIVENESS = 0.05
"""A pump with less effectiveness than this is dead: feedback has no effect on it. It gets the voltage that a healthy
pump would need, so that its recovery can be seen."""

MIN_LINEARISED_CM = 0.2
"""Lower limit of the levels in the linearisation: eq. (3) has no time constant for an empty tank."""

MIN_DECAY_1_S = 1e-3
"""A closed loop whose slowest pole decays more slowly counts as unstable: nobody could see that it is not."""

MIN_OUTLET = 0.02
"""Lower limit of an identified outlet, over the file's: there is no equilibrium with an outlet that is shut."""

UNSURE_V = 0.6
"""How wrong holding drives may be that were computed from what was identified. A reference that they miss by less is
kept: the integral action finds out."""

FAILURES = (ArithmeticError, ValueError, np.linalg.LinAlgError)
"""What there is to catch where a design has no solution."""


def found_tanks(model: TankModel, valve_split: Pair | None, waterways: Waterways | None) -> tuple[TankModel, str]:
    """The tanks as the diagnosis has found them, and what is different in them, in words."""
    if waterways is None:
        split = valve_split or model.valve_split
        return replace(model, valve_split=split), "valve splits of {:.3f} and {:.3f}".format(*split)
    own = [max(part, MIN_OUTLET) for part in waterways.outlet]
    (k1, k2), (a1, a2, a3, a4), (e3, e4) = model.pump_gain_cm3_Vs, model.outlet_cm2, waterways.leak
    found = replace(
        model,
        outlet_cm2=(a1 * own[0], a2 * own[1], a3 * (own[2] + e3), a4 * (own[3] + e4)),
        pump_gain_cm3_Vs=(k1 * waterways.gain[0], k2 * waterways.gain[1]),
        valve_split=waterways.split,
        arriving=(own[2] / (own[2] + e3), own[3] / (own[3] + e4)),
    )
    return found, "outlets of {:.2f}, {:.2f}, {:.2f} and {:.2f} of the file's".format(*waterways.outlet)


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """What holds the outputs in force: (4,) levels in cm, (2,) effective drives in V, by the model.

    target_V : (2,) these outputs. reason : why they are not the reference, "" if they are.
    """

    level_cm: Quad
    drive_V: Pair
    target_V: Pair
    reason: str


@dataclass(frozen=True, slots=True)
class Reconfiguration:
    """Configuration: the model, the design, the largest drives, a fixed design's operating point, drives too, in V.

    pumps : to say drives as voltages.
    """

    model: TankModel
    design: GainDesign
    limit_V: Pair
    operating_point_V: Pair
    pumps: PumpPath = STRAIGHT

    def law(
        self,
        reference_V: Pair,
        effectiveness: Pair,
        valve_split: Pair | None = None,
        waterways: Waterways | None = None,
    ) -> StateFeedback:
        """The law for a reference (2,) in V and the pumps' effectiveness (2,). Fast enough for every control step.

        valve_split : (2,) the splits found, if a valve has shifted. waterways : what was found, if a tank leaks or an
        outlet is blocked. Operating point and target are then those of what was found. The gains stay as long as they
        are stable there, otherwise they are computed again; where they are not stable either, `StateFeedback.problem`
        says so. Not with a dead pump.
        """
        law = self._law(self.model, reference_V, effectiveness)
        if not self._is_found(effectiveness, valve_split, waterways):
            return law
        found, what = found_tanks(self.model, valve_split, waterways)
        try:
            adapted = self._law(found, reference_V, effectiveness, UNSURE_V if waterways is not None else 0.0)
            for candidate in (replace(adapted, gains=law.gains), adapted):
                if self._is_stable(found, candidate):
                    return candidate
        except FAILURES:
            pass  # no gains, or no operating point
        return replace(law, problem=f"{what} leave no stable law")

    def tanks(self, effectiveness: Pair, valve_split: Pair | None, waterways: Waterways | None) -> TankModel:
        """The tanks that `law` computes operating point and target for: as in the rig file, or as found."""
        is_found = self._is_found(effectiveness, valve_split, waterways)
        return found_tanks(self.model, valve_split, waterways)[0] if is_found else self.model

    def operating_point(
        self, model: TankModel, reference_V: Pair, effectiveness: Pair, unsure_V: float = 0.0
    ) -> OperatingPoint:
        """Levels and drives that hold a reference (2,) in V, or what comes nearest to it. unsure_V : see UNSURE_V."""
        k = model.level_gain_V_cm
        wanted_cm = (reference_V[0] / k, reference_V[1] / k)
        effective_limit = (effectiveness[0] * self.limit_V[0], effectiveness[1] * self.limit_V[1])
        reachable = nearest_reachable(model, wanted_cm, effective_limit, self.pumps)
        if reachable.reason and unsure_V > 0.0:
            held = holding_voltages(model, wanted_cm)
            if all(-unsure_V <= v <= limit + unsure_V for v, limit in zip(held, effective_limit, strict=True)):
                levels = equilibrium(model, (max(held[0], 0.0), max(held[1], 0.0)))
                return OperatingPoint((*wanted_cm, *levels[2:]), held, reference_V, "")
        target_V = reference_V if not reachable.reason else (k * reachable.lower_cm[0], k * reachable.lower_cm[1])
        drive_V = (max(reachable.holding_V[0], 0.0), max(reachable.holding_V[1], 0.0))
        return OperatingPoint(equilibrium(model, drive_V), drive_V, target_V, reachable.reason)

    def settling_integral(self, law: StateFeedback, waterways: Waterways, level_cm: Quad) -> Pair:
        """The integrals (2,) in V s from which the outputs return best to a target that identified tanks can hold.

        The operating point then needs none in the end. On the way there the integral of the squared errors of the
        linear model, z' P z with z = (levels - operating levels, integrals), is smallest where its derivative by the
        integrals is zero; P solves the Lyapunov equation of the closed loop.
        """
        found, _ = found_tanks(self.model, None, waterways)
        h1, h2, h3, h4 = (max(h, MIN_LINEARISED_CM) for h in law.operating_level_cm)
        linear = linearise(found, (h1, h2, h3, h4))
        A, B = augment(linear)
        C = np.hstack([linear.C, np.zeros((2, 2))])
        P = solve_continuous_lyapunov((A - B @ gain_matrix(law.gains)).T, -C.T @ C)
        x = np.array(level_cm) - np.array(law.operating_level_cm)
        q1, q2 = np.linalg.solve(P[4:, 4:], -P[4:, :4] @ x).tolist()
        return q1, q2

    def _is_found(self, effectiveness: Pair, valve_split: Pair | None, waterways: Waterways | None) -> bool:
        """Whether the tanks are others than in the rig file. With a dead pump they are left as they are."""
        return not (valve_split is None and waterways is None) and min(effectiveness) >= MIN_EFFECTIVENESS

    def _is_stable(self, model: TankModel, law: StateFeedback) -> bool:
        """Whether the gains stabilise these tanks at the law's operating point."""
        h1, h2, h3, h4 = (max(h, MIN_LINEARISED_CM) for h in law.operating_level_cm)
        poles = closed_loop_poles(linearise(model, (h1, h2, h3, h4)), gain_matrix(law.gains))
        return bool(poles[0].real < -MIN_DECAY_1_S)

    def _law(self, model: TankModel, reference_V: Pair, effectiveness: Pair, unsure_V: float = 0.0) -> StateFeedback:
        """The law for a model. unsure_V : by how much the holding drives may be out of range without another target.

        The gains are those of PEA for nominal pumps; the whole command of a pump is divided by its theta. That is also
        PEA for the faulty B Theta: with parameters Theta^-1 w_i it has the same eigenvectors and gain Theta^-1 K.
        """
        theta = (max(effectiveness[0], MIN_EFFECTIVENESS), max(effectiveness[1], MIN_EFFECTIVENESS))
        point = self.operating_point(model, reference_V, effectiveness, unsure_V)
        levels, operating_V = point.level_cm, point.drive_V
        if not self.design.follows_reference:
            operating_V = (max(self.operating_point_V[0], 0.0), max(self.operating_point_V[1], 0.0))
            levels = equilibrium(model, operating_V)
        h1, h2, h3, h4 = (max(h, MIN_LINEARISED_CM) for h in levels)
        gains = self.design.gains(linearise(model, (h1, h2, h3, h4)))
        k = model.level_gain_V_cm
        return StateFeedback(
            gains=gains,
            operating_level_cm=levels,
            operating_V=operating_V,
            target_V=point.target_V,
            effectiveness=theta,
            reason=point.reason,
            standby_V=self._standby(model, effectiveness, (reference_V[0] / k, reference_V[1] / k)),
        )

    def _standby(self, model: TankModel, effectiveness: Pair, wanted_cm: Pair) -> tuple[float | None, float | None]:
        if min(effectiveness) >= MIN_EFFECTIVENESS:
            return None, None
        v1, v2 = nearest_reachable(model, wanted_cm, self.limit_V).holding_V
        return (
            v1 if effectiveness[0] < MIN_EFFECTIVENESS else None,
            v2 if effectiveness[1] < MIN_EFFECTIVENESS else None,
        )
