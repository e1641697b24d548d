"""The two phases of Johansson's rig, and every law of `hil.core.laws` for them, as tuned."""

from __future__ import annotations

from dataclasses import replace

from hil.core.control_law import ControlLaw
from hil.core.laws.command_governor import CommandGovernor
from hil.core.laws.decentralised_pi import DecentralisedPi
from hil.core.laws.feedback_linearisation import FeedbackLinearisation
from hil.core.laws.fuzzy_predictive import fuzzy_predictive
from hil.core.laws.law_plant import LawPlant
from hil.core.laws.linear_quadratic import LinearQuadraticDesign, WeightedFeedback
from hil.core.laws.predictive import PredictiveControl
from hil.core.reconfiguration import Reconfiguration
from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Pair

MINUS = TankModel()
PLUS = replace(MINUS, pump_gain_cm3_Vs=(3.14, 3.29), valve_split=(0.43, 0.34))
LIMIT_V, LAG_S, PERIOD_S = (10.0, 10.0), (0.2, 0.2), 0.1

MINUS_PLANT = LawPlant(MINUS, LIMIT_V, LAG_S, PERIOD_S, (3.0, 3.0), 20.0)
PLUS_PLANT = LawPlant(PLUS, LIMIT_V, LAG_S, PERIOD_S, (3.15, 3.15), 20.0)


def johansson_pi(plant: LawPlant) -> DecentralisedPi:
    """The published settings of each phase, straight pairing."""
    if plant is PLUS_PLANT:
        return DecentralisedPi(plant, (1.5, -0.12), (110.0, 220.0))
    return DecentralisedPi(plant, (3.0, 2.7), (30.0, 40.0))


def lqr(plant: LawPlant) -> WeightedFeedback:
    design = LinearQuadraticDesign(6.0, 0.1, 0.3)
    reconfiguration = Reconfiguration(plant.model, design, LIMIT_V, plant.operating_V)
    return WeightedFeedback(reconfiguration, PERIOD_S, 5.0, 0.7)


def laws(plant: LawPlant) -> dict[str, ControlLaw]:
    """Name -> law."""
    return {
        "pi": DecentralisedPi(plant, (8.0, 8.0), (12.0, 12.0)),
        "lqr": lqr(plant),
        "feedback_linearisation": FeedbackLinearisation(plant, 1.0, 0.25),
        "governor": CommandGovernor(plant, lqr(plant)),
        "mpc": PredictiveControl(plant, 60.0, 0.01, 4.0),
        "fuzzy_mpc": fuzzy_predictive(
            PredictiveControl(plant, 60.0, 0.01, 4.0, has_fixed_model=True), 0.02, 0.001, 0.05, 0.05
        ),
    }


def rest_outputs(plant: LawPlant) -> Pair:
    """Outputs at the operating point."""
    h1, h2, _, _ = equilibrium(plant.model, plant.operating_V)
    return plant.model.level_gain_V_cm * h1, plant.model.level_gain_V_cm * h2


def raised(reference_V: Pair, by_V: float) -> Pair:
    return reference_V[0] + by_V, reference_V[1] + by_V
