"""The scenario file: an experiment, what is asked of the loop, what goes wrong, what is measured."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from hil.edge.settings import (
    LONGEST_S,
    Finite,
    LevelCm,
    LevelVolts,
    NotNegative,
    Positive,
    Section,
    Share,
    read_toml,
    validated,
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
    rig: dict[str, Any] = Field(default_factory=dict)
    emulator: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _is_in_order(self) -> Self:
        times = [r.at_s for r in self.reference]
        if times != sorted(times):
            raise ValueError(f"reference times {times} do not ascend")
        names = [w.name for w in self.window]
        if len(set(names)) != len(names):
            raise ValueError(f"window names {names} repeat")
        return self


def load_scenario(path: Path) -> Scenario:
    """A scenario file. Raises SettingsError."""
    return validated(Scenario, read_toml(path), str(path))
