"""The campaign file: scenarios, seeds, overlays and faults. See docs/how-to/campaign.md."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from hil.campaigns.draw_spec import Draw
from hil.edge.config.settings_file import (
    CAMPAIGN_FILE,
    MAX_DURATION_S,
    Finite,
    NotNegative,
    Positive,
    Section,
    SettingsError,
    read_toml,
    validated,
)

MAX_SEEDS = 1_000_000
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Span = tuple[NotNegative, NotNegative]
Target = int | str


class CampaignInfo(Section):
    """Name, scenarios and seeds. scenarios : paths from the file's folder. duration_s : replaces the scenarios'."""

    name: Name
    scenarios: Annotated[tuple[str, ...], Field(min_length=1)]
    first_seed: Annotated[int, Field(ge=0, le=MAX_SEEDS)] = 1
    seeds: Annotated[int, Field(ge=1, le=MAX_SEEDS)] = 10
    duration_s: Annotated[float, Field(gt=0.0, le=MAX_DURATION_S, allow_inf_nan=False)] | None = None


class Timed(Section):
    """When a fault begins, drawn from onset_s for each seed, and how long it lasts (None: until the end)."""

    onset_s: Span
    lasts_s: Positive | None = None

    @model_validator(mode="after")
    def _onsets_are_ordered(self) -> Self:
        if self.onset_s[0] > self.onset_s[1]:
            raise ValueError(f"onset_s {list(self.onset_s)}: the first is not below the second")
        return self


class FaultRow(Timed):
    """A row of the grid: every target with every value and ramp is a case. A target that is a list: all at once.

    ramps_s : times in which the fault grows to its value; without any it begins abruptly.
    also : further keys of the scenario's [[fault]].
    """

    kind: str
    targets: Annotated[tuple[Target | tuple[Target, ...], ...], Field(min_length=1)] = (0,)
    values: tuple[Finite, ...] = ()
    ramps_s: tuple[NotNegative, ...] = ()
    also: dict[str, Any] = Field(default_factory=dict)


class PoolRow(Section):
    """Faults to draw from: one of the targets, a value within value_range."""

    kind: str
    targets: Annotated[tuple[Target, ...], Field(min_length=1)] = (0,)
    value_range: tuple[Finite, Finite] | None = None
    also: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _range_is_ordered(self) -> Self:
        if self.value_range is not None and self.value_range[0] > self.value_range[1]:
            raise ValueError(f"value_range {list(self.value_range)}: the first is not below the second")
        return self


class Pairs(Timed):
    """Two different faults of the pool in every case, each with its own onset; one case for each seed."""

    pool: Annotated[tuple[PoolRow, ...], Field(min_length=2)]


class OneFault(Timed):
    """One fault of the pool in every case; one case for each seed."""

    pool: Annotated[tuple[PoolRow, ...], Field(min_length=1)]


class Spec(Section):
    """A campaign. Without [[fault]], [pairs] and [one_fault] the scenarios' own faults are played, else only these.

    emulator, rig, diagnosis, control : merged into the scenarios' tables of that name. draw : a rig for each seed.
    """

    FILE_KIND = CAMPAIGN_FILE

    campaign: CampaignInfo
    emulator: dict[str, Any] = Field(default_factory=dict)
    rig: dict[str, Any] = Field(default_factory=dict)
    diagnosis: dict[str, Any] = Field(default_factory=dict)
    control: dict[str, Any] = Field(default_factory=dict)
    fault: tuple[FaultRow, ...] = ()
    pairs: Pairs | None = None
    one_fault: OneFault | None = None
    draw: Draw | None = None

    @property
    def has_own_faults(self) -> bool:
        """Whether the campaign says which faults are played; otherwise its scenarios do."""
        return bool(self.fault) or self.pairs is not None or self.one_fault is not None

    @property
    def overlay(self) -> dict[str, Any]:
        """What is merged into each scenario."""
        names = ("emulator", "rig", "diagnosis", "control")
        return {name: table for name in names if (table := getattr(self, name))}


def load_spec(path: Path) -> tuple[Spec, tuple[Path, ...]]:
    """The campaign at `path` with the scenario files it names.

    path : a campaign file, a scenario file (a campaign of that one), or a folder (of all scenarios in it).
    Raises SettingsError.
    """
    if path.is_dir():
        files = sorted(path.glob("*.toml"))
        if not files:
            raise SettingsError(f"{path}: has no *.toml file")
        return _of_scenarios(path.resolve().name, files), tuple(files)
    data = read_toml(path)
    if "scenario" in data and "campaign" not in data:
        return _of_scenarios(path.stem, [path]), (path,)
    spec = validated(Spec, data, str(path))
    return spec, tuple(path.parent / name for name in spec.campaign.scenarios)


def _of_scenarios(name: str, files: list[Path]) -> Spec:
    about = {"name": name, "scenarios": [str(file) for file in files]}
    return validated(Spec, {"campaign": about}, name)
