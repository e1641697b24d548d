"""Why records, or what was found from them, are refused; in words."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan

import numpy as np

from hil.core.counted import counted
from hil.core.identification.estimate import RigEstimate
from hil.core.identification.null_directions import Identifiability, listed, plausible
from hil.core.identification.parameters import BASIC, PARAMETERS, RigModel, values_of
from hil.core.identification.records import LevelRecord
from hil.core.identification.result import (
    FittedParameter,
    Identification,
    NullDirection,
    Prediction,
    Status,
    simulation_rmse,
)

MIN_READINGS = 200
MIN_DURATION_S = 20.0
MIN_MISFIT_V, MAX_MISFIT_V, MAX_MISFIT_SD = 0.1, 0.5, 20.0


def unusable(records: Sequence[LevelRecord]) -> str:
    """Why these records can't be used at all; "" if they can."""
    if not records:
        return "there is no record"
    count = sum(int(np.isfinite(record.reading_V).sum()) for record in records)
    if count < MIN_READINGS:
        return f"the records hold {counted(count, 'reading')}: at least {MIN_READINGS} are needed"
    duration_s = sum(float(record.time_s[-1] - record.time_s[0]) for record in records)
    if duration_s < MIN_DURATION_S:
        return f"the records last {duration_s:.3g} s: at least {MIN_DURATION_S:g} s are needed"
    return ""


def at_rest(told: Identifiability) -> str:
    """What records without movement do not tell."""
    return (
        f"neither pump moved in these records, so that {listed(told.undetermined)} can't be told apart: "
        "records are needed in which each pump steps between several voltages"
    )


def misfit(found: RigEstimate, predicted: Sequence[Prediction]) -> str:
    """Why the model does not fit the records; "" if it does."""
    if not found.is_converged:
        return "the fit did not converge"
    noise_V = np.array(found.noise.noise_V)
    for record in predicted:
        for tank, missed_V in enumerate(simulation_rmse([record])):
            if missed_V > min(max(MIN_MISFIT_V, MAX_MISFIT_SD * noise_V[tank]), MAX_MISFIT_V):
                return (
                    f"the model does not fit record {record.name!r}: it misses sensor {tank + 1} by {missed_V:.3g} V "
                    f"(RMS), with a noise of {noise_V[tank]:.2g} V"
                )
    return ""


def refused(start: RigModel, reason: str, null: tuple[NullDirection, ...] = ()) -> Identification:
    """Nothing is identified: the rig stays as its file has it, with the reason."""
    was = values_of(start)
    parameters = []
    for row in PARAMETERS:
        value = was[row.name]
        is_wanted = row.group in BASIC
        half = 1.96 * plausible(row.name, value) if is_wanted else 0.0
        status: Status = "not identifiable" if is_wanted else "fixed"
        parameters.append(FittedParameter(row.name, value, value - half, value + half, row.unit, value, status))
    unknown = (nan, nan, nan, nan)
    return Identification(
        model=start,
        parameters=tuple(parameters),
        null_directions=null,
        structure=(),
        predictions=(),
        holdout_rmse_V=unknown,
        holdout_rmse_before_V=unknown,
        refusal=reason,
    )
