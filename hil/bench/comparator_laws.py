"""Makers and options of the laws of `hil.core.laws`: docs/reference/laws.md says where each comes from.

An option that is not given has the value tuned for the rig's phase, by the rule of `tools/law_tuning.py`.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from hil.bench.law_setup import LawOptions, LawSetup
from hil.core.control_law import ControlLaw
from hil.core.laws.command_governor import CommandGovernor
from hil.core.laws.decentralised_pi import DecentralisedPi, is_crossed
from hil.core.laws.feedback_linearisation import FeedbackLinearisation
from hil.core.laws.fuzzy_predictive import fuzzy_predictive
from hil.core.laws.law_plant import LawPlant
from hil.core.laws.linear_quadratic import LinearQuadraticDesign, WeightedFeedback
from hil.core.laws.predictive import PredictiveControl
from hil.core.laws.quadratic_program import MissingSolverError
from hil.core.reconfiguration import Reconfiguration
from hil.core.tanks import TankModel
from hil.edge.config.settings_file import SettingsError

Gain = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
Time = Annotated[float, Field(ge=0.1, le=10_000.0, allow_inf_nan=False)]
Weight = Annotated[float, Field(ge=1e-9, le=1e6, allow_inf_nan=False)]
Part = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Distance = Annotated[float, Field(ge=0.0, le=5.0, allow_inf_nan=False)]
Rate = Annotated[float, Field(ge=1e-3, le=5.0, allow_inf_nan=False)]


class TunedOptions(LawOptions):
    """Options of which those that are None have a tuned value. minus, plus : the values for each phase, by key.

    use_diagnosis : whether the law divides its drives by the effectiveness that the diagnosis finds.
    """

    minus: ClassVar[dict[str, Any]] = {}
    plus: ClassVar[dict[str, Any]] = {}

    use_diagnosis: bool = True

    def values(self, model: TankModel) -> dict[str, Any]:
        """All options, for tanks of this phase."""
        tuned = self.plus if is_crossed(model) else self.minus
        given = {key: value for key, value in self.model_dump().items() if value is not None}
        return {**tuned, **given}


class PiOptions(TunedOptions):
    """gain_V_V, integral_s : K and Ti of both outputs. settings : which ones where these are not given.

    pairing : pump i for output i (straight), the other one (crossed), or what the relative gain asks for (auto).
    """

    minus: ClassVar[dict[str, Any]] = {"gain_V_V": (8.0, 8.0), "integral_s": (12.0, 12.0)}
    plus: ClassVar[dict[str, Any]] = {"gain_V_V": (0.7, 0.7), "integral_s": (130.0, 130.0)}

    use_diagnosis: bool = False
    settings: Literal["tuned", "johansson"] = "tuned"
    gain_V_V: tuple[Gain, Gain] | None = None
    integral_s: tuple[Time, Time] | None = None
    pairing: Literal["auto", "straight", "crossed"] = "auto"


JOHANSSON_MINUS = {"gain_V_V": (3.0, 2.7), "integral_s": (30.0, 40.0), "pairing": "straight"}
JOHANSSON_PLUS = {"gain_V_V": (1.5, -0.12), "integral_s": (110.0, 220.0), "pairing": "straight"}
"""Johansson 2000; pump i for output i in both phases."""


class LqrOptions(TunedOptions):
    """Weights of levels and integrals against drive_weight; reference_weight : part of a step that acts at once."""

    minus: ClassVar[dict[str, Any]] = {"lower_weight": 6.0, "integral_weight": 0.3, "reference_weight": 0.7}
    plus: ClassVar[dict[str, Any]] = {"lower_weight": 1.0, "integral_weight": 0.01, "reference_weight": 0.5}

    lower_weight: Weight | None = None
    upper_weight: Weight = 0.1
    integral_weight: Weight | None = None
    drive_weight: Weight = 1.0
    reference_weight: Part | None = None


class GovernorOptions(LqrOptions):
    """Those of the state feedback inside, and the distances that the command keeps from rims and drive limits."""

    rim_margin_cm: Distance = 1.5
    drive_margin_V: Distance = 0.05


class PredictiveOptions(TunedOptions):
    """horizon_s in `intervals`, the first of first_s; move_weight : of changes of drive; observer_s : of inflows."""

    minus: ClassVar[dict[str, Any]] = {"horizon_s": 60.0, "move_weight": 0.001, "observer_s": 2.0}
    plus: ClassVar[dict[str, Any]] = {"horizon_s": 200.0, "move_weight": 10.0, "observer_s": 2.0}

    horizon_s: Time | None = None
    intervals: Annotated[int, Field(ge=3, le=60)] = 14
    first_s: Annotated[float, Field(ge=0.02, le=10.0, allow_inf_nan=False)] = 0.2
    move_weight: Weight | None = None
    observer_s: Time | None = None


class FuzzyOptions(TunedOptions):
    """As the predictive law; calm_weight, brisk_weight : of changes of drive, at rest and far from the reference.

    large_V, fast_V_s : errors and changes of error that fully belong to "large" and "moving".
    """

    minus: ClassVar[dict[str, Any]] = {
        "horizon_s": 60.0, "calm_weight": 0.01, "brisk_weight": 0.0003, "observer_s": 1.0,
    }  # fmt: skip
    plus: ClassVar[dict[str, Any]] = {
        "horizon_s": 200.0, "calm_weight": 30.0, "brisk_weight": 3.0, "observer_s": 2.0,
    }  # fmt: skip

    horizon_s: Time | None = None
    calm_weight: Weight | None = None
    brisk_weight: Weight | None = None
    observer_s: Time | None = None
    large_V: Weight = 0.05
    fast_V_s: Weight = 0.05


class LinearisingOptions(TunedOptions):
    """reference_1_s : speed of the reference model. feedback_1_s : of the feedback to it."""

    minus: ClassVar[dict[str, Any]] = {"reference_1_s": 1.0, "feedback_1_s": 0.25}

    reference_1_s: Rate = 2.0
    feedback_1_s: Rate = 0.25


def plant_of(setup: LawSetup) -> LawPlant:
    """What the laws know of the rig."""
    return LawPlant(
        model=setup.model,
        limit_V=setup.pumps.max_drives,
        lag_s=setup.lags_s,
        period_s=setup.period_s,
        operating_V=setup.operating_drives,
        rate_V_s=setup.rig.pumps.rate_V_s,
        pumps=setup.pumps,
    )


def make_pi(plant: LawPlant, options: PiOptions) -> DecentralisedPi:
    """The PI controllers of a rig."""
    values = options.values(plant.model)
    if options.settings == "johansson":
        published = JOHANSSON_PLUS if is_crossed(plant.model) else JOHANSSON_MINUS
        given = {key: value for key, value in options.model_dump().items() if value not in (None, "auto")}
        values = {**published, **given}
    pairing = values.get("pairing", "auto")
    crossed = is_crossed(plant.model) if pairing == "auto" else pairing == "crossed"
    return DecentralisedPi(plant, values["gain_V_V"], values["integral_s"], crossed, options.use_diagnosis)


def make_lqr(plant: LawPlant, options: LqrOptions, anti_windup_s: float) -> WeightedFeedback:
    """The linear-quadratic law of a rig."""
    values = options.values(plant.model)
    design = LinearQuadraticDesign(
        values["lower_weight"], values["upper_weight"], values["integral_weight"], values["drive_weight"]
    )
    reconfiguration = Reconfiguration(plant.model, design, plant.limit_V, plant.operating_V, plant.pumps)
    return WeightedFeedback(
        reconfiguration, plant.period_s, anti_windup_s, values["reference_weight"], options.use_diagnosis
    )


def make_governor(plant: LawPlant, options: GovernorOptions, anti_windup_s: float) -> CommandGovernor:
    """The command governor of a rig. Raises MissingSolverError without its solver."""
    feedback = make_lqr(plant, options, anti_windup_s)
    return CommandGovernor(plant, feedback, options.rim_margin_cm, options.drive_margin_V)


def make_predictive(plant: LawPlant, options: PredictiveOptions) -> PredictiveControl:
    """Linear predictive control of a rig. Raises MissingSolverError without its solver."""
    return PredictiveControl(plant, **options.values(plant.model))


def make_fuzzy(plant: LawPlant, options: FuzzyOptions) -> ControlLaw:
    """Fuzzy predictive control of a rig. Raises MissingSolverError without its solver."""
    values = options.values(plant.model)
    control = PredictiveControl(
        plant,
        values["horizon_s"],
        values["calm_weight"],
        values["observer_s"],
        use_diagnosis=options.use_diagnosis,
        has_fixed_model=True,
    )
    return fuzzy_predictive(control, *(values[key] for key in ("calm_weight", "brisk_weight", "large_V", "fast_V_s")))


def make_linearising(plant: LawPlant, options: LinearisingOptions) -> FeedbackLinearisation:
    """Feedback linearisation of a rig. Raises DesignError for a non-minimum-phase rig."""
    return FeedbackLinearisation(plant, options.reference_1_s, options.feedback_1_s, options.use_diagnosis)


def pi_law(setup: LawSetup, options: PiOptions) -> ControlLaw:
    """One PI controller for each output."""
    return make_pi(plant_of(setup), options)


def lqr_law(setup: LawSetup, options: LqrOptions) -> ControlLaw:
    """Linear-quadratic state feedback with integral action."""
    return make_lqr(plant_of(setup), options, setup.rig.control.anti_windup_s)


def governor_law(setup: LawSetup, options: GovernorOptions) -> ControlLaw:
    """A command governor around the linear-quadratic law."""
    try:
        return make_governor(plant_of(setup), options, setup.rig.control.anti_windup_s)
    except MissingSolverError as error:
        raise SettingsError(f"control.law: {error}") from None


def predictive_law(setup: LawSetup, options: PredictiveOptions) -> ControlLaw:
    """Linear predictive control."""
    try:
        return make_predictive(plant_of(setup), options)
    except MissingSolverError as error:
        raise SettingsError(f"control.law: {error}") from None


def fuzzy_law(setup: LawSetup, options: FuzzyOptions) -> ControlLaw:
    """Predictive control with a fuzzy model and fuzzy weights."""
    try:
        return make_fuzzy(plant_of(setup), options)
    except MissingSolverError as error:
        raise SettingsError(f"control.law: {error}") from None


def linearising_law(setup: LawSetup, options: LinearisingOptions) -> ControlLaw:
    """Feedback linearisation."""
    return make_linearising(plant_of(setup), options)
