"""TOML to validated settings, with errors that name file, key, value and range; shared by rig file and scenario."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from hil.core.errors import HilError
from hil.core.types import Pair, Quad
from hil.edge.config.complaints import complaint

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Split = Annotated[float, Field(gt=0.0, lt=1.0, allow_inf_nan=False)]
Volts = Annotated[float, Field(ge=0.0, le=10.0, allow_inf_nan=False)]
LevelVolts = Annotated[float, Field(ge=0.0, le=1000.0, allow_inf_nan=False)]
LevelCm = Annotated[float, Field(ge=0.0, le=1000.0, allow_inf_nan=False)]
Pole = Annotated[float, Field(lt=0.0, ge=-10.0, allow_inf_nan=False)]

Parts = float | tuple[float, ...]
"""One number for all pumps, tanks or sensors, or one for each."""

SCENARIO_FILE, RIG_FILE, CAMPAIGN_FILE, EMULATOR_FILE = "a scenario", "a rig file", "a campaign", "an emulator file"
BENCHMARK_FILE = "a benchmark"

KINDS = {
    "benchmark": BENCHMARK_FILE,
    "campaign": CAMPAIGN_FILE,
    "scenario": SCENARIO_FILE,
    "nodes": EMULATOR_FILE,
    "safety": RIG_FILE,
    "bus": RIG_FILE,
}
"""A table at the top -> the only kind of file that has it."""

USED_BY = {
    BENCHMARK_FILE: "run it with `hil benchmark FILE`",
    CAMPAIGN_FILE: "run it with `hil campaign FILE`",
    SCENARIO_FILE: "run it with `hil simulate FILE` or `hil run FILE`",
    EMULATOR_FILE: "it is used as emulator.toml in the folder that --config names",
    RIG_FILE: "it is used with --rig, or as rig.toml in the folder that --config names",
}

MAX_DURATION_S = 1e7
"""Longest run, 116 days."""

Model = TypeVar("Model", bound="Section")


class SettingsError(HilError, ValueError):
    """A file that can't be used: one line with file, key, value and what is allowed."""


class Section(BaseModel):
    """A table of a settings file: unknown keys are errors, values are never coerced from text."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    FILE_KIND: ClassVar[str] = ""
    """What a file with this table at its top is."""

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


def of_both(value: Parts) -> Pair:
    """(2,) one value for each pump."""
    if not isinstance(value, tuple):
        return value, value
    first, second = value
    return first, second


def of_all(value: Parts) -> Quad:
    """(4,) one value for each tank or sensor."""
    if not isinstance(value, tuple):
        return value, value, value, value
    first, second, third, fourth = value
    return first, second, third, fourth


def default_config_dir() -> Path:
    """`config` of the checkout, or its copy beside an installed package."""
    beside = Path(__file__).resolve().parents[3]
    return beside / "config" if (beside / "config" / "rig.toml").is_file() else beside / "fourtank_config"


def read_text(path: Path) -> str:
    """The text of a configuration file. A byte order mark, as some editors put in front of UTF-8, is left out.

    Raises SettingsError when the file is missing or is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise SettingsError(f"{path}: can't be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path}: is not UTF-8 text: {error}") from None


def read_toml(path: Path) -> dict[str, Any]:
    """The file as nested dicts. Raises SettingsError when it is missing or is not TOML."""
    try:
        return tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from None


def merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """`base` with the values of `over`, table by table."""
    result = dict(base)
    for key, value in over.items():
        both_tables = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = merged(result[key], value) if both_tables else value
    return result


def validated(model: type[Model], data: dict[str, Any], where: str) -> Model:
    """The data as settings; raises SettingsError that begins with `where` and names what is wrong.

    A file that is plainly of another kind is named as that.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        kinds = kinds_of(data)
        if model.FILE_KIND and kinds and model.FILE_KIND not in kinds:
            raise SettingsError(f"{where}: is {kinds[0]}, not {model.FILE_KIND}; {USED_BY[kinds[0]]}") from None
        raise SettingsError(f"{where}: {complaint(model, error)}") from None


def kinds_of(data: Mapping[str, Any]) -> tuple[str, ...]:
    """The kinds of files that have a table that `data` has, and no other kind has."""
    return tuple(kind for table, kind in KINDS.items() if table in data)
