"""The fit behind `hil identify`: from records to an `Identification`.

For now with the basic structure and intervals by linear theory.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.core.identification.fit import fit, fit_initial
from hil.core.identification.parameters import PARAMETERS, RigModel, values_of
from hil.core.identification.records import LevelRecord
from hil.core.identification.result import FittedParameter, Identification, Prediction
from hil.core.identification.simulation import simulate
from hil.core.types import Quad

WIDTH = 1.96


def identified(records: Sequence[LevelRecord], held_out: Sequence[LevelRecord], start: RigModel) -> Identification:
    """Fit the records, and predict those that were held out by the old and by the new model."""
    result = fit(records, start)
    deviations = dict(zip(result.names, np.sqrt(np.diag(result.covariance())).tolist(), strict=True))
    was, values = values_of(start), values_of(result.model)
    parameters = tuple(
        FittedParameter(
            row.name,
            values[row.name],
            values[row.name] - WIDTH * deviations.get(row.name, 0.0),
            values[row.name] + WIDTH * deviations.get(row.name, 0.0),
            row.unit,
            was[row.name],
            "identified" if row.name in deviations else "fixed",
        )
        for row in PARAMETERS
    )
    after = tuple(simulate(result.model, one, fit_initial(result.model, one), True) for one in held_out)
    before = tuple(simulate(start, one, fit_initial(start, one), True) for one in held_out)
    return Identification(
        model=result.model,
        parameters=parameters,
        null_directions=(),
        structure=(),
        predictions=(*result.predictions, *after),
        holdout_rmse_V=_rmse(after),
        holdout_rmse_before_V=_rmse(before),
        predictions_before=before,
    )


def _rmse(predictions: Sequence[Prediction]) -> Quad:
    """(4,) root mean square of the residuals, NaN without any."""
    values = []
    for sensor in range(4):
        residuals = [one.residuals[:, sensor] for one in predictions]
        squares = np.concatenate(residuals) ** 2 if residuals else np.empty(0)
        squares = squares[np.isfinite(squares)]
        values.append(float(np.sqrt(squares.mean())) if len(squares) else float("nan"))
    r1, r2, r3, r4 = values
    return r1, r2, r3, r4
