"""When the steps to the minimum may end."""

import numpy as np

from hil.core.identification.gauss_newton import is_settled
from hil.core.identification.noise_model import Whitened
from hil.core.identification.problem import Normal

NAMES = ("k1", "h4 of fast")
NONE = np.zeros(0)


def normal(sensitivity: np.ndarray, residual: np.ndarray) -> Normal:
    channel = np.zeros(len(residual), dtype=np.int64)
    white = Whitened(residual, sensitivity, channel, np.arange(len(residual)), 0.0)
    return Normal(white, np.zeros((2, 2)), np.zeros(2), 0.0, np.zeros(2), np.zeros(2), 0.0)


def test_a_level_that_goes_to_and_fro_at_zero_does_not_keep_the_fit_from_its_end() -> None:
    """A rig was refused for one initial level of 0.003 cm, though no parameter would have moved by 0.1 sd.

    The unknowns are known to 0.01 and 0.1: the square of a step over these is what it gains.
    """
    at = normal(np.diag([100.0, 10.0]), np.array([0.1, 1.1]))
    assert is_settled(NAMES, at, np.array([0.001, 0.11])), "0.1 and 1.1 standard deviations: a gain of 1.2"
    assert not is_settled(("k1", "k2"), at, np.array([0.001, 0.11])), "both are parameters"
    far = normal(np.diag([100.0, 10.0]), np.array([0.1, 2.2]))
    assert not is_settled(NAMES, far, np.array([0.001, 0.22])), "a gain of 4.8 is too much for a level, too"
    moving = normal(np.diag([100.0, 10.0]), np.array([0.3, 1.0]))
    assert not is_settled(NAMES, moving, np.array([0.003, 0.1])), "k1 by 0.3 standard deviations"
    assert is_settled(NAMES, normal(np.diag([100.0, 10.0]), np.array([0.9, 0.3])), np.array([0.009, 0.03]))
