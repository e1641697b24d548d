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

from hil.core.identification.candidates import candidates
from hil.core.identification.estimate import RigEstimate, estimate
from hil.core.identification.held_out import split
from hil.core.identification.null_directions import Identifiability, described, identifiability, moves, plausible
from hil.core.identification.parameters import PARAMETERS, Choice, RigModel, values_of
from hil.core.identification.problem import Priors
from hil.core.identification.records import LevelRecord
from hil.core.identification.refusals import at_rest, misfit, refused, unusable
from hil.core.identification.result import (
    FittedParameter,
    Identification,
    NullDirection,
    Prediction,
    Status,
    simulation_rmse,
)
from hil.core.identification.robust_fit import fit_initial
from hil.core.identification.simulation import levels, prediction, simulate
from hil.core.identification.starting import starting_point
from hil.core.identification.structure import choose_structure, confirmed

WEAK_PRIOR = 3.0


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
    training, judges = split(tuple(records), held_out)
    choices = dict(choices or {})
    extensions = candidates(training, start, choices, structures)
    reason = unusable(training)
    if reason:
        return refused(start, reason)
    begin = starting_point(training, start, choices, extensions)
    weak = Priors(values_of(begin), {n: WEAK_PRIOR * plausible(n, v) for n, v in values_of(begin).items()})
    is_at_rest = not any(moves(training, pump) for pump in (0, 1))
    if is_at_rest:
        told, null = _null_directions(estimate(training, begin, choices, weak), training)
        if told.undetermined:
            return refused(start, at_rest(told), null)
    chosen = choose_structure(training, judges, begin, start, extensions, choices, weak)
    groups, settled, found = confirmed(training, chosen, start, choices, weak)
    told, null = _null_directions(found, training)
    if told.undetermined:
        found = _with_priors(found, told, training, start, settled, weak)
    reason = misfit(found, _predicted(found, training))
    if not found.is_converged and told.undetermined:
        reason = at_rest(told) if is_at_rest else f"{reason}: {null[0].text}" if null else reason
    if reason:
        return refused(start, reason, null)
    return _result(found, told, null, groups, start, training, judges)


def _null_directions(
    found: RigEstimate, records: Sequence[LevelRecord]
) -> tuple[Identifiability, tuple[NullDirection, ...]]:
    """What the records do not determine, and the same in words."""
    told = identifiability(found.normal.white.sensitivity, found.normal.ruler, found.names, found.values.tolist())
    return told, described(told, records, [record.level_cm for record in _predicted(found, records)])


def _with_priors(
    found: RigEstimate,
    told: Identifiability,
    records: Sequence[LevelRecord],
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
    return estimate(records, found.problem.base, settled, Priors(centre, sd), near=near)


def _predicted(found: RigEstimate, records: Sequence[LevelRecord]) -> list[Prediction]:
    model = found.model
    return [
        prediction(model, record, levels(model, record, found.initial(at)).level_cm)
        for at, record in enumerate(records)
    ]


def _judged(model: RigModel, judges: Sequence[LevelRecord]) -> tuple[Prediction, ...]:
    return tuple(simulate(model, record, fit_initial(model, record), is_held_out=True) for record in judges)


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
        holdout_rmse_V=simulation_rmse(judged),
        holdout_rmse_before_V=simulation_rmse(before),
        predictions_before=before,
    )
