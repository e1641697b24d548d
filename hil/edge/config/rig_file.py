"""The rig file: the model of the process, and the settings of the bench, that the controller uses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Pair
from hil.edge.can import adapters
from hil.edge.can.adapters import BusError
from hil.edge.config.scenario_file import Scenario
from hil.edge.config.settings_file import (
    RIG_FILE,
    NotNegative,
    Pole,
    Positive,
    Range,
    Section,
    Split,
    Volts,
    merged,
    read_toml,
    validated,
)

MAX_BYPASS_S = 600.0
"""No configuration lets an interlock be bypassed for longer."""

WATCHDOG_S = 0.25
"""The pump node trips when no valid command came for so long: the wire contract, docs/reference/wire.md."""

CYCLES_S = {"levels": 0.02, "status": 0.05, "heartbeat": 0.1, "echo": 0.05}
"""Cycle times of the frames that the age limits of [safety] apply to; the echo is in the pump node's status."""

MAX_PERIOD_S = WATCHDOG_S - CYCLES_S["echo"]
"""A command has to reach the pump node, and its echo to come back, before the watchdog trips."""

TIME_TOLERANCE_S = 1e-9

MIN_SPLIT_EXCESS = 0.01
"""How far the valve splits' sum must lie from 1. There the lower levels can't be set apart: G(0) has no inverse."""


class Tanks(Section):
    """Geometry, in cm and cm^2; tank 1, 2, 3, 4."""

    area_cm2: tuple[Positive, Positive, Positive, Positive]
    outlet_cm2: tuple[Positive, Positive, Positive, Positive]
    height_cm: Positive
    gravity_cm_s2: Positive


class Pumps(Range):
    """Gains, valves and limits; pump 1, 2."""

    gain_cm3_Vs: tuple[Positive, Positive]
    valve_split: tuple[Split, Split]
    lag_s: NotNegative
    range_V: tuple[Volts, Volts]
    rate_V_s: Positive

    @field_validator("range_V")
    @classmethod
    def _range_is_ordered(cls, limits: Pair) -> Pair:
        return cls.ordered(limits)

    @field_validator("valve_split")
    @classmethod
    def _outputs_can_be_set_apart(cls, valve_split: Pair) -> Pair:
        excess = valve_split[0] + valve_split[1] - 1.0
        if abs(excess) < MIN_SPLIT_EXCESS:
            raise ValueError(
                f"the splits add up to {1.0 + excess:.4g}, within {MIN_SPLIT_EXCESS:g} of 1: "
                "there both pumps move both lower levels alike, so that no control can set them apart"
            )
        return valve_split


class Sensors(Range):
    """Level sensors."""

    gain_V_cm: Positive
    noise_V: NotNegative
    range_V: tuple[NotNegative, Positive]

    @field_validator("range_V")
    @classmethod
    def _range_is_ordered(cls, limits: Pair) -> Pair:
        return cls.ordered(limits)


class Control(Section):
    """Control period, operating point and the rig's design."""

    period_s: Annotated[float, Field(ge=0.001, allow_inf_nan=False)]
    operating_point_V: tuple[Volts, Volts]
    output_poles: tuple[Pole, Pole, Pole, Pole]
    noise_gain_max: Positive
    anti_windup_s: Positive
    level_filter_s: NotNegative

    @field_validator("period_s")
    @classmethod
    def _feeds_the_watchdog(cls, period_s: float) -> float:
        if period_s > MAX_PERIOD_S:
            raise ValueError(
                f"must be at most {MAX_PERIOD_S:g} s: the pump node's watchdog trips {WATCHDOG_S:g} s after the last "
                f"command, and {CYCLES_S['echo']:g} s of that are reserved for command and echo"
            )
        return period_s


class Safety(Section):
    """Limits at which the controller trips, and how a run stops."""

    level_max_cm: Positive
    rim_margin_cm: NotNegative
    levels_age_max_s: Positive
    status_age_max_s: Positive
    heartbeat_age_max_s: Positive
    echo_age_max_s: Positive
    echo_tolerance_V: Positive
    echo_mismatch_s: NotNegative
    invalid_run_max: Annotated[int, Field(ge=1, le=100)]
    refused_run_max: Annotated[int, Field(ge=1, le=100)]
    errors_per_s_max: Annotated[int, Field(ge=1, le=1000)]
    dead_below: Annotated[float, Field(ge=0.0, lt=1.0, allow_inf_nan=False)]
    dead_pump: Literal["continue", "stop"]
    lost_lower_level: Literal["continue", "stop"]
    dry_run_V: NotNegative
    bypass_max_s: Annotated[float, Field(gt=0.0, le=MAX_BYPASS_S, allow_inf_nan=False)]
    arm_timeout_s: Positive
    stop_ramp_V_s: Positive


class Bus(Section):
    """Which CAN bus, in python-can's words."""

    interface: str
    channel: str
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)]

    @field_validator("interface")
    @classmethod
    def _interface_is_known(cls, interface: str) -> str:
        try:
            adapters.find(interface)
        except BusError as error:
            raise ValueError(str(error)) from None
        return interface


class Rig(Section):
    """The rig file: the model of the process, and the settings of the bench, that the controller uses."""

    FILE_KIND = RIG_FILE

    tanks: Tanks
    pumps: Pumps
    sensors: Sensors
    control: Control
    safety: Safety
    bus: Bus

    @model_validator(mode="after")
    def _trips_below_the_rim(self) -> Self:
        safety, height_cm = self.safety, self.tanks.height_cm
        if safety.level_max_cm >= height_cm:
            raise ValueError(f"safety.level_max_cm {safety.level_max_cm:g} is not below tanks.height_cm {height_cm:g}")
        if safety.level_max_cm + safety.rim_margin_cm > height_cm:
            raise ValueError(
                f"safety.rim_margin_cm {safety.rim_margin_cm:g} leaves no room for safety.level_max_cm "
                f"{safety.level_max_cm:g} below tanks.height_cm {height_cm:g}"
            )
        return self

    @model_validator(mode="after")
    def _ages_are_longer_than_a_period(self) -> Self:
        period_s = self.control.period_s
        for name, cycle_s in CYCLES_S.items():
            key = f"{name}_age_max_s"
            limit_s = getattr(self.safety, key)
            if limit_s < period_s + cycle_s - TIME_TOLERANCE_S:
                raise ValueError(
                    f"safety.{key} {limit_s:g} s is less than control.period_s {period_s:g} s and the frame's cycle "
                    f"of {cycle_s:g} s: one late step would trip the run"
                )
        return self

    @model_validator(mode="after")
    def _starts_within_the_tanks(self) -> Self:
        try:
            levels_cm = equilibrium(self.tank_model, self.control.operating_point_V)
        except ArithmeticError as error:
            raise ValueError(f"no levels can be computed from tanks and pumps: {error}") from None
        highest_cm = self.safety.level_max_cm
        if not all(0.0 < level_cm < highest_cm for level_cm in levels_cm):
            shown = ", ".join(f"{level_cm:.4g}" for level_cm in levels_cm)
            raise ValueError(
                f"control.operating_point_V {list(self.control.operating_point_V)} holds levels of {shown} cm, "
                f"want all of them within 0..{highest_cm:g} cm (safety.level_max_cm)"
            )
        return self

    @property
    def tank_model(self) -> TankModel:
        """The numbers of eq. (1)."""
        return TankModel(
            self.tanks.area_cm2,
            self.tanks.outlet_cm2,
            self.pumps.gain_cm3_Vs,
            self.pumps.valve_split,
            self.sensors.gain_V_cm,
            self.tanks.height_cm,
            self.tanks.gravity_cm_s2,
        )


def load_rig(path: Path, scenario: Scenario | None = None, scenario_path: Path | None = None) -> Rig:
    """The rig file, with the scenario's [rig] table merged into it. Raises SettingsError."""
    data = read_toml(path)
    rig = validated(Rig, data, str(path))
    if scenario is None or not scenario.rig:
        return rig
    return validated(Rig, merged(data, scenario.rig), f"{scenario_path} [rig] over {path}")
