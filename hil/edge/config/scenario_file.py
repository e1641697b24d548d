"""The scenario file: references, faults, operator requests and windows of an experiment."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from hil.core.fault_course import FaultCourse
from hil.core.fault_kinds import FaultKind
from hil.edge.config.accept_table import AcceptTable
from hil.edge.config.settings_file import (
    MAX_DURATION_S,
    SCENARIO_FILE,
    Finite,
    LevelCm,
    LevelVolts,
    NotNegative,
    Positive,
    Section,
    Volts,
    read_toml,
    validated,
)


class ScenarioInfo(Section):
    """Name and length of a scenario: in seconds, or "open" for a run that an operator ends."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
    duration_s: Annotated[float, Field(gt=0.0, le=MAX_DURATION_S, allow_inf_nan=False)] | Literal["open"]

    @property
    def length_s(self) -> float:
        """In seconds; inf for a run that an operator ends."""
        return math.inf if isinstance(self.duration_s, str) else self.duration_s


class Reference(Section):
    """A change of the references, given in exactly one of four ways.

    ramp_s : the references move to the new values linearly in this time. file : a CSV file with a trajectory, see
    `hil.edge.config.trajectory_file`.
    """

    at_s: NotNegative
    change_V: tuple[Finite, Finite] | None = None
    levels_V: tuple[LevelVolts, LevelVolts] | None = None
    levels_cm: tuple[LevelCm, LevelCm] | None = None
    file: Annotated[str, Field(min_length=1, max_length=4096)] | None = None
    ramp_s: NotNegative = 0.0

    @model_validator(mode="after")
    def _says_it_once(self) -> Self:
        given = [k for k in ("change_V", "levels_V", "levels_cm", "file") if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError(f"has {', '.join(given) or 'none'} of change_V, levels_V, levels_cm, file: give one")
        if self.file is not None and self.ramp_s > 0.0:
            raise ValueError("has file and ramp_s: a trajectory has its own times")
        return self


BypassableName = Literal["echo_mismatch", "error_storm", "dry_run", "pump_dead", "estimator_diverged", "unknown_fault"]


class Fault(Section):
    """A fault that the emulator plays. The detector `ideal` knows those that reduce a pump's gain.

    The emulator checks target and value of all other kinds, and whether a kind can grow.
    """

    at_s: NotNegative
    kind: FaultKind
    target: Annotated[Any, Field(validate_default=True)] = None
    value: Annotated[Finite | None, Field(validate_default=True)] = None
    until_s: Positive | None = None
    ramp_s: NotNegative = 0.0
    period_s: Positive | None = None
    duty: Annotated[float, Field(gt=0.0, lt=1.0, allow_inf_nan=False)] | None = None

    @property
    def course(self) -> FaultCourse:
        """When it is there, and how it grows."""
        until_s = math.inf if self.until_s is None else self.until_s
        return FaultCourse(self.at_s, until_s, self.ramp_s, self.period_s, 1.0 if self.duty is None else self.duty)

    @property
    def effectiveness(self) -> float | None:
        """What this fault leaves of a pump's gain; None if it is of another kind."""
        if self.kind is FaultKind.PUMP_DEAD:
            return 0.0
        return self.value if self.kind is FaultKind.PUMP_EFFECTIVENESS else None

    @field_validator("kind", mode="before")
    @classmethod
    def _is_known(cls, kind: Any) -> Any:
        if not isinstance(kind, str) or kind not in set(FaultKind):
            raise ValueError(f"is none of {' '.join(FaultKind)}")
        return FaultKind(kind)

    @field_validator("target")
    @classmethod
    def _is_a_number_or_name(cls, target: Any, info: ValidationInfo) -> int | str | None:
        is_number = isinstance(target, int) and not isinstance(target, bool)
        is_pump_loss = info.data.get("kind") in (FaultKind.PUMP_EFFECTIVENESS, FaultKind.PUMP_DEAD)
        if is_pump_loss and not (is_number and target in (1, 2)):
            raise ValueError("must be pump 1 or 2")
        if not (is_number or target is None or isinstance(target, str)):
            raise ValueError("must be a whole number or a name")
        return target  # type: ignore[no-any-return]

    @field_validator("value")
    @classmethod
    def _is_a_share(cls, value: float | None, info: ValidationInfo) -> float | None:
        if info.data.get("kind") is FaultKind.PUMP_EFFECTIVENESS and (value is None or not 0.0 <= value <= 1.0):
            raise ValueError("is missing; it must lie in 0..1" if value is None else "must lie in 0..1")
        return value

    @model_validator(mode="after")
    def _ends_after_it_began(self) -> Self:
        if self.until_s is not None and self.until_s <= self.at_s:
            raise ValueError(f"until_s {self.until_s:g} is not after at_s {self.at_s:g}")
        if (self.period_s is None) != (self.duty is None):
            raise ValueError("has one of period_s and duty: an intermittent fault needs both")
        return self


class OperatorRequest(Section):
    """A request of the operator during a run.

    manual : pump voltages by hand, `voltage_V`, or those in force without it. auto : back to the loop.
    bypass : leave an `interlock` out for `for_s`. clear : a trip. stop : ramp down and end the run.
    """

    at_s: Positive
    action: Literal["manual", "auto", "bypass", "clear", "stop"]
    voltage_V: tuple[Volts, Volts] | None = None
    interlock: BypassableName | None = None
    for_s: Annotated[float, Field(gt=0.0, le=600.0, allow_inf_nan=False)] | None = None

    @model_validator(mode="after")
    def _has_what_its_action_needs(self) -> Self:
        if self.voltage_V is not None and self.action != "manual":
            raise ValueError(f"voltage_V is for manual, not for {self.action}")
        needed = self.action == "bypass"
        for key in ("interlock", "for_s"):
            if (getattr(self, key) is not None) != needed:
                raise ValueError(f"bypass needs {key}" if needed else f"{key} is for bypass, not for {self.action}")
        return self


ChoiceName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
"""A name in a table of the bench (`hil.bench.designs`, `hil.bench.detectors`), which checks it on loading."""


def _within(low: float, high: float) -> Any:
    return Field(ge=low, le=high, allow_inf_nan=False)


class DiagnosisChoice(Section):
    """Which fault detector, and whether it may move the pumps to tell faults apart.

    method : by name, see `hil.bench.detectors`. delay_s : of the detector `ideal`. probe, probe_V, probe_s,
    probe_hold_s, probe_after_s, probe_again_s : see `hil.core.active_isolation`.
    """

    method: ChoiceName = "glr"
    delay_s: NotNegative = 1.0
    probe: bool = True
    probe_V: Annotated[float, _within(0.05, 1.0)] = 0.3
    probe_s: Annotated[float, _within(5.0, 120.0)] = 30.0
    probe_hold_s: Annotated[float, _within(0.0, 300.0)] = 60.0
    probe_after_s: Annotated[float, _within(1.0, 600.0)] = 10.0
    probe_again_s: Annotated[float, _within(60.0, 86400.0)] = 300.0


class ControlChoice(Section):
    """Which control law, by name, see `hil.bench.law_choices`, with options of its own, and what is common to all laws.

    design : of the law `state_feedback`, by name, see `hil.bench.designs`. feedforward : of the same law, see
    `hil.core.feedforward`; without it, on for a design whose operating point follows the reference. reconfigure :
    whether the law follows the diagnosis. options : the settings of the law.
    """

    reconfigure: bool = True
    law: ChoiceName = "state_feedback"
    design: ChoiceName = "rig"
    feedforward: bool | None = None
    options: dict[str, Any] = Field(default_factory=dict)


class WindowTable(Section):
    """A part of the run over which IAE is computed."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
    from_s: NotNegative
    to_s: Positive

    @model_validator(mode="after")
    def _ends_after_it_began(self) -> Self:
        if self.to_s <= self.from_s:
            raise ValueError(f"to_s {self.to_s:g} is not after from_s {self.from_s:g}")
        return self


class Scenario(Section):
    """An experiment: references, faults, operator requests, windows for the key figures, limits that it has to keep."""

    FILE_KIND = SCENARIO_FILE

    scenario: ScenarioInfo
    reference: tuple[Reference, ...] = ()
    fault: tuple[Fault, ...] = ()
    request: tuple[OperatorRequest, ...] = ()
    diagnosis: DiagnosisChoice = DiagnosisChoice()
    control: ControlChoice = ControlChoice()
    window: tuple[WindowTable, ...] = ()
    accept: tuple[AcceptTable, ...] = ()
    rig: dict[str, Any] = Field(default_factory=dict)
    emulator: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _is_in_order(self) -> Self:
        for name, listed in (("reference", self.reference), ("request", self.request)):
            times = [entry.at_s for entry in listed]
            if times != sorted(times):
                raise ValueError(f"{name} times {times} do not ascend")
        names = [w.name for w in self.window]
        if len(set(names)) != len(names):
            raise ValueError(f"window names {names} repeat")
        limits = [accept.name for accept in self.accept]
        if len(set(limits)) != len(limits):
            raise ValueError(f"accept names {limits} repeat")
        return self


def load_scenario(path: Path) -> Scenario:
    """A scenario file. Raises SettingsError."""
    return validated(Scenario, read_toml(path), str(path))
