"""What an identification returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.noise_model import root_mean_square
from hil.core.identification.parameters import RigModel
from hil.core.types import Quad

Array = NDArray[np.float64]

Status = Literal["identified", "fixed", "not identifiable"]


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """A parameter after the fit. low, high : ends of the 95 % interval; both the value where it was fixed."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    was: float
    status: Status

    @property
    def sd(self) -> float:
        """One standard deviation, from the width of the interval."""
        return (self.high - self.low) / (2.0 * 1.96)


@dataclass(frozen=True, slots=True)
class NullDirection:
    """Parameters that the records determine only together, in words, with what would tell them apart."""

    names: tuple[str, ...]
    weights: tuple[float, ...]
    text: str


@dataclass(frozen=True, eq=False)
class Prediction:
    """A record and the model's simulation of it. predicted_V : (n, 4); NaN where nothing was measured."""

    name: str
    is_held_out: bool
    time_s: Array
    voltage_V: Array
    reading_V: Array
    predicted_V: Array
    level_cm: Array

    @property
    def residuals(self) -> Array:
        """(n, 4) reading less prediction."""
        residual: Array = self.reading_V - self.predicted_V
        return residual


@dataclass(frozen=True, eq=False)
class Identification:
    """The verdict on a set of records.

    model : the rig as identified. structure : extensions that the held-out record asks for, of
    `parameters.EXTENSIONS`. holdout_rmse_V : (4,) simulation error on the held-out record, NaN for a sensor that it
    does not have; holdout_rmse_before_V : of the old model. refusal : why nothing could be identified; "" when it was.
    predictions_before : the held-out records as the old model predicts them.
    """

    model: RigModel
    parameters: tuple[FittedParameter, ...]
    null_directions: tuple[NullDirection, ...]
    structure: tuple[str, ...]
    predictions: tuple[Prediction, ...]
    holdout_rmse_V: Quad
    holdout_rmse_before_V: Quad
    refusal: str = ""
    predictions_before: tuple[Prediction, ...] = ()

    def __getitem__(self, name: str) -> FittedParameter:
        return next(parameter for parameter in self.parameters if parameter.name == name)


def simulation_rmse(predictions: Sequence[Prediction]) -> Quad:
    """(4,) of all records together; NaN of a sensor without readings."""
    if not predictions:
        return nan, nan, nan, nan
    residual: Array = np.concatenate([one.residuals for one in predictions])
    r1, r2, r3, r4 = (root_mean_square(residual[:, i]) for i in range(4))
    return r1, r2, r3, r4
