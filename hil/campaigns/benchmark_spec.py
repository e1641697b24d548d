"""The benchmark file: laws, detectors, rigs and scenarios to compare, and seeds. See docs/how-to/benchmark.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from hil.campaigns.spec import MAX_SEEDS, Name
from hil.edge.config.settings_file import BENCHMARK_FILE, MAX_DURATION_S, Section, read_toml, validated

Label = Annotated[str, Field(min_length=1, max_length=60)]


class BenchmarkInfo(Section):
    """Name, scenarios and seeds.

    scenarios : paths from the file's folder. noise_window : name of the window in which the noise of the voltages is
    taken, in the scenarios that have it. duration_s : replaces the scenarios'.
    """

    name: Name
    scenarios: Annotated[tuple[str, ...], Field(min_length=1)]
    first_seed: Annotated[int, Field(ge=0, le=MAX_SEEDS)] = 50_001
    seeds: Annotated[int, Field(ge=1, le=MAX_SEEDS)] = 20
    noise_window: Name = "rest"
    duration_s: Annotated[float, Field(gt=0.0, le=MAX_DURATION_S, allow_inf_nan=False)] | None = None


class LawEntry(Section):
    """A law with its options. control, rig : merged into the scenario's tables of that name.

    detectors, rigs : labels of those it is run with; none: with all.
    """

    label: Label
    control: dict[str, Any] = Field(default_factory=dict)
    rig: dict[str, Any] = Field(default_factory=dict)
    detectors: tuple[Label, ...] = ()
    rigs: tuple[Label, ...] = ()


class DetectorEntry(Section):
    """A detector with its options. diagnosis : merged into the scenario's [diagnosis]."""

    label: Label
    diagnosis: dict[str, Any] = Field(default_factory=dict)


class RigEntry(Section):
    """A rig. file : path from the benchmark file's folder, or shipped name; None: the configuration folder's.

    rig, emulator : merged into the scenario's tables of that name. scenarios : names of those that are run on it; none:
    all.
    """

    label: Label
    file: str | None = None
    rig: dict[str, Any] = Field(default_factory=dict)
    emulator: dict[str, Any] = Field(default_factory=dict)
    scenarios: tuple[Name, ...] = ()


class BenchmarkSpec(Section):
    """A benchmark: laws x detectors x rigs x scenarios x seeds. No [[detector]] or no [[rig]]: the scenarios' own."""

    FILE_KIND = BENCHMARK_FILE

    benchmark: BenchmarkInfo
    law: Annotated[tuple[LawEntry, ...], Field(min_length=1)]
    detector: tuple[DetectorEntry, ...] = ()
    rig: tuple[RigEntry, ...] = ()

    @model_validator(mode="after")
    def _labels_are_known(self) -> Self:
        for name, entries in (("law", self.law), ("detector", self.detectors), ("rig", self.rigs)):
            labels = [entry.label for entry in entries]
            if len(set(labels)) < len(labels):
                raise ValueError(f"{name}: labels {labels} repeat")
        for law in self.law:
            _check_known(law.detectors, [one.label for one in self.detectors], f"law {law.label!r}: detectors")
            _check_known(law.rigs, [one.label for one in self.rigs], f"law {law.label!r}: rigs")
        return self

    @property
    def detectors(self) -> tuple[DetectorEntry, ...]:
        """The detectors; at least the scenarios' own."""
        return self.detector or (DetectorEntry(label="as in the scenario"),)

    @property
    def rigs(self) -> tuple[RigEntry, ...]:
        """The rigs; at least the scenarios' own."""
        return self.rig or (RigEntry(label="as in the scenario"),)


def load_benchmark_spec(path: Path) -> tuple[BenchmarkSpec, tuple[Path, ...]]:
    """The benchmark at `path` with the scenario files that it names. Raises SettingsError."""
    spec = validated(BenchmarkSpec, read_toml(path), str(path))
    return spec, tuple(path.parent / name for name in spec.benchmark.scenarios)


def with_benchmark_seeds(spec: BenchmarkSpec, seeds: int | None, first_seed: int | None) -> BenchmarkSpec:
    """The spec with the values of the command line; None: unchanged."""
    said = {"seeds": seeds, "first_seed": first_seed}
    changes = {name: value for name, value in said.items() if value is not None}
    return spec.model_copy(update={"benchmark": spec.benchmark.model_copy(update=changes)})


def _check_known(asked: Sequence[str], known: Sequence[str], where: str) -> None:
    strange = [label for label in asked if label not in known]
    if strange:
        raise ValueError(f"{where}: {strange} are not among {list(known)}")
