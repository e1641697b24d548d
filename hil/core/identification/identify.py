"""From records to a verdict: values with intervals, the structure, what can't be told, or why nothing can.

    1  refuse records that can't tell anything: too few readings, no movement
    2  choose the structure by the held-out record (`structure`)
    3  estimate, with the noise model (`estimate`)
    4  find what the records do not determine (`null_directions`); such parameters get a prior around the file's value,
       so that their values are the nearest to the file that predict the records, and their intervals stay wide
    5  refuse if the model does not fit, or if nothing is determined

Why so: `docs/decisions/0030-intervals-and-structure.md`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan

import numpy as np

from hil.core.counted import counted
from hil.core.identification.estimate import RigEstimate, estimate
from hil.core.identification.noise_model import Array, root_mean_square
from hil.core.identification.null_directions import (
    Identifiability,
    described,
    identifiability,
    listed,
    moves,
    plausible,
)
from hil.core.identification.parameters import (
    BASIC,
    BY_NAME,
    EXTENSIONS,
    PARAMETERS,
    Choice,
    RigModel,
    values_of,
)
from hil.core.identification.problem import Priors
from hil.core.identification.records import LevelRecord
from hil.core.identification.result import FittedParameter, Identification, NullDirection, Prediction, Status
from hil.core.identification.robust_fit import fit_initial
from hil.core.identification.simulation import levels, prediction, simulate
from hil.core.identification.starting import starting_point
from hil.core.identification.structure import choose_structure
from hil.core.identification.unknowns import FREE
from hil.core.types import Quad

MIN_READINGS = 200
MIN_DURATION_S = 20.0
TRAINING_SHARE = 0.7
RIM_MARGIN_CM = 0.3
WEAK_PRIOR = 3.0
MIN_MISFIT_V, MAX_MISFIT_V, MAX_MISFIT_SD = 0.1, 0.5, 20.0


def identify(
    records: Sequence[LevelRecord],
    start: RigModel,
    *,
    held_out: Sequence[LevelRecord] | LevelRecord | None = None,
    choices: Mapping[str, Choice] | None = None,
    structures: Sequence[str] | None = None,
) -> Identification:
    """Identify a rig from records, starting from what its file says.

    held_out : records that only judge; None: the last record, or the last 30 % of the only one. choices : of
    parameters or groups that are settled: free, fixed, or with a prior. structures : extensions that may be chosen, of
    `parameters.EXTENSIONS`; None: all that the records can tell at all.

    Never raises for what records contain: it returns an `Identification` with a refusal. Raises ValueError for an
    unknown name of a choice or structure.
    """
    training, judges = _split(tuple(records), held_out)
    choices = dict(choices or {})
    candidates = _candidates(training, start, choices, structures)
    reason = _unusable(training)
    if reason:
        return _refused(start, reason)
    begin = starting_point(training, start, choices, candidates)
    weak = Priors(values_of(begin), {n: WEAK_PRIOR * plausible(n, v) for n, v in values_of(begin).items()})
    if not any(moves(training, pump) for pump in (0, 1)):
        found = estimate(training, begin, choices, weak)
        told = _identifiability(found)
        null = described(told, training, [record.level_cm for record in _predicted(found, training)])
        if told.undetermined:
            return _refused(start, _at_rest(told), null)
    chosen = choose_structure(training, judges, begin, start, candidates, choices, weak)
    begin = chosen.estimate.problem.base
    settled = {**dict.fromkeys(chosen.groups, FREE), **choices, **chosen.fixed}
    near = dict(zip(chosen.estimate.names, chosen.estimate.values.tolist(), strict=True))
    found = estimate(training, begin, settled, weak, near=near)
    told = _identifiability(found)
    null = described(told, training, [record.level_cm for record in _predicted(found, training)])
    if told.undetermined:
        found = _with_priors(found, told, training, begin, start, settled, weak)
    reason = _misfit(found, training)
    if not found.is_converged and told.undetermined:
        is_at_rest = not any(moves(training, pump) for pump in (0, 1))
        reason = _at_rest(told) if is_at_rest else f"{reason}: {null[0].text}" if null else reason
    if reason:
        return _refused(start, reason, null)
    return _result(found, told, null, chosen.groups, start, training, judges)


def _split(
    records: tuple[LevelRecord, ...], held_out: Sequence[LevelRecord] | LevelRecord | None
) -> tuple[tuple[LevelRecord, ...], tuple[LevelRecord, ...]]:
    if isinstance(held_out, LevelRecord):
        return records, (held_out,)
    if held_out is not None:
        return records, tuple(held_out)
    if not records:
        return (), ()
    if len(records) > 1:
        return records[:-1], records[-1:]
    first, second = _cut(records[0])
    return (first,), (second,)


def _cut(record: LevelRecord) -> tuple[LevelRecord, LevelRecord]:
    """A record's beginning to learn from, and its end to judge by."""
    n = len(record.time_s)
    at = min(max(int(TRAINING_SHARE * n), 2), n - 2)
    cut_s = float(record.time_s[at])

    def part(rows: slice, name: str, initial_cm: Quad, is_first: bool) -> LevelRecord:
        return replace(
            record,
            name=name,
            time_s=record.time_s[rows],
            voltage_V=record.voltage_V[rows],
            reading_V=record.reading_V[rows],
            samples=None if record.samples is None else record.samples[rows],
            initial_cm=initial_cm,
            ruler=tuple(read for read in record.ruler if (read.time_s < cut_s) == is_first),
        )

    if n < 4:
        return record, record
    return (
        part(slice(0, at), record.name, record.initial_cm, True),
        part(slice(at, n), f"{record.name}, held out", (nan, nan, nan, nan), False),
    )


def _candidates(
    records: Sequence[LevelRecord],
    start: RigModel,
    choices: Mapping[str, Choice],
    structures: Sequence[str] | None,
) -> tuple[str, ...]:
    """The extensions that may be chosen."""
    for name in structures or ():
        if name not in EXTENSIONS:
            raise ValueError(f"structure {name!r}: must be one of {', '.join(EXTENSIONS)}")
    groups = {row.group for row in PARAMETERS}
    for key in choices:
        if key not in groups and key not in BY_NAME:
            raise ValueError(f"choice for {key!r}: no parameter and no group of that name")
    settled = {BY_NAME[key].group if key in BY_NAME else key for key in choices}
    wanted = EXTENSIONS if structures is None else tuple(structures)
    can_tell = {
        "sensor_gain": any(record.ruler for record in records),
        "overflow": any(_reaches_rim(record, start) for record in records),
    }
    return tuple(
        group for group in wanted if group not in settled and (structures is not None or can_tell.get(group, True))
    )


def _reaches_rim(record: LevelRecord, start: RigModel) -> bool:
    for tank in (2, 3):
        gain, offset_V = start.sensors.gain_V_cm[tank], start.sensors.offset_V[tank]
        level_cm = (record.reading_V[:, tank] - offset_V) / gain
        known = level_cm[np.isfinite(level_cm)]
        if len(known) and float(np.quantile(known, 0.999)) > start.tanks.height_cm[tank] - RIM_MARGIN_CM:
            return True
    return False


def _unusable(records: Sequence[LevelRecord]) -> str:
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


def _identifiability(found: RigEstimate) -> Identifiability:
    return identifiability(found.normal.white.sensitivity, found.normal.ruler, found.names, found.values.tolist())


def _with_priors(
    found: RigEstimate,
    told: Identifiability,
    records: Sequence[LevelRecord],
    begin: RigModel,
    start: RigModel,
    settled: Mapping[str, Choice],
    weak: Priors,
) -> RigEstimate:
    """The estimate with the file's values as priors of what the records do not determine."""
    own = values_of(start)
    centre, sd = dict(weak.centre), dict(weak.sd)
    for name in told.undetermined:
        centre[name], sd[name] = own[name], plausible(name, own[name])
    near = dict(zip(found.names, found.values.tolist(), strict=True))
    return estimate(records, begin, settled, Priors(centre, sd), near=near)


def _misfit(found: RigEstimate, records: Sequence[LevelRecord]) -> str:
    """Why the model does not fit the records; "" if it does."""
    if not found.is_converged:
        return "the fit did not converge"
    noise_V = np.array(found.noise.noise_V)
    for record in _predicted(found, records):
        for tank, rmse_V in enumerate(_rmse([record])):
            if rmse_V > min(max(MIN_MISFIT_V, MAX_MISFIT_SD * noise_V[tank]), MAX_MISFIT_V):
                return (
                    f"the model does not fit record {record.name!r}: it misses sensor {tank + 1} by {rmse_V:.3g} V "
                    f"(RMS), with a noise of {noise_V[tank]:.2g} V"
                )
    return ""


def _at_rest(told: Identifiability) -> str:
    return (
        f"neither pump moved in these records, so that {listed(told.undetermined)} can't be told apart: "
        "records are needed in which each pump steps between several voltages"
    )


def _predicted(found: RigEstimate, records: Sequence[LevelRecord]) -> list[Prediction]:
    model = found.model
    return [
        prediction(model, record, levels(model, record, found.initial(at)).level_cm)
        for at, record in enumerate(records)
    ]


def _judged(model: RigModel, judges: Sequence[LevelRecord]) -> tuple[Prediction, ...]:
    return tuple(simulate(model, record, fit_initial(model, record), is_held_out=True) for record in judges)


def _rmse(predictions: Sequence[Prediction]) -> Quad:
    if not predictions:
        return nan, nan, nan, nan
    residual: Array = np.concatenate([one.residuals for one in predictions])
    r1, r2, r3, r4 = (root_mean_square(residual[:, i]) for i in range(4))
    return r1, r2, r3, r4


def _result(
    found: RigEstimate,
    told: Identifiability,
    null: tuple[NullDirection, ...],
    groups: Sequence[str],
    start: RigModel,
    training: Sequence[LevelRecord],
    judges: Sequence[LevelRecord],
) -> Identification:
    model = found.model
    own, was = values_of(model), values_of(start)
    parameters = []
    for row in PARAMETERS:
        value = own[row.name]
        low, high = found.interval(row.name) if row.name in found.names else (value, value)
        status: Status = "fixed" if row.name not in found.names else "identified"
        if row.name in told.undetermined:
            status = "not identifiable"
        parameters.append(FittedParameter(row.name, value, low, high, row.unit, was[row.name], status))
    judged, before = _judged(model, judges), _judged(start, judges)
    return Identification(
        model=model,
        parameters=tuple(parameters),
        null_directions=null,
        structure=tuple(groups),
        predictions=(*_predicted(found, training), *judged),
        holdout_rmse_V=_rmse(judged),
        holdout_rmse_before_V=_rmse(before),
        predictions_before=before,
    )


def _refused(start: RigModel, reason: str, null: tuple[NullDirection, ...] = ()) -> Identification:
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
