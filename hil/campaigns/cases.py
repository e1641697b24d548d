"""The campaign as a list of cases. The same file gives the same list, and each case the same key, on any machine."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random
from typing import Any

from hil.campaigns.rig_draw import RigNumbers, draw_rig
from hil.campaigns.spec import FaultRow, OneFault, Pairs, PoolRow, Spec, Target
from hil.edge.config.settings_file import SettingsError, merged

KEY_DIGITS = 16
ONSET_DIGITS = 6
HEALTHY, PAIRS, ONE_FAULT = "no fault", "pairs", "one fault"

Fault = dict[str, Any]
ScenarioData = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One run.

    key : a digest of all that its result depends on. label : the class of faults that it is grouped by.
    scenario_data : the scenario as a dict. drawn : what [draw] drew for it. rig_file : the rig that it runs on; None:
    the configuration's `rig.toml` and `emulator.toml`.
    """

    key: str
    label: str
    scenario: str
    seed: int
    scenario_data: ScenarioData
    drawn: Mapping[str, Any] = field(default_factory=dict)
    rig_file: Path | None = None

    @property
    def faults(self) -> Sequence[Mapping[str, Any]]:
        """The scenario's [[fault]] tables."""
        faults: Sequence[Mapping[str, Any]] = self.scenario_data.get("fault", ())
        return faults


@dataclass(frozen=True)
class Cell:
    """A cell of the fault grid: a class of faults, from which each seed draws its faults."""

    label: str
    row: FaultRow | None = None
    target: Target | tuple[Target, ...] = 0
    value: float | None = None
    ramp_s: float | None = None


def expand(
    spec: Spec, scenarios: Sequence[ScenarioData], digest: str = "", rigs: Sequence[RigNumbers] = ()
) -> tuple[Case, ...]:
    """All cases: scenarios times cells times seeds.

    scenarios : the spec's scenario files as dicts. digest : of everything else that results depend on. rigs : for a
    spec with [draw], the rig that the draws start from, for each scenario. Raises SettingsError for a rig that can't
    be drawn.
    """
    about = spec.campaign
    seeds = range(about.first_seed, about.first_seed + about.seeds)
    bases: Sequence[RigNumbers | None] = rigs or [None] * len(scenarios)
    cases = [
        _case(spec, cell, scenario_data, seed, digest, base)
        for scenario_data, base in zip(scenarios, bases, strict=True)
        for cell in _cells(spec, scenario_data)
        for seed in seeds
    ]
    return tuple(cases)


def with_overlay(spec: Spec, scenario_data: ScenarioData) -> ScenarioData:
    """The scenario with the spec's tables and its length merged in."""
    scenario_data = merged(scenario_data, spec.overlay)
    if spec.campaign.duration_s is not None:
        scenario_data = merged(scenario_data, {"scenario": {"duration_s": spec.campaign.duration_s}})
    check_length(scenario_data, "campaign")
    return scenario_data


def check_length(scenario_data: ScenarioData, kind: str) -> None:
    """A run of a campaign or benchmark needs an end. Raises SettingsError."""
    info = scenario_data.get("scenario", {})
    if isinstance(info, dict) and info.get("duration_s") == "open":
        raise SettingsError(
            f"scenario {info.get('name', '')}: scenario.duration_s = 'open': such a run is ended by hand; "
            f"give the {kind} a length ({kind}.duration_s)"
        )


def with_seeds(spec: Spec, seeds: int | None, first_seed: int | None, duration_s: float | None) -> Spec:
    """The spec with the values of the command line; None: unchanged."""
    said = {"seeds": seeds, "first_seed": first_seed, "duration_s": duration_s}
    changes = {name: value for name, value in said.items() if value is not None}
    return spec.model_copy(update={"campaign": spec.campaign.model_copy(update=changes)})


def check_faults_are_played(case: Case, where: str) -> None:
    """A fault that begins after the end of the run would count as one that was not found. Raises SettingsError."""
    duration_s = float(case.scenario_data["scenario"]["duration_s"])
    for fault in case.faults:
        if float(fault["at_s"]) >= duration_s:
            raise SettingsError(
                f"{where}: seed {case.seed}: {fault['kind']} begins at {fault['at_s']:g} s, but the run ends at "
                f"{duration_s:g} s: it would not be played; lengthen the run (--duration, duration_s) or lower onset_s"
            )


def fault_label(faults: Sequence[Mapping[str, Any]]) -> str:
    """A class of faults by name: kinds, targets, values and ramps, faults that differ only in target taken together."""
    targets: dict[tuple[str, Any, Any], list[str]] = {}
    for fault in faults:
        course = (str(fault["kind"]), fault.get("value"), fault.get("ramp_s"))
        targets.setdefault(course, []).append(str(fault.get("target", 0)))
    names = (_class_name(kind, "+".join(hit), value, ramp_s) for (kind, value, ramp_s), hit in targets.items())
    return ", ".join(names) or HEALTHY


def _class_name(kind: str, targets: str, value: float | None, ramp_s: float | None) -> str:
    name = kind if targets == "0" else f"{kind} {targets}"
    size = "" if value is None else f" = {value:g}"
    return f"{name}{size}{f' in {ramp_s:g} s' if ramp_s else ''}"


def _cells(spec: Spec, scenario_data: ScenarioData) -> Iterator[Cell]:
    for row in spec.fault:
        for target in row.targets:
            named = "+".join(map(str, target)) if isinstance(target, tuple) else str(target)
            for value in row.values or (None,):
                for ramp_s in row.ramps_s or (None,):
                    yield Cell(_class_name(row.kind, named, value, ramp_s), row, target, value, ramp_s)
    if spec.pairs is not None:
        yield Cell(PAIRS)
    if spec.one_fault is not None:
        yield Cell(ONE_FAULT)
    if not spec.has_own_faults:
        yield Cell(fault_label(scenario_data.get("fault", ())))


def _case(spec: Spec, cell: Cell, scenario_data: ScenarioData, seed: int, digest: str, base: RigNumbers | None) -> Case:
    """A case: the scenario with the spec's tables merged in, faults and rig drawn by this seed, and its key."""
    scenario_data = with_overlay(spec, scenario_data)
    label, drawn = cell.label, {}
    random = Random(f"{seed}/{label}")  # noqa: S311 - a draw that anyone can repeat is what is wanted
    if cell.row is not None:
        scenario_data = {**scenario_data, "fault": _grid_faults(cell, random)}
    elif label == PAIRS and spec.pairs is not None:
        faults = _pool_faults(spec.pairs, 2, random)
        scenario_data = {**scenario_data, "fault": faults}
    elif label == ONE_FAULT and spec.one_fault is not None:
        faults = _pool_faults(spec.one_fault, 1, random)
        scenario_data, label = {**scenario_data, "fault": faults}, _class_of(faults)
    if spec.draw is not None and base is not None:
        rig = draw_rig(spec.draw, base, seed, float(scenario_data["scenario"]["duration_s"]))
        scenario_data, drawn = merged(scenario_data, dict(rig.overlay)), dict(rig.values)
    case = Case("", label, str(scenario_data.get("scenario", {}).get("name", "")), seed, scenario_data, drawn)
    return replace(case, key=case_key(scenario_data, seed, digest))


def _class_of(faults: Sequence[Fault]) -> str:
    """Kind and target of a drawn fault; its size is another one in every case."""
    return fault_label([{**fault, "value": None} for fault in faults])


def _grid_faults(cell: Cell, random: Random) -> list[Fault]:
    row = cell.row
    if row is None:
        return []
    targets = cell.target if isinstance(cell.target, tuple) else (cell.target,)
    at_s = round(random.uniform(*row.onset_s), ONSET_DIGITS)
    ramp = {} if cell.ramp_s is None else {"ramp_s": cell.ramp_s}
    return [{**_fault(row, target, cell.value, at_s, row.lasts_s), **ramp} for target in targets]


def _pool_faults(pool: Pairs | OneFault, count: int, random: Random) -> list[Fault]:
    """Different faults of the pool, by time."""
    faults = []
    for row in random.sample(pool.pool, count):
        target = random.choice(row.targets)
        value = None if row.value_range is None else float(f"{random.uniform(*row.value_range):.4g}")
        at_s = round(random.uniform(*pool.onset_s), ONSET_DIGITS)
        faults.append(_fault(row, target, value, at_s, pool.lasts_s))
    return sorted(faults, key=lambda fault: float(fault["at_s"]))


def _fault(row: FaultRow | PoolRow, target: Target, value: float | None, at_s: float, lasts_s: float | None) -> Fault:
    fault: Fault = {"at_s": at_s, "kind": row.kind}
    if target != 0:
        fault["target"] = target
    if value is not None:
        fault["value"] = value
    if lasts_s is not None:
        fault["until_s"] = round(at_s + lasts_s, ONSET_DIGITS)
    return {**fault, **row.also}


def case_key(scenario_data: ScenarioData, seed: int, digest: str) -> str:
    """Digest of all that a run's result depends on. digest : of everything but scenario and seed."""
    text = json.dumps([scenario_data, seed, digest], sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS]
