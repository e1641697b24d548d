"""The table of docs/reference/laws.md: every law on the same drawn rigs, in the trial of `tools.law_trial`.

python -m tools.law_table [minus|plus] [law ...]        prints rows of a Markdown table
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from hil.bench.comparator_laws import (
    FuzzyOptions,
    GovernorOptions,
    LinearisingOptions,
    LqrOptions,
    PiOptions,
    PredictiveOptions,
    make_fuzzy,
    make_governor,
    make_linearising,
    make_lqr,
    make_pi,
    make_predictive,
)
from hil.core.control_law import ControlLaw
from hil.core.feedforward import PathLimits
from hil.core.gain_design import choose_rig_design
from hil.core.laws.law_plant import LawPlant
from hil.core.laws.linear_quadratic import WeightedFeedback
from hil.core.laws.path_follower import PathFollower
from hil.core.laws.state_feedback_law import StateFeedbackLaw
from hil.core.reconfiguration import Reconfiguration
from hil.core.tanks import equilibrium, holding_voltages, linearise
from tools.law_trial import Course, Trial, drawn, run
from tools.law_tuning import PLANTS

SEEDS = (50_001, 50_002, 50_003)
POLES, NOISE_GAIN_MAX, ANTI_WINDUP_S = (-0.252, -0.184, -0.073, -0.06), 10.0, 5.0


def rig_design(plant: LawPlant) -> ControlLaw:
    """The project's state feedback with the rig design, references by the integrals alone."""
    at = linearise(plant.model, equilibrium(plant.model, plant.operating_V))
    design = choose_rig_design(at, POLES, NOISE_GAIN_MAX)
    reconfiguration = Reconfiguration(plant.model, design, plant.limit_V, plant.operating_V)
    return WeightedFeedback(reconfiguration, plant.period_s, ANTI_WINDUP_S, 0.0)


def state_feedback(plant: LawPlant) -> ControlLaw:
    """The project's state feedback with the rig design and its feedforward."""
    at = linearise(plant.model, equilibrium(plant.model, plant.operating_V))
    design = choose_rig_design(at, POLES, NOISE_GAIN_MAX)
    reconfiguration = Reconfiguration(plant.model, design, plant.limit_V, plant.operating_V)
    (low1, low2), (high1, high2) = (0.0, 0.0), plant.limit_V
    limits = PathLimits(
        drives_V=((low1, high1), (low2, high2)),
        rate_V_s=(plant.rate_V_s, plant.rate_V_s),
        lag_s=plant.lag_s,
        level_max_cm=19.0,
        period_s=plant.period_s,
    )
    return StateFeedbackLaw(reconfiguration, plant.period_s, ANTI_WINDUP_S, PathFollower(reconfiguration, limits))


ROWS: dict[str, Callable[[LawPlant], ControlLaw]] = {
    "state_feedback": state_feedback,
    "rig_design_without_feedforward": rig_design,
    "pi_johansson": lambda plant: make_pi(plant, PiOptions(settings="johansson")),
    "pi": lambda plant: make_pi(plant, PiOptions()),
    "pi_use_diagnosis": lambda plant: make_pi(plant, PiOptions(use_diagnosis=True)),
    "lqr_no_diagnosis": lambda plant: make_lqr(plant, LqrOptions(use_diagnosis=False), ANTI_WINDUP_S),
    "lqr": lambda plant: make_lqr(plant, LqrOptions(), ANTI_WINDUP_S),
    "governor": lambda plant: make_governor(plant, GovernorOptions(), ANTI_WINDUP_S),
    "mpc": lambda plant: make_predictive(plant, PredictiveOptions()),
    "fuzzy_mpc": lambda plant: make_fuzzy(plant, FuzzyOptions()),
    "feedback_linearisation": lambda plant: make_linearising(plant, LinearisingOptions()),
}


def courses(plant: LawPlant, law: ControlLaw, seed: int, is_plus: bool) -> tuple[Course, Course]:
    """Steps with a fault between them, and large steps."""
    truth = drawn(plant.model, seed)
    h1, h2, _, _ = equilibrium(plant.model, plant.operating_V)
    r1, r2 = 0.5 * h1, 0.5 * h2
    held = holding_voltages(truth, (h1, h2))
    if is_plus:
        first = ((0.0, (r1, r2)), (50.0, (r1 + 0.3, r2 + 0.3)), (950.0, (r1 + 0.2, r2 + 0.4)))
        second = ((0.0, (r1, r2)), (50.0, (r1 + 0.3, r2)), (650.0, (r1, r2)))
        faults = ((0.0, (1.0, 1.0)), (450.0, (0.6, 1.0)))
        return (
            run(law, plant.model, truth, Trial(1450.0, first, faults, given_V=held), seed),
            run(law, plant.model, truth, Trial(1250.0, second, given_V=held), seed),
        )
    up, twice = (r1 + 0.315, r2 + 0.315), (r1 + 0.63, r2 + 0.63)
    faults = ((0.0, (1.0, 1.0)), (150.0, (0.4, 0.4)))
    first = ((0.0, (r1, r2)), (50.0, up), (300.0, twice))
    second = ((0.0, (r1, r2)), (50.0, (r1 + 1.0, r2 + 1.0)), (150.0, (r1, r2)))
    return (
        run(law, plant.model, truth, Trial(400.0, first, faults, given_V=held), seed),
        run(law, plant.model, truth, Trial(250.0, second, given_V=held), seed),
    )


def figures(plant: LawPlant, law: ControlLaw, seed: int, is_plus: bool) -> list[float]:
    """What a row shows: IAE of step, loss and next step (y1, y2), of two large steps (mean); percent, s, mV."""
    first, second = courses(plant, law, seed, is_plus)
    if is_plus:
        times, large, bands = ((50.0, 450.0), (450.0, 950.0), (950.0, 1450.0)), ((50.0, 650.0), (650.0, 1250.0)), 50.0
    else:
        times, large, bands = ((50.0, 150.0), (150.0, 300.0), (300.0, 400.0)), ((50.0, 150.0), (150.0, 250.0)), 50.0
    small = [value for begin, end in times for value in first.iae(begin, end)]
    both = [float(np.mean(second.iae(begin, end))) for begin, end in large]
    overshoot = max(first.overshoot(*times[0]), first.overshoot(*times[2]), *(second.overshoot(*w) for w in large))
    return [*small, *both, 100.0 * overshoot, first.settled_s(*times[0]), 1e3 * first.noise(bands - 25.0, bands)]


def row(name: str, phase: str) -> str:
    """A row of the table: means of the seeds, the largest overshoot."""
    plant = PLANTS[phase]
    all_ = np.array([figures(plant, ROWS[name](plant), seed, phase == "plus") for seed in SEEDS])
    f = [*all_.mean(axis=0)]
    return (
        f"| `{name}` | {f[0]:.2g}/{f[1]:.2g} | {f[2]:.2g}/{f[3]:.2g} | {f[4]:.2g}/{f[5]:.2g} | {f[6]:.2g}/{f[7]:.2g} "
        f"| {all_[:, 8].max():.0f} % | {f[9]:.0f} s | {f[10]:.1f} mV |"
    )


def main(arguments: list[str]) -> None:
    """Print the rows."""
    phase, names = (arguments[0], arguments[1:]) if arguments else ("minus", [])
    for name in names or ROWS:
        if phase == "plus" and name in ("state_feedback", "rig_design_without_feedforward", "feedback_linearisation"):
            continue
        print(row(name, phase), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
