"""Candidates of a tuning, what their trials came to, and which one is chosen.

The rule: of the candidates whose runs all ended, which are robust enough and have no more command noise than allowed,
the one with the smallest geometric mean of step IAE and loss IAE, each over that of the present options.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

GAIN_MARGIN = 2.0
DELAY_PERIODS = 5.0
SPREAD = 0.1
NOISE_ALLOWED = 1.1
BETTER = 0.95
"""Others are chosen only with a score of at most this; otherwise the present options stay."""

RULE = (
    "Chosen: the smallest geometric mean of step IAE and loss IAE, each over that of the present options, among the "
    "candidates whose runs all ended, whose sigma(v) is within the limit and whose loop, where it is linear, has a "
    f"gain margin of {GAIN_MARGIN:g}, a delay margin of {DELAY_PERIODS:g} control periods, and is stable with its "
    f"gains kept after each loss of 60 % and on rigs that are {100.0 * SPREAD:g} % off. "
    f"The present options stay unless that is better by {100.0 * (1.0 - BETTER):g} %."
)


@dataclass(frozen=True)
class Candidate:
    """Options to try. label : for people. values : what is changed, by key. control, rig : merged into the scenario's.

    is_present : the options in force.
    """

    label: str
    values: Mapping[str, Any]
    control: Mapping[str, Any] = field(default_factory=dict)
    rig: Mapping[str, Any] = field(default_factory=dict)
    is_present: bool = False


@dataclass(frozen=True)
class Robustness:
    """Of a linear loop, see `hil.bench.loop_margins`. lost : losses after which it is not stable."""

    gain_up: float
    gain_down: float
    delay_s: float
    distance: float
    lost: tuple[str, ...]
    spread: float


@dataclass(frozen=True)
class Trial:
    """What a candidate came to. step_iae_Vs, loss_iae_Vs : medians of both outputs together. noise_V : sigma(v).

    endings : of runs that did not go on to their end. robustness : None where the law is not linear. score : see the
    module, 1 for the present options. objection : why it can't be chosen; "" if it can.
    """

    candidate: Candidate
    step_iae_Vs: float | None
    loss_iae_Vs: float | None
    noise_V: float | None
    overshoot_V: float | None
    endings: Mapping[str, int]
    robustness: Robustness | None
    score: float | None = None
    objection: str = ""
    is_chosen: bool = False


def judged(trials: Sequence[Trial], period_s: float, noise_max_V: float | None) -> tuple[Trial, ...]:
    """The trials with scores and objections, and the chosen one marked; there may be none.

    noise_max_V : None: 1.1 times the present options' noise.
    """
    present = next(trial for trial in trials if trial.candidate.is_present)
    if noise_max_V is None and present.noise_V is not None:
        noise_max_V = NOISE_ALLOWED * present.noise_V
    scored = [
        replace(trial, score=_score(trial, present), objection=_objection(trial, period_s, noise_max_V))
        for trial in trials
    ]
    possible = [trial for trial in scored if not trial.objection and trial.score is not None]
    chosen = min(possible, key=lambda trial: trial.score or math.inf, default=None)
    now = next((trial for trial in possible if trial.candidate.is_present), None)
    if now is not None and chosen is not None and (chosen.score or 0.0) > BETTER:
        chosen = now
    return tuple(replace(trial, is_chosen=trial is chosen) for trial in scored)


def _score(trial: Trial, present: Trial) -> float | None:
    parts = []
    for mine, now in ((trial.step_iae_Vs, present.step_iae_Vs), (trial.loss_iae_Vs, present.loss_iae_Vs)):
        if mine is None or now is None or now <= 0.0:
            return None
        parts.append(mine / now)
    return math.sqrt(parts[0] * parts[1])


def _objection(trial: Trial, period_s: float, noise_max_V: float | None) -> str:
    robust = trial.robustness
    if trial.endings:
        return "; ".join(f"{cause} {count}" for cause, count in trial.endings.items())
    if trial.score is None and None in (trial.step_iae_Vs, trial.loss_iae_Vs):
        return "no figures"
    if noise_max_V is not None and trial.noise_V is not None and trial.noise_V > noise_max_V:
        return f"sigma(v) above {1e3 * noise_max_V:.3g} mV"
    if robust is None:
        return ""
    if robust.gain_up < GAIN_MARGIN:
        return f"gain margin {robust.gain_up:.2g}"
    if robust.delay_s < DELAY_PERIODS * period_s:
        return f"delay margin {robust.delay_s:.2g} s"
    if robust.lost:
        return f"not stable after {', '.join(robust.lost)} with gains kept"
    return f"not stable on rigs {100.0 * SPREAD:g} % off" if robust.spread < SPREAD else ""
