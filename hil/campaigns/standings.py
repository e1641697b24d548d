"""Who is ahead in a benchmark: medians over the seeds, ratios and ranks by paired seeds with their intervals.

The score of a run in a window is the IAE of both outputs together. A run that ended before the window did (a trip, an
orderly stop, an exception) has the score infinity there: it is behind every run that ended, and it is in no median.

A seed is the same rig and noise for all entrants, so entrants are compared seed by seed:

- ratio: the median over the seeds of an entrant's score over that of the best one, which is the entrant with the lowest
  median score of the window; a seed without a score counts as infinitely worse;
- rank: the mean over the seeds of the rank among all entrants of the same rig, equal scores sharing their ranks.

Both have 95 % percentile bootstrap intervals over the seeds (Efron 1979): 2000 draws of as many seeds with replacement,
from a fixed random seed, the same draws for all entrants.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.campaigns.contests import Contest, Entrant
from hil.campaigns.row import Row
from hil.campaigns.standing import Course, Detection, Interval, Overall, Standing, Standings

Floats = npt.NDArray[np.float64]
Runs = Sequence[tuple[Contest, Row]]

DRAWS = 2000
CONFIDENCE_LIMITS = (2.5, 97.5)
TIME_RESOLUTION_S = 1e-6
DECIMALS = 9
NOISE_TOLERANCE = 1.1
"""An entrant whose command noise is at most so many times another's has no more noise than it."""


@dataclass(frozen=True, eq=False)
class _Ballot:
    """Scores of a rig's entrants on its courses: (entrants, courses, seeds); infinite where there is none."""

    entrants: tuple[Entrant, ...]
    courses: tuple[Course, ...]
    scores: Floats


def standings(runs: Runs, noise_window: str) -> Standings:
    """The standings of a benchmark's runs. noise_window : name of the window whose noise counts."""
    from scipy.stats import rankdata  # half a second that other commands need not wait for

    seeds = tuple(sorted({contest.case.seed for contest, _ in runs}))
    draws = np.random.default_rng(0).integers(0, len(seeds), (DRAWS, len(seeds)))
    of_courses: list[Standing] = []
    overall: list[Overall] = []
    detections: list[Detection] = []
    for rig in dict.fromkeys(contest.entrant.rig for contest, _ in runs):
        own = [(contest, row) for contest, row in runs if contest.entrant.rig == rig]
        ballot = _ballot(own, noise_window, seeds)
        ratios, best = _ratios(ballot.scores)
        ranks = rankdata(ballot.scores, axis=0)
        for e, entrant in enumerate(ballot.entrants):
            mine = [(contest, row) for contest, row in own if contest.entrant == entrant]
            noise_V = _noise(mine, noise_window)
            of_courses += [
                _standing(
                    mine, course, noise_V, _median_interval(ratios[e, c], draws), _mean_interval(ranks[e, c], draws)
                )
                for c, course in enumerate(ballot.courses)
            ]
            overall.append(_overall(entrant, [row for _, row in mine], noise_V, ratios[e], ranks[e], draws, best == e))
            detections += _detections(entrant, mine)
    return Standings(seeds, _with_quiet_ratios(of_courses), tuple(overall), tuple(detections))


def figures_of(row: Row, window: str) -> dict[str, Any] | None:
    """A run's figures in a window with its IAE; None if the run ended before the window did."""
    figures: dict[str, Any] | None = json.loads(row.windows_json).get(window)
    iae_Vs = json.loads(row.iae_windows_json or "{}").get(window)
    return None if figures is None or iae_Vs is None else {**figures, "iae_Vs": iae_Vs}


def how_it_ended(row: Row) -> str:
    """Why a run did not go on to its end; "" if it did."""
    if row.crashed:
        return "crashed"
    if row.trip_cause:
        return f"tripped: {row.trip_cause}"
    return "" if row.status == "complete" else f"stopped: {row.reason or row.status}"


def _ballot(runs: Runs, noise_window: str, seeds: tuple[int, ...]) -> _Ballot:
    entrants = tuple(dict.fromkeys(contest.entrant for contest, _ in runs))
    courses = tuple(
        dict.fromkeys(
            Course(contest.entrant.rig, contest.scenario, str(window["name"]))
            for contest, _ in runs
            for window in contest.case.scenario_data.get("window", ())
            if window["name"] != noise_window
        )
    )
    scores = np.full((len(entrants), len(courses), len(seeds)), math.inf)
    for contest, row in runs:
        for c, course in enumerate(courses):
            figures = figures_of(row, course.window) if course.scenario == contest.scenario else None
            if figures is not None:
                place = entrants.index(contest.entrant), c, seeds.index(contest.case.seed)
                scores[place] = sum(figures["iae_Vs"])
    return _Ballot(entrants, courses, scores)


def _ratios(scores: Floats) -> tuple[Floats, npt.NDArray[np.intp]]:
    """(entrants, courses, seeds) score over the best one's, and (courses,) which one that is."""
    best = np.median(scores, axis=2).argmin(axis=0)
    of_best = scores[best, np.arange(scores.shape[1])]
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = scores / of_best
    return np.where(np.isnan(ratios), 1.0, ratios), best  # both without a score, or both without an error


def _median_interval(values: Floats, draws: npt.NDArray[np.int64]) -> Interval:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        drawn = np.median(values[draws], axis=1)
        return Interval(float(np.median(values)), *_limits(drawn))


def _mean_interval(values: Floats, draws: npt.NDArray[np.int64]) -> Interval:
    return Interval(float(values.mean()), *_limits(values[draws].mean(axis=1)))


def _limits(drawn: Floats) -> tuple[float, float]:
    """The limits of 95 %, each a value that was drawn, so that infinite ones stay infinite."""
    low, high = np.percentile(drawn, CONFIDENCE_LIMITS, method="nearest")
    return float(low), float(high)


def _overall(
    entrant: Entrant,
    rows: Sequence[Row],
    noise_V: float | None,
    ratios: Floats,
    ranks: Floats,
    draws: npt.NDArray[np.int64],
    is_best: npt.NDArray[np.bool_],
) -> Overall:
    """ratios, ranks : (courses, seeds)."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        medians = np.median(ratios[:, draws], axis=2)  # (courses, draws)
        drawn = np.exp(np.mean(np.log(medians), axis=0))
        ratio = float(np.exp(np.mean(np.log(np.median(ratios, axis=1)))))
    return Overall(
        entrant=entrant,
        runs=len(rows),
        tripped=sum(bool(row.trip_cause) for row in rows),
        stopped=sum(how_it_ended(row).startswith("stopped") for row in rows),
        crashed=sum(row.crashed for row in rows),
        noise_V=noise_V,
        ratio=Interval(ratio, *_limits(drawn)),
        rank=_mean_interval(ranks.mean(axis=0), draws),
        ahead=int(is_best.sum()),
        courses=len(is_best),
    )


def _standing(mine: Runs, course: Course, noise_V: float | None, ratio: Interval, rank: Interval) -> Standing:
    rows = [row for contest, row in mine if contest.scenario == course.scenario]
    found = [figures_of(row, course.window) for row in rows]
    known = [figures for figures in found if figures is not None]
    ended = [how_it_ended(row) or "no figures" for row, figures in zip(rows, found, strict=True) if figures is None]
    over_V = [value for figures in known for value in figures["overshoot_V"] if value is not None]
    return Standing(
        entrant=mine[0][0].entrant,
        course=course,
        runs=len(rows),
        ended=len(known),
        endings={cause: ended.count(cause) for cause in dict.fromkeys(ended)},
        iae_Vs=_of_both(known, "iae_Vs"),
        settling_s=_of_both(known, "settling_s", missing=math.inf),
        unsettled=(_missing(known, "settling_s", 0), _missing(known, "settling_s", 1)),
        overshoot_V=_of_both(known, "overshoot_V"),
        worst_overshoot_V=max(over_V, default=None),
        peak_V=_of_both(known, "peak_V"),
        noise_V=noise_V,
        energy_V2s=_median(figures["energy_V2s"] for figures in known),
        ratio=ratio,
        rank=rank,
    )


def _with_quiet_ratios(all_of_them: Sequence[Standing]) -> tuple[Standing, ...]:
    """Each with the ratio to the best of those with no more noise."""
    done = []
    for one in all_of_them:
        noise_V, own = one.noise_V, _score(one)
        rivals = [
            _score(other)
            for other in all_of_them
            if other.course == one.course
            and noise_V is not None
            and other.noise_V is not None
            and other.noise_V <= NOISE_TOLERANCE * noise_V
        ]
        lowest = min(rivals, default=math.inf)
        is_known = math.isfinite(own) and 0.0 < lowest < math.inf
        done.append(replace(one, quiet_ratio=own / lowest if is_known else None))
    return tuple(done)


def _score(one: Standing) -> float:
    """Median score; infinite where half of the runs or more did not end."""
    first, second = one.iae_Vs
    return math.inf if first is None or second is None or 2 * one.ended <= one.runs else first + second


def _detections(entrant: Entrant, mine: Runs) -> list[Detection]:
    found = []
    for scenario in dict.fromkeys(contest.scenario for contest, _ in mine):
        rows = [row for contest, row in mine if contest.scenario == scenario]
        asked = [row for row in rows if row.detected is not None]
        if not asked:
            continue
        delays_s = [row.detection_s for row in asked if row.detection_s is not None]
        both = [
            (row.detection_s, row.bound_s) for row in asked if row.detection_s is not None and row.bound_s is not None
        ]
        found.append(
            Detection(
                entrant=entrant,
                scenario=scenario,
                faults=len(asked),
                found=sum(bool(row.detected) for row in asked),
                right=sum(bool(row.right) for row in asked),
                delay_s=_median(delays_s),
                bound_s=_median(row.bound_s for row in asked),
                over_bound_s=_median(delay_s - bound_s for delay_s, bound_s in both),
                over_bound=_median(delay_s / bound_s for delay_s, bound_s in both if bound_s > TIME_RESOLUTION_S),
                false_alarms=sum(row.false_alarms for row in rows),
            )
        )
    return found


def _noise(mine: Runs, noise_window: str) -> float | None:
    """The larger of the pumps' medians over the runs that have the window."""
    known = [figures for _, row in mine if (figures := figures_of(row, noise_window)) is not None]
    both = [value for value in _of_both(known, "noise_V") if value is not None]
    return max(both, default=None)


def _of_both(
    known: Sequence[dict[str, Any]], name: str, missing: float | None = None
) -> tuple[float | None, float | None]:
    first, second = (_median(_or(figures[name][part], missing) for figures in known) for part in (0, 1))
    return first, second


def _or(value: float | None, missing: float | None) -> float | None:
    return missing if value is None else value


def _missing(known: Sequence[dict[str, Any]], name: str, part: int) -> int:
    return sum(figures[name][part] is None for figures in known)


def _median(values: Iterable[float | None]) -> float | None:
    """Of the known ones; None where there is none, or where it is not finite."""
    known = [value for value in values if value is not None]
    if not known:
        return None
    middle = round(float(np.median(known)), DECIMALS)
    return middle if math.isfinite(middle) else None
