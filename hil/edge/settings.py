"""Rig file and scenario: TOML to validated settings, with errors that name file, key, value and range."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Pair

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Split = Annotated[float, Field(gt=0.0, lt=1.0, allow_inf_nan=False)]
Volts = Annotated[float, Field(ge=0.0, le=10.0, allow_inf_nan=False)]
LevelVolts = Annotated[float, Field(ge=0.0, le=10.0, allow_inf_nan=False)]
LevelCm = Annotated[float, Field(ge=0.0, le=20.0, allow_inf_nan=False)]
Pole = Annotated[float, Field(lt=0.0, ge=-10.0, allow_inf_nan=False)]

LONGEST_S = 1e7
"""Longest run, 116 days."""

Model = TypeVar("Model", bound="Section")


class SettingsError(ValueError):
    """A file that can't be used: one line with file, key, value and what would be right."""


class Section(BaseModel):
    """A table of a settings file: unknown keys are errors, values are never coerced from text."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    @field_validator("*", mode="before")
    @classmethod
    def _lists_are_tuples(cls, value: Any) -> Any:
        """TOML arrays come as lists; whole numbers may stand for floats."""
        return tuple(cls._lists_are_tuples(v) for v in value) if isinstance(value, list) else value


class Range(Section):
    """Mixin for checks of a lower and an upper limit."""

    @staticmethod
    def ordered(limits: Pair) -> Pair:
        """Refuse swapped or equal limits."""
        if limits[0] >= limits[1]:
            raise ValueError(f"lower limit {limits[0]:g} is not below upper limit {limits[1]:g}")
        return limits


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

    period_s: Annotated[float, Field(ge=0.001, le=10.0, allow_inf_nan=False)]
    operating_point_V: tuple[Volts, Volts]
    output_poles: tuple[Pole, Pole, Pole, Pole]
    noise_gain_max: Positive
    anti_windup_s: Positive
    level_filter_s: NotNegative


class Safety(Section):
    """What trips, and how a run stops."""

    level_max_cm: Positive
    levels_age_max_s: Positive
    status_age_max_s: Positive
    heartbeat_age_max_s: Positive
    echo_age_max_s: Positive
    arm_timeout_s: Positive
    stop_ramp_V_s: Positive


class Bus(Section):
    """Which CAN bus, in python-can's words."""

    interface: str
    channel: str
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)]


class Rig(Section):
    """The rig file: the process and the bench as the controller believes them to be."""

    tanks: Tanks
    pumps: Pumps
    sensors: Sensors
    control: Control
    safety: Safety
    bus: Bus

    @model_validator(mode="after")
    def _trips_below_the_rim(self) -> Self:
        if self.safety.level_max_cm >= self.tanks.height_cm:
            raise ValueError(
                f"safety.level_max_cm {self.safety.level_max_cm:g} is not below "
                f"tanks.height_cm {self.tanks.height_cm:g}"
            )
        return self

    @model_validator(mode="after")
    def _starts_within_the_tanks(self) -> Self:
        levels_cm = equilibrium(self.tank_model, self.control.operating_point_V)
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


class About(Section):
    """Name and length of a scenario."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
    duration_s: Annotated[float, Field(gt=0.0, le=LONGEST_S, allow_inf_nan=False)]


class Reference(Section):
    """A change of the wanted outputs, in just one of three ways."""

    at_s: NotNegative
    change_V: tuple[Finite, Finite] | None = None
    levels_V: tuple[LevelVolts, LevelVolts] | None = None
    levels_cm: tuple[LevelCm, LevelCm] | None = None

    @model_validator(mode="after")
    def _says_it_once(self) -> Self:
        given = [k for k in ("change_V", "levels_V", "levels_cm") if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError(f"has {', '.join(given) or 'none'} of change_V, levels_V, levels_cm: give one")
        return self


class Fault(Section):
    """A fault that the emulator plays and the ideal diagnosis knows of."""

    at_s: NotNegative
    kind: Literal["pump_effectiveness"]
    target: Literal[1, 2]
    value: Share
    until_s: Positive | None = None

    @model_validator(mode="after")
    def _ends_after_it_began(self) -> Self:
        if self.until_s is not None and self.until_s <= self.at_s:
            raise ValueError(f"until_s {self.until_s:g} is not after at_s {self.at_s:g}")
        return self


class DiagnosisChoice(Section):
    """Which fault detector."""

    method: Literal["ideal", "none"] = "ideal"
    delay_s: NotNegative = 1.0


class ControlChoice(Section):
    """Which design, and whether it follows the diagnosis."""

    reconfigure: bool = True
    design: Literal["calibrated", "rig"] = "rig"


class Window(Section):
    """A stretch of the run over which IAE is computed."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
    from_s: NotNegative
    to_s: Positive

    @model_validator(mode="after")
    def _ends_after_it_began(self) -> Self:
        if self.to_s <= self.from_s:
            raise ValueError(f"to_s {self.to_s:g} is not after from_s {self.from_s:g}")
        return self


class Scenario(Section):
    """An experiment: what is asked of the loop, what goes wrong, what is measured."""

    scenario: About
    reference: tuple[Reference, ...] = ()
    fault: tuple[Fault, ...] = ()
    diagnosis: DiagnosisChoice = DiagnosisChoice()
    control: ControlChoice = ControlChoice()
    window: tuple[Window, ...] = ()
    rig: dict[str, Any] = {}
    emulator: dict[str, Any] = {}

    @model_validator(mode="after")
    def _is_in_order(self) -> Self:
        times = [r.at_s for r in self.reference]
        if times != sorted(times):
            raise ValueError(f"reference times {times} do not ascend")
        names = [w.name for w in self.window]
        if len(set(names)) != len(names):
            raise ValueError(f"window names {names} repeat")
        return self


def default_config_dir() -> Path:
    """`config` of the checkout, or its copy beside an installed package."""
    beside = Path(__file__).resolve().parents[2]
    return beside / "config" if (beside / "config" / "rig.toml").is_file() else beside / "fourtank_config"


def read_toml(path: Path) -> dict[str, Any]:
    """The file as nested dicts. Raises SettingsError when it is missing or is not TOML."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: can't be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from None


def load_scenario(path: Path) -> Scenario:
    """A scenario file. Raises SettingsError."""
    return _validated(Scenario, read_toml(path), str(path))


def load_rig(path: Path, scenario: Scenario | None = None, scenario_path: Path | None = None) -> Rig:
    """The rig file, with the scenario's [rig] table laid over it. Raises SettingsError."""
    data = read_toml(path)
    rig = _validated(Rig, data, str(path))
    if scenario is None or not scenario.rig:
        return rig
    return _validated(Rig, merged(data, scenario.rig), f"{scenario_path} [rig] over {path}")


def merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """`over` laid on `base`, table by table."""
    result = dict(base)
    for key, value in over.items():
        both_tables = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = merged(result[key], value) if both_tables else value
    return result


def _validated(model: type[Model], data: dict[str, Any], where: str) -> Model:
    try:
        return model.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = _key(first["loc"])
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        message = first["msg"].removeprefix("Value error, ")
        if first["type"] == "extra_forbidden":
            message = "unknown key"
        shown = "" if first["type"] == "missing" or isinstance(first["input"], dict) else f" = {first['input']!r}"
        subject = f"{key}{shown}: " if key else ""
        raise SettingsError(f"{where}: {subject}{message}{more}") from None


def _key(location: tuple[int | str, ...]) -> str:
    key = ""
    for part in location:
        key += f"[{part}]" if isinstance(part, int) else f".{part}" if key else part
    return key
