"""What the detector knows before a run and does not change during it: its tuning and the rig's numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.core.diagnosis.glr import kernels
from hil.core.diagnosis.glr.filter import PERIOD, StepResult
from hil.core.diagnosis.glr.model import LEAK, SCALE, SPLIT, Array, FilterModel, N
from hil.core.diagnosis.glr.prior import prior_of, wide_prior_of
from hil.core.diagnosis.glr.tuning import Tuning
from hil.core.sensors import PLAIN, LevelSensors
from hil.core.tanks import TankModel
from hil.core.types import Pair, Quad
from hil.core.uncertainty import Uncertainty

EMPTY_STDS = 6.0
"""A reading of fewer standard deviations of the noise may be that of an empty tank."""

MIN_LAG_S = 1e-3
"""The filter divides by the lag."""


@dataclass(frozen=True, eq=False)
class DetectorConfig:
    """What doesn't change during a run: tuning, the rig's numbers. All voltages are level signals and drives.

    noise_V : (4,) of a reading. floor_V2 : (4,) smallest variance of a mean of readings. empty_V : (4,) below it a
    converter cuts the noise off, as in an empty tank: see `shows_level`. range_V : (2,) of each pump.
    prior, wide_prior : (N,) standard deviation of the parameters before the first reading, as the rig file has it, and
    for a rig that it does not describe.
    """

    tuning: Tuning
    model: FilterModel
    noise_V: Quad
    floor_V2: Quad
    empty_V: Quad
    range_V: tuple[Pair, Pair]
    prior: Array
    wide_prior: Array

    @classmethod
    def of(
        cls,
        model: TankModel,
        lag_s: Pair,
        noise_V: Quad,
        tuning: Tuning,
        range_V: tuple[Pair, Pair] = ((0.0, 10.0), (0.0, 10.0)),
        sensors: LevelSensors = PLAIN,
        uncertainty: Uncertainty | None = None,
    ) -> DetectorConfig:
        """From the rig file's numbers. uncertainty : None for that of the tuning."""
        walk = np.zeros(N)
        walk[SPLIT:LEAK] = walk[SCALE : SCALE + 2] = tuning.parameter_walk**2
        speed = float(np.sqrt(2.0 * model.gravity_cm_s2))
        filter_model = FilterModel(
            area_cm2=np.array(model.area_cm2),
            outlet_flow=np.array([a * speed for a in model.outlet_cm2]),
            pump_gain_cm3_Vs=np.array(model.pump_gain_cm3_Vs),
            valve_split=np.array(model.valve_split),
            walk=walk,
            lag_s=np.maximum(np.array(lag_s), MIN_LAG_S),
            level_gain_V_cm=model.level_gain_V_cm,
            height_cm=np.array(model.height_cm),
            datum_cm=np.array(model.datum_cm),
        )
        floor_V, prior = tuning.reading_floor_V, prior_of(tuning, uncertainty)
        f1, f2, f3, f4 = (floor**2 for floor in sensors.scaled((floor_V, floor_V, floor_V, floor_V)))
        e1, e2, e3, e4 = (low + EMPTY_STDS * noise for low, noise in zip(sensors.lowest_signals, noise_V, strict=True))
        return cls(
            tuning=tuning,
            model=filter_model,
            noise_V=noise_V,
            floor_V2=(f1, f2, f3, f4),
            empty_V=(e1, e2, e3, e4),
            range_V=range_V,
            prior=prior,
            wide_prior=wide_prior_of(tuning, prior),
        )

    def shows_level(self, i: int, reading_V: float, expected_V: float) -> bool:
        """Whether the reading of sensor i (0 to 3) is used: not where the tank may be empty and the noise is cut off.

        expected_V : by the filter, before the reading. Near the empty tank it decides: a limit on the reading itself
        would keep those of a shallow tank that are too high and drop those that are too low.
        """
        empty_V, near_V = self.empty_V[i], self.empty_V[i] + EMPTY_STDS * self.noise_V[i]
        if expected_V > near_V:
            return reading_V > empty_V
        return expected_V > empty_V or reading_V > near_V

    def filter_beside(self, x: Array, P: Array, entry: Array, target: int) -> float:
        """One step of a filter beside the main one, in place; the log-likelihood of the readings.

        target : what grows in it, see `growth`.
        """
        kernels.grow(x, P, target, entry[PERIOD])
        return kernels.filter_step(self.model, x, P, entry, StepResult.empty())
