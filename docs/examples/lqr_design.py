"""A design of your own: linear-quadratic control with integral action, on the paper's experiment."""

import numpy as np
from scipy.linalg import solve_continuous_are

import hil


class LqrDesign:
    """Minimises the integral of x'Qx + u'Ru for the state [levels; integrals of the errors]."""

    follows_reference = True  # gains are computed again for each operating point

    def gains(self, linear: hil.LinearModel) -> hil.Gains:
        """Gains for u = -K [h - h0; q], with q' = r - y."""
        A = np.block([[linear.A, np.zeros((4, 2))], [-linear.C, np.zeros((2, 2))]])
        B = np.vstack([linear.B, np.zeros((2, 2))])
        Q = np.diag([0.1, 0.1, 0.01, 0.01, 0.02, 0.02])
        return hil.Gains.from_matrix(B.T @ solve_continuous_are(A, B, Q, np.eye(2)))


if __name__ == "__main__":
    for design in ("rig", LqrDesign()):
        result = hil.simulate("paper", design=design)
        first, second = result.iae_Vs["reference_step"]
        print(f"{result.settings['scenario']['control']['design']:10} IAE {first:.3f}, {second:.3f} V s")
