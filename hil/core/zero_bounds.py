"""What a transmission zero in the right half plane permits, whatever the controller.

Let z > 0 be the zero and eta (2,) the unit vector with eta' G(z) = 0. Every stable closed loop from rest has

    integral of e^(-z t) eta' y(t) dt = 0,

so the weighted output eta' y has to go the wrong way before it goes the right way. Three bounds follow for a step r of
the references, with s = |eta' r|:

- the squared error: integral of |r - y|^2 dt >= 2 s^2 / z (Cauchy and Schwarz; reached by a linear-quadratic law whose
  commands cost nothing: L. Qiu and E. J. Davison, Automatica 29(2), 1993);
- undershoot: if both outputs stay within a tolerance after t_s, eta' y has been at least
  (s - tolerance |eta|_1) / (e^(z t_s) - 1) on the wrong side (R. H. Middleton, Automatica 27(2), 1991);
- sensitivity: if |eta' S| <= a at all frequencies up to w, its peak is at least (1/a)^(q/(pi - q)), q = 2 arctan(w/z)
  (J. S. Freudenberg and D. P. Looze, IEEE Trans. Automatic Control 30(6), 1985).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, exp, inf, log, pi

import numpy as np

from hil.core.tanks import Array, LinearModel, transmission_zeros
from hil.core.types import Pair


@dataclass(frozen=True, slots=True)
class ZeroBound:
    """The bounds of one unstable zero. zero_1_s : z > 0. direction : (2,) eta, unit, second entry not negative."""

    zero_1_s: float
    direction: Pair

    def weighted(self, output_V: Pair) -> float:
        """The weighted output eta' y in V; for a step of the references: how much of it the zero concerns."""
        return self.direction[0] * output_V[0] + self.direction[1] * output_V[1]

    def least_squared_error(self, step_V: Pair) -> float:
        """Least integral of |r - y|^2 after a step, V^2 s."""
        return 2.0 * self.weighted(step_V) ** 2 / self.zero_1_s

    def least_wrong_way_V(self, step_V: Pair, settled_s: float, tolerance_V: float) -> float:  # noqa: N802 - unit
        """How far eta' y has to go the wrong way, V, if both outputs stay within tolerance_V of r after settled_s."""
        due = self._due(step_V, tolerance_V)
        return due / (exp(self.zero_1_s * settled_s) - 1.0) if settled_s > 0.0 else (inf if due > 0.0 else 0.0)

    def least_settling_s(self, step_V: Pair, wrong_way_V: float, tolerance_V: float) -> float:
        """Earliest time in s after which both outputs can stay within tolerance_V, if eta' y goes so far wrong."""
        due = self._due(step_V, tolerance_V)
        if due == 0.0:
            return 0.0
        return log(1.0 + due / wrong_way_V) / self.zero_1_s if wrong_way_V > 0.0 else inf

    def wrong_way_V(self, step_V: Pair, outputs_V: Array) -> float:  # noqa: N802 - units keep their case
        """How far eta' y went the wrong way in V. outputs_V : (n, 2) outputs less those before the step."""
        sign = 1.0 if self.weighted(step_V) >= 0.0 else -1.0
        return max(0.0, float(np.max(-sign * (outputs_V @ np.array(self.direction)))))

    def least_peak(self, small: float, up_to_1_s: float) -> float:
        """Least peak of |eta' S| if it is at most `small` (0 < small <= 1) at all frequencies up to up_to_1_s."""
        share = 2.0 * atan(up_to_1_s / self.zero_1_s)
        return float((1.0 / small) ** (share / (pi - share)))

    def _due(self, step_V: Pair, tolerance_V: float) -> float:
        """What eta' y has to reach at least, V."""
        widest = tolerance_V * (abs(self.direction[0]) + abs(self.direction[1]))
        return max(0.0, abs(self.weighted(step_V)) - widest)


def zero_bound(linear: LinearModel) -> ZeroBound | None:
    """The bound of the zero in the right half plane; None if both zeros are in the left one."""
    zero = float(transmission_zeros(linear).max())
    if not zero > 0.0:
        return None
    G = linear.C @ np.linalg.solve(zero * np.eye(4) - linear.A, linear.B)
    left = np.linalg.svd(G)[0][:, 1]
    e1, e2 = (left if left[1] >= 0.0 else -left).tolist()
    return ZeroBound(zero, (e1, e2))
