"""A benchmark as a list of cases: each law with each detector, on each rig, in each scenario, with each seed.

All of them have the same seeds, so that a seed is the same rig, noise and fault for everybody.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.campaigns.benchmark_spec import BenchmarkSpec, DetectorEntry, LawEntry, RigEntry
from hil.campaigns.cases import Case, ScenarioData, case_key, check_length
from hil.edge.config.settings_file import SettingsError, merged

Digest = Callable[[Path | None], str]
"""Digest of all that the results on a rig file depend on besides the case."""


@dataclass(frozen=True, slots=True)
class Entrant:
    """What is compared: a law with a detector, on a rig. Labels of the benchmark file."""

    law: str
    detector: str
    rig: str

    @property
    def name(self) -> str:
        """Law and detector."""
        return f"{self.law} · {self.detector}"


@dataclass(frozen=True, slots=True)
class Contest:
    """A case with whose it is. scenario : its name."""

    entrant: Entrant
    scenario: str
    case: Case


def contests(
    spec: BenchmarkSpec, scenarios: Sequence[ScenarioData], rig_files: Sequence[Path | None], digest: Digest
) -> tuple[Contest, ...]:
    """All runs of a benchmark. rig_files : one for each of `spec.rigs`. Raises SettingsError for a strange scenario."""
    names = [_name_of(scenario) for scenario in scenarios]
    strange = {name for rig in spec.rigs for name in rig.scenarios if name not in names}
    if strange:
        raise SettingsError(f"rig: scenarios: {sorted(strange)} are not among {names}")
    if len(set(names)) < len(names):
        raise SettingsError(f"benchmark.scenarios: the names {names} repeat")
    about = spec.benchmark
    found = []
    for rig, rig_file in zip(spec.rigs, rig_files, strict=True):
        said = digest(rig_file)
        for scenario, name in zip(scenarios, names, strict=True):
            if rig.scenarios and name not in rig.scenarios:
                continue
            for law, detector in _pairs(spec, rig):
                data = _scenario_data(spec, scenario, law, detector, rig)
                entrant = Entrant(law.label, detector.label, rig.label)
                label = f"{entrant.name} · {rig.label}"
                found += [
                    Contest(entrant, name, Case(case_key(data, seed, said), label, name, seed, data, rig_file=rig_file))
                    for seed in range(about.first_seed, about.first_seed + about.seeds)
                ]
    return tuple(found)


def _pairs(spec: BenchmarkSpec, rig: RigEntry) -> Iterator[tuple[LawEntry, DetectorEntry]]:
    for law in spec.law:
        if law.rigs and rig.label not in law.rigs:
            continue
        for detector in spec.detectors:
            if not law.detectors or detector.label in law.detectors:
                yield law, detector


def _scenario_data(
    spec: BenchmarkSpec, scenario: ScenarioData, law: LawEntry, detector: DetectorEntry, rig: RigEntry
) -> ScenarioData:
    tables: dict[str, Any] = {
        "control": law.control,
        "diagnosis": detector.diagnosis,
        "rig": merged(rig.rig, law.rig),
        "emulator": rig.emulator,
    }
    if spec.benchmark.duration_s is not None:
        tables["scenario"] = {"duration_s": spec.benchmark.duration_s}
    data = merged(scenario, {name: table for name, table in tables.items() if table})
    check_length(data, "benchmark")
    return data


def _name_of(scenario: ScenarioData) -> str:
    return str(scenario.get("scenario", {}).get("name", ""))
