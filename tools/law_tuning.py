"""Tune the laws of `hil.core.laws` by one rule, on drawn rigs with seeds of their own.

Of the settings on a law's grid, those are taken that have the smallest sum of IAE of both outputs, over the drawn rigs

    minimum phase:      a step of both references by 0.315 V (80 s), then both pumps lose 60 % (80 s)
    non-minimum phase:  a step of both references by 0.3 V (300 s), then of the first by -0.3 V (500 s)

with at most 19 mV of noise on the commands at rest (that of a PI controller with K = 8 V/V) and no step with more than
20 % overshoot; of settings within TIE of the smallest, those with the least overshoot. Rigs: parameters drawn with 3 %
from SEEDS; pumps with half, once and twice the lag of the file.

    python -m tools.law_tuning [minus|plus] [law ...]       minutes; prints each grid, the choice last
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from hil.core.control_law import ControlLaw
from hil.core.laws.command_governor import CommandGovernor
from hil.core.laws.decentralised_pi import DecentralisedPi, is_crossed
from hil.core.laws.feedback_linearisation import FeedbackLinearisation
from hil.core.laws.fuzzy_predictive import fuzzy_predictive
from hil.core.laws.law_plant import LawPlant
from hil.core.laws.linear_quadratic import LinearQuadraticDesign, WeightedFeedback
from hil.core.laws.predictive import PredictiveControl
from hil.core.reconfiguration import Reconfiguration
from hil.core.tanks import TankModel, equilibrium, holding_voltages
from hil.core.types import Pair
from tools.law_trial import LAG_S, PERIOD_S, Trial, drawn, run

SEEDS, LAGS_S = (9101, 9102, 9103), (0.5 * LAG_S, LAG_S, 2.0 * LAG_S)
MAX_NOISE_V, MAX_OVERSHOOT, TIE = 0.019, 0.2, 0.03

MINUS_MODEL = TankModel()
PLUS_MODEL = replace(MINUS_MODEL, pump_gain_cm3_Vs=(3.14, 3.29), valve_split=(0.43, 0.34))
PLANTS = {
    "minus": LawPlant(MINUS_MODEL, (10.0, 10.0), (LAG_S, LAG_S), PERIOD_S, (3.0, 3.0), 20.0),
    "plus": LawPlant(PLUS_MODEL, (10.0, 10.0), (LAG_S, LAG_S), PERIOD_S, (3.15, 3.15), 20.0),
}

Settings = tuple[float, ...]


def pi(plant: LawPlant, gain: float, integral_s: float) -> ControlLaw:
    """The PI controller with equal settings for both outputs."""
    return DecentralisedPi(plant, (gain, gain), (integral_s, integral_s), is_crossed(plant.model))


def lqr(plant: LawPlant, lower: float, integral: float, weight: float) -> WeightedFeedback:
    """The linear-quadratic law."""
    design = LinearQuadraticDesign(lower, 0.1, integral)
    return WeightedFeedback(
        Reconfiguration(plant.model, design, plant.limit_V, plant.operating_V), PERIOD_S, 5.0, weight
    )


def governor(plant: LawPlant, lower: float, integral: float, weight: float) -> ControlLaw:
    """The governor around the linear-quadratic law."""
    return CommandGovernor(plant, lqr(plant, lower, integral, weight))


def mpc(plant: LawPlant, horizon_s: float, move_weight: float, observer_s: float) -> ControlLaw:
    """Linear predictive control."""
    return PredictiveControl(plant, horizon_s, move_weight, observer_s)


def fuzzy(plant: LawPlant, horizon_s: float, calm: float, brisk: float, observer_s: float) -> ControlLaw:
    """Fuzzy predictive control."""
    control = PredictiveControl(plant, horizon_s, calm, observer_s, has_fixed_model=True)
    return fuzzy_predictive(control, calm, brisk, 0.05, 0.05)


def linearising(plant: LawPlant, reference: float, feedback: float) -> ControlLaw:
    """Feedback linearisation."""
    return FeedbackLinearisation(plant, reference, feedback)


GRIDS: dict[str, dict[str, tuple[Callable[..., Any], tuple[Settings, ...]]]] = {
    "minus": {
        "pi": (pi, ((6.0, 8.0, 10.0), (8.0, 12.0, 16.0))),
        "lqr": (lqr, ((3.0, 6.0), (0.1, 0.3, 1.0), (0.5, 0.7, 0.85))),
        "governor": (governor, ((3.0, 6.0), (0.3, 1.0), (0.5, 0.7, 0.85))),
        "mpc": (mpc, ((30.0, 60.0), (0.05, 0.01, 0.003, 0.001), (1.0, 2.0, 4.0))),
        "fuzzy": (fuzzy, ((60.0,), (0.05, 0.01), (0.003, 0.001, 0.0003), (1.0, 2.0))),
        "linearising": (linearising, ((0.5, 1.0, 2.0), (0.15, 0.2, 0.25, 0.3))),
    },
    "plus": {
        "pi": (pi, ((0.5, 0.7, 1.0), (100.0, 130.0, 170.0))),
        "lqr": (lqr, ((0.3, 1.0), (1e-3, 3e-3, 1e-2), (0.0, 0.5, 1.0))),
        "governor": (governor, ((0.3, 1.0), (3e-3, 1e-2), (0.5, 1.0))),
        "mpc": (mpc, ((200.0, 400.0), (1.0, 10.0), (2.0, 4.0))),
        "fuzzy": (fuzzy, ((200.0,), (30.0, 10.0), (10.0, 3.0), (2.0,))),
    },
}


@dataclass(frozen=True, slots=True)
class Score:
    """iae_Vs : sum of both outputs and all rigs, over their number. overshoot : the largest. noise_V : at rest."""

    iae_Vs: float
    overshoot: float
    noise_V: float

    @property
    def is_allowed(self) -> bool:
        """Whether noise and overshoot are within the rule."""
        return self.noise_V <= MAX_NOISE_V and self.overshoot <= MAX_OVERSHOOT


def trial_of(phase: str, rest: Pair, given_V: Pair, lag_s: float) -> tuple[Trial, list[Pair]]:
    """What a law is tuned on, and from and until when the IAE counts."""
    r1, r2 = rest
    if phase == "plus":
        steps = ((0.0, rest), (20.0, (r1 + 0.3, r2 + 0.3)), (320.0, (r1, r2 + 0.3)))
        return Trial(820.0, steps, given_V=given_V, lag_s=lag_s), [(20.0, 320.0), (320.0, 820.0)]
    faults = ((0.0, (1.0, 1.0)), (100.0, (0.4, 0.4)))
    step = ((0.0, rest), (20.0, (r1 + 0.315, r2 + 0.315)))
    return Trial(180.0, step, faults, given_V=given_V, lag_s=lag_s), [(20.0, 100.0), (100.0, 180.0)]


def score(phase: str, law: ControlLaw, rigs: int = 3) -> Score:
    """How a law does on the first of the tuning rigs."""
    plant = PLANTS[phase]
    h1, h2, _, _ = equilibrium(plant.model, plant.operating_V)
    rest = (plant.model.level_gain_V_cm * h1, plant.model.level_gain_V_cm * h2)
    total, worst = 0.0, 0.0
    for seed, lag_s in list(zip(SEEDS, LAGS_S, strict=True))[:rigs]:
        truth = drawn(plant.model, seed)
        held_V = holding_voltages(truth, (h1, h2))
        trial, windows = trial_of(phase, rest, held_V, lag_s)
        course = run(law, plant.model, truth, trial, seed)
        total += sum(sum(course.iae(begin, end)) for begin, end in windows)
        worst = max(worst, course.overshoot(*windows[0]))
    quiet = run(law, plant.model, plant.model, Trial(40.0, ((0.0, rest),), given_V=plant.operating_V), SEEDS[0])
    return Score(total / rigs, worst, quiet.noise(10.0, 40.0))


def tuned(phase: str, name: str, rigs: int = 3) -> Iterator[tuple[Settings, Score]]:
    """The settings of a law's grid with their scores."""
    make, axes = GRIDS[phase][name]
    for settings in product(*axes):
        yield settings, score(phase, make(PLANTS[phase], *settings), rigs)


def chosen(allowed: list[tuple[Settings, Score]]) -> Settings | None:
    """The settings that the rule takes; None if none is allowed."""
    if not allowed:
        return None
    smallest = min(got.iae_Vs for _, got in allowed)
    return min(
        ((got.overshoot, settings) for settings, got in allowed if got.iae_Vs <= (1.0 + TIE) * smallest),
    )[1]


def main(arguments: list[str]) -> None:
    """Print the grids and the choices."""
    phase, names = (arguments[0], arguments[1:]) if arguments else ("minus", [])
    for name in names or GRIDS[phase]:
        allowed: list[tuple[Settings, Score]] = []
        for settings, got in tuned(phase, name):
            mark = "" if got.is_allowed else "  not allowed"
            print(
                f"{phase} {name} {settings}: IAE {got.iae_Vs:.2f} V s, overshoot {100 * got.overshoot:.0f} %, "
                f"noise {1e3 * got.noise_V:.1f} mV{mark}",
                flush=True,
            )
            if got.is_allowed:
                allowed.append((settings, got))
        print(f"{phase} {name}: {chosen(allowed)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
