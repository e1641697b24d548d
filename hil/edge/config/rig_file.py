"""The rig file: the model of the process, and the settings of the bench, that the controller uses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from hil.core.pumps import PumpPath
from hil.core.sensors import LevelSensors
from hil.core.start_phase import When
from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Pair, Quad
from hil.core.uncertainty import Uncertainty
from hil.edge.can import adapters
from hil.edge.can.adapters import BusError
from hil.edge.config.scenario_file import Scenario
from hil.edge.config.settings_file import (
    RIG_FILE,
    Finite,
    NotNegative,
    Parts,
    Pole,
    Positive,
    Range,
    Section,
    Share,
    Split,
    Volts,
    merged,
    of_all,
    of_both,
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


MIN_GAIN_V_CM = 1e-3
"""A sensor with less gain than this shows no level."""

Delay = Annotated[float, Field(ge=0.0, le=10.0, allow_inf_nan=False)]
LagShare = Annotated[float, Field(ge=0.0, le=5.0, allow_inf_nan=False)]


class Tanks(Section):
    """Geometry, in cm and cm^2; tank 1, 2, 3, 4."""

    area_cm2: tuple[Positive, Positive, Positive, Positive]
    outlet_cm2: tuple[Positive, Positive, Positive, Positive]
    height_cm: Positive | tuple[Positive, Positive, Positive, Positive]
    datum_cm: NotNegative | tuple[NotNegative, NotNegative, NotNegative, NotNegative] = 0.0
    gravity_cm_s2: Positive


class Pumps(Range):
    """Gains, curves, valves and limits; pump 1, 2."""

    gain_cm3_Vs: tuple[Positive, Positive]
    dead_zone_V: NotNegative | tuple[NotNegative, NotNegative] = 0.0
    curve_1_V: Finite | tuple[Finite, Finite] = 0.0
    valve_split: tuple[Split, Split]
    lag_s: NotNegative | tuple[NotNegative, NotNegative]
    delay_s: Delay | tuple[Delay, Delay] = 0.0
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

    @model_validator(mode="after")
    def _gives_more_with_more_voltage(self) -> Self:
        high_V = self.range_V[1]
        for pump, (dead_zone_V, curve_1_V) in enumerate(
            zip(of_both(self.dead_zone_V), of_both(self.curve_1_V), strict=True), 1
        ):
            if dead_zone_V >= high_V:
                raise ValueError(
                    f"dead_zone_V {dead_zone_V:g} V of pump {pump} is not below range_V's upper limit {high_V:g} V"
                )
            lowest = -0.5 / (high_V - dead_zone_V)
            if curve_1_V <= lowest:
                raise ValueError(
                    f"curve_1_V {curve_1_V:g} of pump {pump} must be above {lowest:.4g}: with less, a higher voltage "
                    f"within range_V gives less flow"
                )
        return self


class Sensors(Range):
    """Level sensors."""

    gain_V_cm: Finite | tuple[Finite, Finite, Finite, Finite]
    offset_V: Finite | tuple[Finite, Finite, Finite, Finite] = 0.0
    noise_V: NotNegative | tuple[NotNegative, NotNegative, NotNegative, NotNegative]
    range_V: tuple[NotNegative, Positive]

    @field_validator("range_V")
    @classmethod
    def _range_is_ordered(cls, limits: Pair) -> Pair:
        return cls.ordered(limits)

    @field_validator("gain_V_cm")
    @classmethod
    def _shows_the_level(cls, gain_V_cm: Parts) -> Parts:
        if min(map(abs, of_all(gain_V_cm))) < MIN_GAIN_V_CM:
            raise ValueError(f"a gain is {MIN_GAIN_V_CM:g} V/cm or more, or negative for a sensor that falls")
        return gain_V_cm


class Doubt(Section):
    """How far the rig may be off this file: one standard deviation, relative to the value."""

    pump_gain: Share | tuple[Share, Share] = 0.03
    valve_split: Share | tuple[Share, Share] = 0.03
    outlet: Share | tuple[Share, Share, Share, Share] = 0.03
    lag: LagShare | tuple[LagShare, LagShare] = 0.5

    @property
    def of_each(self) -> Uncertainty:
        """One value for each pump and tank."""
        return Uncertainty(
            pump_gain=of_both(self.pump_gain),
            valve_split=of_both(self.valve_split),
            outlet=of_all(self.outlet),
            lag=of_both(self.lag),
        )


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
    unknown_fault_max_s: NotNegative = 60.0
    unattended_s: NotNegative = 0.0
    dry_run_V: NotNegative
    bypass_max_s: Annotated[float, Field(gt=0.0, le=MAX_BYPASS_S, allow_inf_nan=False)]
    arm_timeout_s: Positive
    stop_ramp_V_s: Positive


class Start(Section):
    """How a run begins whose tanks are not at its first reference."""

    phase: Literal["auto", "always", "never"] = "auto"
    rate_cm_s: Annotated[float, Field(gt=0.0, le=1.0, allow_inf_nan=False)] = 0.1
    settle_s: Annotated[float, Field(ge=0.0, le=3600.0, allow_inf_nan=False)] = 60.0
    tolerance_cm: Positive = 0.5

    @property
    def when(self) -> When:
        """The choice of `phase`."""
        return When(self.phase)


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
    start: Start = Start()
    bus: Bus
    uncertainty: Doubt = Doubt()

    @model_validator(mode="after")
    def _trips_below_the_rim(self) -> Self:
        safety, height_cm = self.safety, min(of_all(self.tanks.height_cm))
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
            levels_cm = equilibrium(self.tank_model, self.operating_drives)
        except ArithmeticError as error:
            raise ValueError(f"no levels can be computed from tanks and pumps: {error}") from None
        highest_cm = self.safety.level_max_cm
        if not all(0.0 < level_cm < highest_cm for level_cm in levels_cm):
            shown = ", ".join(f"{level_cm:.4g}" for level_cm in levels_cm)
            empty = ", ".join(f"{tank}" for tank, level_cm in enumerate(levels_cm, 1) if level_cm <= 0.0)
            why = f"; so little flow leaves through the low outlet of tank {empty}, which is empty" if empty else ""
            raise ValueError(
                f"control.operating_point_V {list(self.control.operating_point_V)} holds levels of {shown} cm, "
                f"want all of them within 0..{highest_cm:g} cm (safety.level_max_cm){why}"
            )
        return self._shows(levels_cm)

    def _shows(self, levels_cm: Quad) -> Self:
        """Every sensor can show its level at the operating point, and the one that trips."""
        low_V, high_V = self.sensors.range_V
        gains, offsets = of_all(self.sensors.gain_V_cm), of_all(self.sensors.offset_V)
        for tank, (gain, offset_V, level_cm) in enumerate(zip(gains, offsets, levels_cm, strict=True), 1):
            for shown_cm, what in ((level_cm, "operating point"), (self.safety.level_max_cm, "safety.level_max_cm")):
                reading_V = offset_V + gain * shown_cm
                if not low_V <= reading_V <= high_V:
                    raise ValueError(
                        f"sensor {tank} would read {reading_V:.4g} V at {shown_cm:.4g} cm ({what}), outside "
                        f"sensors.range_V {low_V:g}..{high_V:g} V: look at sensors.gain_V_cm and offset_V"
                    )
        return self

    @property
    def tank_model(self) -> TankModel:
        """The numbers of eq. (1)."""
        return TankModel(
            area_cm2=self.tanks.area_cm2,
            outlet_cm2=self.tanks.outlet_cm2,
            pump_gain_cm3_Vs=self.pumps.gain_cm3_Vs,
            valve_split=self.pumps.valve_split,
            level_gain_V_cm=self.level_sensors.signal_gain,
            height_cm=of_all(self.tanks.height_cm),
            gravity_cm_s2=self.tanks.gravity_cm_s2,
            datum_cm=of_all(self.tanks.datum_cm),
        )

    @property
    def pump_path(self) -> PumpPath:
        """What lies between the commands and the flow of the pumps."""
        pumps = self.pumps
        return PumpPath(of_both(pumps.dead_zone_V), of_both(pumps.curve_1_V), of_both(pumps.delay_s), pumps.range_V)

    @property
    def lags_s(self) -> Pair:
        """(2,) lag of each pump."""
        return of_both(self.pumps.lag_s)

    @property
    def operating_drives(self) -> Pair:
        """(2,) drives of the operating point."""
        return self.pump_path.drive(self.control.operating_point_V)

    @property
    def level_sensors(self) -> LevelSensors:
        """What the readings mean."""
        sensors = self.sensors
        return LevelSensors(of_all(sensors.gain_V_cm), of_all(sensors.offset_V), sensors.range_V)

    @property
    def signal_noise(self) -> Quad:
        """(4,) standard deviation of one reading, as one of the level signal."""
        return self.level_sensors.scaled(of_all(self.sensors.noise_V))


def load_rig(path: Path, scenario: Scenario | None = None, scenario_path: Path | None = None) -> Rig:
    """The rig file, with the scenario's [rig] table merged into it. Raises SettingsError."""
    data = read_toml(path)
    rig = validated(Rig, data, str(path))
    if scenario is None or not scenario.rig:
        return rig
    return validated(Rig, merged(data, scenario.rig), f"{scenario_path} [rig] over {path}")
