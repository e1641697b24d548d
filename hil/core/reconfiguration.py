"""The control law for a reference and a diagnosis: gains, operating voltages, the target that the pumps can reach.

Hajiani and Poshtan (2012), section 4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hil.core.gain_design import GainDesign, closed_loop_poles, gain_matrix
from hil.core.pumps import STRAIGHT, Pumps
from hil.core.state_feedback import ControlLaw
from hil.core.tanks import TankModel, equilibrium, linearise, nearest_reachable
from hil.core.types import Pair

MIN_EFFECTIVENESS = 0.05
"""A pump with less effectiveness than this is dead: feedback has no effect on it. It gets the voltage that a healthy
pump would need, so that its recovery can be seen."""

MIN_LINEARISED_CM = 0.2
"""Lower limit of the levels in the linearisation: eq. (3) has no time constant for an empty tank."""

MIN_DECAY_1_S = 1e-3
"""A closed loop whose slowest pole decays more slowly counts as unstable: nobody could see that it is not."""

FAILURES = (ArithmeticError, ValueError, np.linalg.LinAlgError)
"""What there is to catch where a design has no solution."""


@dataclass(frozen=True, slots=True)
class Reconfiguration:
    """Configuration: the model, the design, the largest drives, a fixed design's operating point, drives too, in V.

    pumps : to say drives as voltages.
    """

    model: TankModel
    design: GainDesign
    limit_V: Pair
    operating_point_V: Pair
    pumps: Pumps = STRAIGHT

    def law(self, reference_V: Pair, effectiveness: Pair, valve_split: Pair | None = None) -> ControlLaw:
        """The law for a reference (2,) in V and the pumps' effectiveness (2,). Fast enough for every control step.

        valve_split : (2,) the splits found, if a valve has shifted. Operating point and target are then those of the
        splits found. The gains stay as long as they are stable there, otherwise they are computed again; where they
        are not stable either, `ControlLaw.problem` says so. Not with a dead pump.
        """
        law = self._law(self.model, reference_V, effectiveness)
        if valve_split is None or min(effectiveness) < MIN_EFFECTIVENESS:
            return law
        found = replace(self.model, valve_split=valve_split)
        try:
            adapted = self._law(found, reference_V, effectiveness)
            for candidate in (replace(adapted, gains=law.gains), adapted):
                if self._is_stable(found, candidate):
                    return candidate
        except FAILURES:
            pass  # no gains, or no operating point
        return replace(law, problem="valve splits of {:.3f} and {:.3f} leave no stable law".format(*valve_split))

    def _is_stable(self, model: TankModel, law: ControlLaw) -> bool:
        """Whether the gains stabilise these tanks at the law's operating point."""
        h1, h2, h3, h4 = (max(h, MIN_LINEARISED_CM) for h in equilibrium(model, law.operating_V))
        poles = closed_loop_poles(linearise(model, (h1, h2, h3, h4)), gain_matrix(law.gains))
        return bool(poles[0].real < -MIN_DECAY_1_S)

    def _law(self, model: TankModel, reference_V: Pair, effectiveness: Pair) -> ControlLaw:
        """The law for a model.

        The gains are those of PEA for nominal pumps; the whole command of a pump is divided by its theta. That is also
        PEA for the faulty B Theta: with parameters Theta^-1 w_i it has the same eigenvectors and gain Theta^-1 K.
        """
        theta = (max(effectiveness[0], MIN_EFFECTIVENESS), max(effectiveness[1], MIN_EFFECTIVENESS))
        k = model.level_gain_V_cm
        wanted_cm = (reference_V[0] / k, reference_V[1] / k)
        effective_limit = (effectiveness[0] * self.limit_V[0], effectiveness[1] * self.limit_V[1])
        reachable = nearest_reachable(model, wanted_cm, effective_limit, self.pumps)
        target_V = reference_V if not reachable.reason else (k * reachable.lower_cm[0], k * reachable.lower_cm[1])
        operating_V = reachable.holding_V if self.design.follows_reference else self.operating_point_V
        operating_V = (max(operating_V[0], 0.0), max(operating_V[1], 0.0))
        levels = equilibrium(model, operating_V)
        h1, h2, h3, h4 = (max(h, MIN_LINEARISED_CM) for h in levels)
        gains = self.design.gains(linearise(model, (h1, h2, h3, h4)))
        return ControlLaw(
            gains=gains,
            operating_level_cm=levels,
            operating_V=operating_V,
            target_V=target_V,
            effectiveness=theta,
            reason=reachable.reason,
            standby_V=self._standby(model, effectiveness, wanted_cm),
        )

    def _standby(self, model: TankModel, effectiveness: Pair, wanted_cm: Pair) -> tuple[float | None, float | None]:
        if min(effectiveness) >= MIN_EFFECTIVENESS:
            return None, None
        v1, v2 = nearest_reachable(model, wanted_cm, self.limit_V).holding_V
        return (
            v1 if effectiveness[0] < MIN_EFFECTIVENESS else None,
            v2 if effectiveness[1] < MIN_EFFECTIVENESS else None,
        )
