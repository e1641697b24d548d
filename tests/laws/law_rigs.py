"""The two phases of Johansson's rig, and every law of `hil.core.laws` for them, as tuned."""

from __future__ import annotations

from dataclasses import replace

from hil.bench import comparator_laws as made
from hil.core.control_law import ControlLaw
from hil.core.laws.decentralised_pi import DecentralisedPi
from hil.core.laws.law_plant import LawPlant
from hil.core.laws.linear_quadratic import WeightedFeedback
from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Pair

MINUS = TankModel()
PLUS = replace(MINUS, pump_gain_cm3_Vs=(3.14, 3.29), valve_split=(0.43, 0.34))
LIMIT_V, LAG_S, PERIOD_S, ANTI_WINDUP_S = (10.0, 10.0), (0.2, 0.2), 0.1, 5.0

MINUS_PLANT = LawPlant(MINUS, LIMIT_V, LAG_S, PERIOD_S, (3.0, 3.0), 20.0)
PLUS_PLANT = LawPlant(PLUS, LIMIT_V, LAG_S, PERIOD_S, (3.15, 3.15), 20.0)


def johansson_pi(plant: LawPlant) -> DecentralisedPi:
    """The published settings of each phase, straight pairing."""
    return made.make_pi(plant, made.PiOptions(settings="johansson"))


def lqr(plant: LawPlant) -> WeightedFeedback:
    return made.make_lqr(plant, made.LqrOptions(), ANTI_WINDUP_S)


def laws(plant: LawPlant) -> dict[str, ControlLaw]:
    """Name -> law; without feedback linearisation where it does not exist."""
    both: dict[str, ControlLaw] = {
        "pi": made.make_pi(plant, made.PiOptions()),
        "lqr": lqr(plant),
        "governor": made.make_governor(plant, made.GovernorOptions(), ANTI_WINDUP_S),
        "mpc": made.make_predictive(plant, made.PredictiveOptions()),
        "fuzzy_mpc": made.make_fuzzy(plant, made.FuzzyOptions()),
    }
    if plant is MINUS_PLANT:
        both["feedback_linearisation"] = made.make_linearising(plant, made.LinearisingOptions())
    return both


def rest_outputs(plant: LawPlant) -> Pair:
    """Outputs at the operating point."""
    h1, h2, _, _ = equilibrium(plant.model, plant.operating_V)
    return plant.model.level_gain_V_cm * h1, plant.model.level_gain_V_cm * h2


def raised(reference_V: Pair, by_V: float) -> Pair:
    return reference_V[0] + by_V, reference_V[1] + by_V
