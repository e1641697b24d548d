"""How far the parameters may be off the rig file before the first reading: standard deviations by state."""

from __future__ import annotations

import numpy as np

from hil.core.diagnosis.glr.model import BEND, LAG, LEAK, OUTLET, SCALE, SPLIT, ZONE, Array, N
from hil.core.diagnosis.glr.tuning import Tuning
from hil.core.uncertainty import Uncertainty


def prior_of(tuning: Tuning, uncertainty: Uncertainty | None) -> Array:
    """(N,) as the rig file has it. uncertainty : None for that of the tuning."""
    std = np.zeros(N)
    std[SPLIT:LEAK] = std[SCALE : SCALE + 2] = tuning.parameter_std
    std[LAG : LAG + 2] = tuning.lag_std
    if uncertainty is not None:
        std[SCALE : SCALE + 2], std[SPLIT : SPLIT + 2] = uncertainty.pump_gain, uncertainty.valve_split
        std[OUTLET : OUTLET + 4], std[LAG : LAG + 2] = uncertainty.outlet, uncertainty.lag
    return std


def wide_prior_of(tuning: Tuning, prior: Array) -> Array:
    """(N,) as for a rig that its file does not describe."""
    std = np.zeros(N)
    std[SCALE : SCALE + 2], std[LAG : LAG + 2] = tuning.wide_gain_std, tuning.wide_lag_std
    std[OUTLET : OUTLET + 4], std[LEAK : LEAK + 2] = tuning.wide_outlet_std, tuning.passing_std
    std[ZONE : ZONE + 2], std[BEND : BEND + 2] = tuning.zone_std_V, tuning.bend_std_1_V
    return np.maximum(std, prior)
