"""The table of control laws: the names that `[control] law` in a scenario accepts. A new built-in law is a row here.

A maker gets a `LawSetup` and, if it has a second parameter, the options of the scenario's `[control.options]`. That
parameter is annotated with a `LawOptions` of its own, which checks them:

    class PiOptions(LawOptions):
        gain: Annotated[float, Field(gt=0.0, le=100.0)] = 5.0

    def pi_law(setup: LawSetup, options: PiOptions) -> ControlLaw: ...

Installed packages add rows by entry points of the group `fourtank_hil.laws`, with the maker as value.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, get_type_hints

from pydantic import create_model

from hil.bench import comparator_laws as comparators
from hil.bench.choice_table import ChoiceTable, TableChoice
from hil.bench.law_setup import LawOptions, LawSetup
from hil.core.control_law import ControlLaw
from hil.core.feedforward import PathLimits
from hil.core.laws.path_follower import PathFollower
from hil.core.laws.state_feedback_law import StateFeedbackLaw
from hil.core.reconfiguration import Reconfiguration
from hil.edge.config.settings_file import Section, SettingsError, validated

STATE_FEEDBACK = "state_feedback"
"""The law of the paper, which uses a design."""

LawMaker = Callable[..., ControlLaw]
"""Called with a LawSetup, and with the checked options if it has a second parameter."""


def state_feedback_law(setup: LawSetup) -> ControlLaw:
    """The paper's, with the scenario's design."""
    reconfiguration = Reconfiguration(
        setup.model, setup.make_design(), setup.pumps.max_drives, setup.operating_drives, setup.pumps
    )
    wanted = setup.scenario.control.feedforward
    is_on = reconfiguration.design.follows_reference if wanted is None else wanted
    follower = PathFollower(reconfiguration, _path_limits(setup)) if is_on else None
    return StateFeedbackLaw(reconfiguration, setup.period_s, setup.rig.control.anti_windup_s, follower)


def _path_limits(setup: LawSetup) -> PathLimits:
    """What the pumps of this rig allow."""
    pumps, rig = setup.pumps, setup.rig
    ranges = pumps.drive_ranges
    slopes = [max(pumps.slope(pump, drive) for drive in ranges[pump]) for pump in (0, 1)]
    rate_V_s = rig.pumps.rate_V_s
    return PathLimits(
        drives_V=ranges,
        rate_V_s=(rate_V_s / slopes[0], rate_V_s / slopes[1]),
        lag_s=setup.lags_s,
        level_max_cm=rig.safety.level_max_cm,
        period_s=setup.period_s,
        delay_s=pumps.delay_s,
    )


LAWS: ChoiceTable[LawMaker] = ChoiceTable(
    "control.law",
    "fourtank_hil.laws",
    TableChoice(
        STATE_FEEDBACK,
        "the paper's state feedback with integral action; its gains are computed again for what the diagnosis finds",
        state_feedback_law,
    ),
    TableChoice("pi", "a PI controller for each output, paired by the relative gain", comparators.pi_law),
    TableChoice("lqr", "linear-quadratic state feedback with integral action", comparators.lqr_law),
    TableChoice("governor", "a command governor around the linear-quadratic law; extra mpc", comparators.governor_law),
    TableChoice("mpc", "linear model predictive control, free of offset; extra mpc", comparators.predictive_law),
    TableChoice("fuzzy_mpc", "predictive control, fuzzy model and weights; extra mpc", comparators.fuzzy_law),
    TableChoice("feedback_linearisation", "exact linearisation; minimum-phase rigs only", comparators.linearising_law),
)


def make_law(setup: LawSetup, where: str) -> ControlLaw:
    """The law that the scenario names, with its options. Raises SettingsError that begins with `where`."""
    name, given = setup.scenario.control.law, setup.scenario.control.options
    choice = LAWS.find(name, where)
    model = options_model(choice, where)
    try:
        if model is None:
            if given:
                raise SettingsError(f"{where}: control.options: the law {name!r} has none, not {', '.join(given)}")
            return choice.make(setup)
        return choice.make(setup, _checked_options(model, given, where))
    except SettingsError:
        raise
    except Exception as error:
        if not choice.package:
            raise
        raise SettingsError(
            f"{where}: control.law = {name!r}: package {choice.package}: {type(error).__name__}: {error}"
        ) from None


def options_model(choice: TableChoice[LawMaker], where: str) -> type[LawOptions] | None:
    """The settings of a law, or None if it has none. Raises SettingsError when its maker does not say."""
    names = list(inspect.signature(choice.make).parameters)
    if len(names) < 2:
        return None
    model: Any = get_type_hints(choice.make).get(names[1])
    if not (isinstance(model, type) and issubclass(model, LawOptions)):
        raise SettingsError(
            f"{where}: control.law = {choice.name!r}: the maker's parameter {names[1]!r} must be annotated with a "
            "subclass of hil.LawOptions"
        )
    return model


def _checked_options(model: type[LawOptions], given: dict[str, Any], where: str) -> LawOptions:
    """The options as settings, checked as a part of the scenario, so that errors name the key as the file has it."""
    control = create_model("ControlTable", __base__=Section, options=(model, ...))
    file = create_model("OptionsOfScenario", __base__=Section, control=(control, ...))
    checked: Any = validated(file, {"control": {"options": given}}, where)
    options: LawOptions = checked.control.options
    return options
