"""A design for any valve split: decoupled outputs where the zeros are stable, a linear-quadratic law where one is not.

With gamma1 + gamma2 < 1 more than half of the water takes the way through the upper tanks, and one of the two
transmission zeros lies in the right half plane (K. H. Johansson, The quadruple-tank process, IEEE Trans. Control
Systems Technology 8(3), 2000). A pole can't cancel it, so `RigDesign` does not exist there. `NonMinimumPhaseDesign`
takes the feedback u = -K [x; q] that minimises

    integral of  w (|y|^2 + (INTEGRAL_RATE z)^2 |q|^2) + |u|^2

where z is that zero and w the one weight left, chosen for the noise of the commands. Its poles follow from the zeros:
with w large one is the mirror image -z of the unstable zero, one is the stable zero, two are at -INTEGRAL_RATE z, and
two go far to the left. The first makes the squared error the least that the zero permits (L. Qiu and E. J. Davison,
Automatica 29(2), 1993, see `hil.core.zero_bounds`). As the weight of u is diagonal, each pump may lose up to half of
its gain, and may gain any factor, before the loop becomes unstable (M. G. Safonov and M. Athans, IEEE Trans. Automatic
Control 22(2), 1977).

At gamma1 + gamma2 = 1 the zero lies at 0 and no law with integral action is stable; near there none is worth having.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_are

from hil.core.eigenstructure import DesignError, augment
from hil.core.gain_design import Gains, RigDesign, choose_rig_design, noise_gain
from hil.core.tanks import Array, LinearModel, relative_gains, transmission_zeros

INTEGRAL_RATE = 10.0
"""Weight of an integral over that of its output, as a multiple of the unstable zero."""

MAX_RELATIVE_GAIN = 15.0
"""Largest entry of the RGA, in magnitude, for which there is a design: an error of one part in fifteen of a single gain
of the process makes it singular there. With two equal valves gamma1 + gamma2 is then between 0.984 and 1.017."""

MIN_ZERO_1_S = 0.004
"""Smallest unstable zero for which there is a design: its mirror image is the slowest pole, and the outputs would need
more than ten minutes to settle. With the tanks of `johansson_plus` that is gamma1 + gamma2 below some 0.92."""

MIN_WEIGHT, MAX_WEIGHT = 1e-4, 1e6
"""Range of w. A law with less weight hardly reacts to an error."""

WEIGHT_STEPS = 24
"""Bisections of log w: to 0.0002 % of the range's logarithm."""


@dataclass(frozen=True, slots=True)
class NonMinimumPhaseDesign:
    """Linear-quadratic state feedback with integral action for gamma1 + gamma2 < 1; see the head of this module.

    weight : w, of the squared outputs in V^2 against the squared commands in V^2.
    """

    weight: float
    follows_reference: bool = True

    def gains(self, linear: LinearModel) -> Gains:
        """Gains at this operating point; raises DesignError where there is no zero in the right half plane."""
        return Gains.from_matrix(self.feedback(linear))

    def feedback(self, linear: LinearModel) -> Array:
        """K (2, 6) of u = -K [x; q]."""
        zero = float(transmission_zeros(linear).max())
        if not zero > 0.0:
            raise DesignError(f"transmission zero at {zero:+.4g} 1/s: this design is for one in the right half plane")
        A, B = augment(linear)
        cost = np.zeros((6, 6))
        cost[:4, :4] = self.weight * linear.C.T @ linear.C
        cost[4:, 4:] = self.weight * (INTEGRAL_RATE * zero) ** 2 * np.eye(2)
        try:
            K: Array = B.T @ solve_continuous_are(A, B, cost, np.eye(2))
        except np.linalg.LinAlgError as error:
            raise DesignError(f"no linear-quadratic law for a transmission zero at {zero:+.4g} 1/s: {error}") from None
        return K


@dataclass(frozen=True, slots=True)
class AnySplitDesign:
    """`RigDesign` where both zeros are stable, `NonMinimumPhaseDesign` where one is not, a refusal in between.

    output_poles, noise_gain_max : see `choose_rig_design`. decoupled, quadratic : the two designs; one that is None is
    chosen when a valve has moved so far that it is needed.
    """

    output_poles: Sequence[float]
    noise_gain_max: float
    decoupled: RigDesign | None = None
    quadratic: NonMinimumPhaseDesign | None = None
    follows_reference: bool = True

    def gains(self, linear: LinearModel) -> Gains:
        """Gains at this operating point; raises DesignError near gamma1 + gamma2 = 1."""
        return self.at(linear).gains(linear)

    def at(self, linear: LinearModel) -> RigDesign | NonMinimumPhaseDesign:
        """The design of the two for this model. Raises DesignError near gamma1 + gamma2 = 1."""
        check_splits_apart(linear)
        if transmission_zeros(linear).max() < 0.0:
            return self.decoupled or choose_rig_design(linear, self.output_poles, self.noise_gain_max)
        return self.quadratic or choose_nonminimum_phase_design(linear, self.noise_gain_max)


def check_splits_apart(linear: LinearModel) -> None:
    """Raise DesignError near gamma1 + gamma2 = 1, where the lower levels can't be moved apart."""
    largest = float(np.max(np.abs(relative_gains(linear))))
    zero = float(transmission_zeros(linear).max())
    if largest <= MAX_RELATIVE_GAIN and not 0.0 <= zero < MIN_ZERO_1_S:
        return
    raise DesignError(
        f"gamma1 + gamma2 is too near to 1, where no law with integral action is stable: transmission zero at "
        f"{zero:+.2g} 1/s (want one below 0 or above {MIN_ZERO_1_S:g} 1/s), relative gain {largest:.3g} (at most "
        f"{MAX_RELATIVE_GAIN:g}): an error of {100.0 / largest:.1f} % in one gain of the process reaches that point"
    )


def choose_any_split_design(linear: LinearModel, poles: Sequence[float], noise_gain_max: float) -> AnySplitDesign:
    """The design for this rig, whatever its valves. Raises DesignError near gamma1 + gamma2 = 1, or as the two do."""
    chosen = AnySplitDesign(tuple(poles), noise_gain_max).at(linear)
    if isinstance(chosen, RigDesign):
        return AnySplitDesign(tuple(poles), noise_gain_max, decoupled=chosen)
    return AnySplitDesign(tuple(poles), noise_gain_max, quadratic=chosen)


def choose_nonminimum_phase_design(linear: LinearModel, noise_gain_max: float) -> NonMinimumPhaseDesign:
    """The largest weight with which the commands' noise keeps its bound. Raises DesignError if there is none."""
    level_gain = float(linear.C[0, 0])

    def is_quiet(weight: float) -> bool:
        return noise_gain(NonMinimumPhaseDesign(weight).feedback(linear), level_gain) <= noise_gain_max

    if not is_quiet(MIN_WEIGHT):
        raise DesignError(f"noise gain {noise_gain_max:g} V/V can't be met by any law that reacts to an error")
    low, high = np.log(MIN_WEIGHT), np.log(MAX_WEIGHT)
    for _ in range(WEIGHT_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_quiet(float(np.exp(middle))) else (low, middle)
    return NonMinimumPhaseDesign(float(np.exp(low)))
