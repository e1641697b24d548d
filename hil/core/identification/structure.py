"""The structure: which extensions of the basic model the data ask for, decided by a record that no fit has seen.

The models are nested: each extension (dead zone, curve, delay, datum, sensor gains, sensor offsets, share of the
overflow) is free, or is as the file has it. The search begins with all of them and takes away the one with the weakest
evidence (Wald's statistic over its number of parameters), fits again, and predicts the held-out record with both. The
extension goes unless the prediction without it is worse by more than chance: both predictions are whitened with the
same noise model, so that the difference of their sums of squares would be about minus its number of parameters for an
extension that is not there, with a standard deviation of about twice the square root of it. The margin is four times
that: fewer parameters win where both predict alike. An extension that moves no sensor's prediction by a fifth of the
noise of one reading (RMS) goes in any case: so small an effect may as well come from something that the model does not
have, such as turbulence in an empty tank. And one goes whose values differ from the file's by no more than chance in
the fit itself (Wald's statistic within 99.9 % of the chi-squared distribution): with waves and turbulence a held-out
record may be predicted worse by accident, but then the fit does not see the extension. A better fit alone keeps
nothing. The readings by a ruler count beside the held-out record: sensor gains of a side that are wrong alike change no
predicted voltage, but they do the levels.

Where the records leave basic parameters undetermined (a pump that never moved), a held-out record in which they matter
can't judge: then, and only then, the fit itself does, with the margin of Schwarz's criterion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, log, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from hil.core.identification.estimate import RigEstimate, estimate
from hil.core.identification.gauss_newton import minimise
from hil.core.identification.intervals import scaled_inverse
from hil.core.identification.noise_model import NoiseModel
from hil.core.identification.null_directions import identifiability, plausible
from hil.core.identification.parameters import BASIC, BY_NAME, PARAMETERS, Choice, RigModel, values_of, with_values
from hil.core.identification.problem import Priors, Problem
from hil.core.identification.records import LevelRecord
from hil.core.identification.unknowns import FIXED, FREE, unknowns

Array = NDArray[np.float64]

MARGIN_FIXED, MARGIN_SD = 6.0, 4.0
REDUCED_STEPS = 6
NOTICEABLE = 0.2
SIGNIFICANT = 0.999
GIVEN_UP_FIRST = ("overflow", "delay", "sensor_gain", "curve", "datum", "sensor_offset", "dead_zone")


@dataclass(frozen=True, eq=False)
class StructureChoice:
    """groups : the extensions that stay. fixed : parameters of them that the records can't determine.

    estimate : with them. trace : each decision: group, how much worse the prediction is without it, whether it stays.
    """

    groups: tuple[str, ...]
    fixed: Mapping[str, Choice]
    estimate: RigEstimate
    trace: tuple[tuple[str, float, bool], ...]


@dataclass(frozen=True, eq=False)
class HeldOutScore:
    """square : sum of the squared white residuals, those of the readings by a ruler among them.

    ruler_square : the latter's part. residual_V : (n, 4) of all held-out records; empty without records.
    """

    square: float
    ruler_square: float
    residual_V: Array

    def difference(self, other: HeldOutScore, noise: NoiseModel) -> float:
        """The largest RMS difference of both predictions among the sensors, over the noise of one reading."""
        if not len(self.residual_V):
            return inf
        away = self.residual_V - other.residual_V
        shares = [
            float(np.sqrt(np.mean(column**2))) / sd_V
            for column, sd_V in zip([c[np.isfinite(c)] for c in away.T], noise.noise_V, strict=True)
            if len(column)
        ]
        return max(shares, default=inf)


def judged(found: RigEstimate, records: Sequence[LevelRecord], noise: NoiseModel) -> HeldOutScore:
    """A simulation of records that were not fitted; unknown initial levels are. Without records: the fit itself.

    The readings by a ruler judge, too, though they were fitted: held-out voltages can't tell sensor gains of a side
    that are wrong alike.
    """
    by_ruler = found.normal.ruler_square
    if not records:
        return HeldOutScore(found.normal.cost, by_ruler, np.zeros((0, 4)))
    model = found.model
    wanted = unknowns(records, model, {row.group: FIXED for row in PARAMETERS})
    problem = Problem(tuple(records), model, wanted, Priors({}, {}))
    values, square = wanted.start, 0.0
    if wanted.names:
        values, normal, _ = minimise(problem, values, noise)
        square = normal.cost
    else:
        square = problem.normal(values, noise).cost
    linear, _, _ = problem.linearised(values, None)
    return HeldOutScore(square + by_ruler, by_ruler, np.concatenate([record.residual_V for record in linear]))


def choose_structure(
    records: Sequence[LevelRecord],
    held_out: Sequence[LevelRecord],
    start: RigModel,
    file: RigModel,
    candidates: Sequence[str],
    choices: Mapping[str, Choice],
    priors: Priors,
) -> StructureChoice:
    """Take extensions away as long as the held-out records are predicted as well.

    start : from which the fit begins. file : the values of an extension that is taken away. candidates : groups.
    """
    full = estimate(records, start, {**choices, **dict.fromkeys(candidates, FREE)}, priors)
    lost, is_judged = hopeless(full, candidates)
    choices = {**choices, **dict.fromkeys(lost, FIXED)}
    kept = [group for group in candidates if any(r.group == group and r.name not in lost for r in PARAMETERS)]
    start = as_in_file(start, file, [group for group in candidates if group not in kept], lost)
    current = full
    if lost:
        near = dict(zip(full.names, full.values.tolist(), strict=True))
        current = estimate(records, start, {**dict.fromkeys(kept, FREE), **choices}, priors, near=near)
    search = _Search(records, held_out if is_judged else (), tuple(kept), start, file, choices, priors, current.noise)
    now = judged(current, search.judges, search.noise)
    settled: set[str] = set()
    trace = []
    while len(settled) < len(kept):
        group = min((name for name in kept if name not in settled), key=lambda name: evidence(current, file, name))
        reduced = search.without(current, kept, group)
        score = judged(reduced, search.judges, search.noise)
        worse = score.square - now.square
        margin = _margin(current, len(_group(current, file, group)[0]), is_judged)
        by_ruler = score.ruler_square - now.ruler_square > margin
        is_noticeable = by_ruler or score.difference(now, search.noise) > NOTICEABLE
        is_needed = worse > margin and is_noticeable and is_significant(current, file, group)
        trace.append((group, worse, is_needed))
        if is_needed:
            settled.add(group)
        else:
            kept, current, now = [name for name in kept if name != group], reduced, score
    groups = tuple(group for group in candidates if group in kept)
    return StructureChoice(groups, dict.fromkeys(lost, FIXED), current, tuple(trace))


def confirmed(
    records: Sequence[LevelRecord],
    chosen: StructureChoice,
    file: RigModel,
    choices: Mapping[str, Choice],
    priors: Priors,
) -> tuple[tuple[str, ...], Mapping[str, Choice], RigEstimate]:
    """The extensions that are significant in an estimate with a noise model of its own, the choices, and that estimate.

    The search keeps the noise of the fit with all extensions, which may have taken turbulence for a dead zone.
    """
    groups, found = chosen.groups, chosen.estimate
    while True:
        base = as_in_file(found.problem.base, file, [group for group in chosen.groups if group not in groups])
        settled = {**dict.fromkeys(groups, FREE), **choices, **chosen.fixed}
        near = dict(zip(found.names, found.values.tolist(), strict=True))
        found = estimate(records, base, settled, priors, near=near)
        doubtful = [group for group in groups if not is_significant(found, file, group)]
        if not doubtful:
            return groups, settled, found
        weakest = min(doubtful, key=lambda group: evidence(found, file, group))
        groups = tuple(group for group in groups if group != weakest)


@dataclass(frozen=True, eq=False)
class _Search:
    """What stays the same while extensions are taken away.

    candidates : those that the records can tell. noise : of the fit with all of them, for all fits.
    """

    records: Sequence[LevelRecord]
    judges: Sequence[LevelRecord]
    candidates: Sequence[str]
    start: RigModel
    file: RigModel
    choices: Mapping[str, Choice]
    priors: Priors
    noise: NoiseModel

    def without(self, current: RigEstimate, kept: Sequence[str], group: str) -> RigEstimate:
        """The estimate with these extensions but one, which is as in the file; from the current one on."""
        fewer = [name for name in kept if name != group]
        gone = [name for name in self.candidates if name not in fewer]
        return estimate(
            self.records,
            as_in_file(self.start, self.file, gone),
            {**dict.fromkeys(fewer, FREE), **self.choices},
            self.priors,
            near=reduced_values(current, self.file, group),
            noise=self.noise,
            max_steps=REDUCED_STEPS,
        )


def hopeless(full: RigEstimate, candidates: Sequence[str]) -> tuple[tuple[str, ...], bool]:
    """Parameters of extensions that the records can't determine, and whether they determine all basic parameters.

    Where two extensions are known only together, the one that comes first in `GIVEN_UP_FIRST` is given up.
    """
    rows, ruler = full.normal.white.sensitivity, full.normal.ruler
    keep = np.arange(len(full.names))
    lost: list[str] = []
    while True:
        names, values = [full.names[i] for i in keep], full.values[keep].tolist()
        told = identifiability(rows[:, keep], ruler[np.ix_(keep, keep)], names, values)
        unknown = [name for name in told.undetermined if BY_NAME[name].group in candidates]
        if not unknown:
            return tuple(lost), not any(BY_NAME[name].group in BASIC for name in told.undetermined)
        first = min((BY_NAME[name].group for name in unknown), key=GIVEN_UP_FIRST.index)
        now = [name for name in unknown if BY_NAME[name].group == first]
        lost += now
        keep = np.array([i for i in keep if full.names[i] not in now])


def _margin(found: RigEstimate, count: int, is_judged: bool) -> float:
    if is_judged:
        return MARGIN_FIXED + MARGIN_SD * sqrt(count)
    return MARGIN_FIXED + count * log(max(len(found.normal.white.residual), 2))


def as_in_file(model: RigModel, file: RigModel, groups: Sequence[str], names: Sequence[str] = ()) -> RigModel:
    """The rig with the file's values of these groups and parameters."""
    own = values_of(file)
    return with_values(
        model, {row.name: own[row.name] for row in PARAMETERS if row.group in groups or row.name in names}
    )


def evidence(found: RigEstimate, start: RigModel, group: str) -> float:
    """Wald's statistic of a group against the file's values, over its number of parameters."""
    at, away = _group(found, start, group)
    block = found.covariance[np.ix_(at, at)]
    return float(away @ np.linalg.pinv(block, hermitian=True) @ away) / max(len(at), 1)


def is_significant(found: RigEstimate, file: RigModel, group: str) -> bool:
    """Whether the values of a group differ from the file's by more than chance explains."""
    count = len(_group(found, file, group)[0])
    return count * evidence(found, file, group) > 2.0 * float(gammaincinv(count / 2.0, SIGNIFICANT))


def reduced_values(found: RigEstimate, start: RigModel, group: str) -> dict[str, float]:
    """Where the other unknowns move, by linear theory, if a group is as in the file.

    Those at a limit stay, and none moves much further than is plausible: of the level in an empty tank the records
    tell nothing, and by linear theory alone it was full.
    """
    at, away = _group(found, start, group)
    limits, values = found.problem.unknowns, found.values.copy()
    span = 1e-9 * (limits.high - limits.low)
    is_inside = (values > limits.low + span) & (values < limits.high - span)
    others = [i for i in np.flatnonzero(is_inside).tolist() if i not in at]
    held = [plausible(found.names[i], float(values[i])) ** -2.0 for i in others]
    information = found.normal.information
    inverse = scaled_inverse(information[np.ix_(others, others)] + np.diag(held))
    pull: Array = information[np.ix_(others, at)] @ away
    values[others] += inverse @ pull
    values[at] -= away
    return dict(zip(found.names, np.clip(values, limits.low, limits.high).tolist(), strict=True))


def _group(found: RigEstimate, start: RigModel, group: str) -> tuple[list[int], Array]:
    own = values_of(start)
    at = [i for i, name in enumerate(found.names) if name in BY_NAME and BY_NAME[name].group == group]
    return at, np.array([found.values[i] - own[found.names[i]] for i in at])
