"""Linear-quadratic control with integral action, as a design of the bench."""

import numpy as np
from scipy.linalg import solve_continuous_are

import hil


class LqrDesign:
    """Minimises the integral of x'Qx + u'u for the state [levels; integrals of the errors]."""

    follows_reference = True

    def __init__(self, level_weight: float) -> None:
        self._Q = np.diag([level_weight, level_weight, 0.01, 0.01, 0.02, 0.02])

    def gains(self, linear: hil.LinearModel) -> hil.Gains:
        """Gains for u = -K [h - h0; q], with q' = r - y."""
        A = np.block([[linear.A, np.zeros((4, 2))], [-linear.C, np.zeros((2, 2))]])
        B = np.vstack([linear.B, np.zeros((2, 2))])
        return hil.Gains.from_matrix(B.T @ solve_continuous_are(A, B, self._Q, np.eye(2)))


def make_design(rig):
    """The bench calls this with the settings of the rig file, `rig.tanks`, `rig.pumps`, `rig.control`, ..."""
    return LqrDesign(level_weight=0.1 * (0.5 / rig.tank_model.level_gain_V_cm) ** 2)
