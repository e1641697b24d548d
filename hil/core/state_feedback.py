"""State feedback with integral action: Hajiani and Poshtan (2012), eq. (6).

x = h - h0 (4 levels, cm), q = integral of e = r - y (2, V s):

    u = -K_x x - K_q q,      v = (v0 + u) / theta

theta is the effectiveness of each pump; v0 + u is the *effective* voltage, which a healthy pump would need.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from hil.core.gain_design import Gains
from hil.core.types import Pair, Quad


@dataclass(frozen=True)
class StateFeedback:
    """Parameters of the state feedback until reference or diagnosis change.

    operating_level_cm : (4,) h0 in x = h - h0. operating_V : (2,) v0, for nominal pumps. target_V : (2,) outputs in
    force. effectiveness : (2,) theta in v = (v0 + u)/theta. reason : why the target is not the reference; "" if it is.
    standby_V : (2,) voltage of a dead pump; None for a pump that works. problem : why the loop is not stable, or "".
    """

    gains: Gains
    operating_level_cm: Quad
    operating_V: Pair
    target_V: Pair
    effectiveness: Pair
    reason: str
    standby_V: tuple[float | None, float | None] = (None, None)
    problem: str = ""

    def around(self, level_cm: Quad, drive_V: Pair, target_V: Pair) -> StateFeedback:
        """The same feedback around another point; it keeps `pump_gain`, which does not depend on that."""
        moved = object.__new__(StateFeedback)
        point = {"operating_level_cm": level_cm, "operating_V": drive_V, "target_V": target_V}
        vars(moved).update(vars(self), pump_gain=self.pump_gain, **point)
        return moved

    @property
    def is_dead(self) -> tuple[bool, bool]:
        """Whether pump 1, pump 2 is dead."""
        return self.standby_V[0] is not None, self.standby_V[1] is not None

    @cached_property
    def pump_gain(self) -> tuple[float, ...]:
        """(12,) the gain in force on the pumps, by rows: levels, then integrals, divided by effectiveness."""
        return tuple(
            value / theta
            for levels, integrals, theta in zip(
                self.gains.levels_V_cm, self.gains.integrals_1_s, self.effectiveness, strict=True
            )
            for value in (*levels, *integrals)
        )


def effective_voltage(law: StateFeedback, integral_Vs: Pair, level_cm: Quad) -> Pair:
    """v0 + u in V, before effectiveness and limits."""
    p1, p2 = _level_part(law, level_cm)
    (k11, k12), (k21, k22) = law.gains.integrals_1_s
    q1, q2 = integral_Vs
    return law.operating_V[0] - p1 - k11 * q1 - k12 * q2, law.operating_V[1] - p2 - k21 * q1 - k22 * q2


def pump_voltage(law: StateFeedback, effective_V: Pair) -> Pair:
    """V = (v0 + u)/theta in V, before limits; for a dead pump its stand-by voltage."""
    v1, v2 = effective_V[0] / law.effectiveness[0], effective_V[1] / law.effectiveness[1]
    if law.standby_V == (None, None):
        return v1, v2
    s1, s2 = law.standby_V
    return v1 if s1 is None else s1, v2 if s2 is None else s2


def undelivered(law: StateFeedback, effective_V: Pair, excess_V: Pair) -> Pair:
    """(2,) requested minus applied voltage, V; for a dead pump the whole requested voltage."""
    if law.standby_V == (None, None):
        return excess_V
    (s1, s2), (t1, t2) = law.standby_V, law.effectiveness
    return (
        excess_V[0] if s1 is None else effective_V[0] / t1,
        excess_V[1] if s2 is None else effective_V[1] / t2,
    )


def bumpless_integral(law: StateFeedback, level_cm: Quad, effective_V: Pair) -> Pair:
    """The integrals q (2,) in V s for which this law gives these effective voltages.

    Used when gains or operating point change during a run, and when control takes over from MANUAL.
    """
    p1, p2 = _level_part(law, level_cm)
    d1 = law.operating_V[0] - p1 - effective_V[0]
    d2 = law.operating_V[1] - p2 - effective_V[1]
    (i11, i12), (i21, i22) = law.gains.integral_inverse
    return i11 * d1 + i12 * d2, i21 * d1 + i22 * d2


def advance_integral(
    law: StateFeedback,
    integral_Vs: Pair,
    error_V: Pair,
    excess_V: Pair,
    period_s: float,
    anti_windup_s: float,
) -> Pair:
    """The integrals q (2,) after one period: integration of the error, and anti-windup by back-calculation.

    excess_V : (2,) requested minus applied voltage. While a pump is at its limit the integrals move so that the
    requested voltage approaches the applied one with time constant anti_windup_s; the full correction is
    q -> q + K_q^-1 theta (v - v_applied).
    """
    rate = min(period_s / anti_windup_s, 1.0) if anti_windup_s > 0.0 else 1.0
    d1 = rate * law.effectiveness[0] * excess_V[0]
    d2 = rate * law.effectiveness[1] * excess_V[1]
    (i11, i12), (i21, i22) = law.gains.integral_inverse
    return (
        integral_Vs[0] + period_s * error_V[0] + i11 * d1 + i12 * d2,
        integral_Vs[1] + period_s * error_V[1] + i21 * d1 + i22 * d2,
    )


def _level_part(law: StateFeedback, level_cm: Quad) -> Pair:
    """K_x x in V."""
    (h1, h2, h3, h4), (o1, o2, o3, o4) = level_cm, law.operating_level_cm
    x1, x2, x3, x4 = h1 - o1, h2 - o2, h3 - o3, h4 - o4
    (a1, a2, a3, a4), (b1, b2, b3, b4) = law.gains.levels_V_cm
    return a1 * x1 + a2 * x2 + a3 * x3 + a4 * x4, b1 * x1 + b2 * x2 + b3 * x3 + b4 * x4
