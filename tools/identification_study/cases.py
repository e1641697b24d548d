"""The cases of the study: a drawn rig, an experiment on it and a held-out one, and what is identified from them."""

from __future__ import annotations

import time
from dataclasses import dataclass

from firmware_sim.setting_types import parts
from hil.core.identification.identify import identify
from hil.core.identification.parameters import RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.result import Identification
from hil.core.tanks import TankModel
from tools.identification_study.truth import (
    Truth,
    basic_truth,
    experiment_plan,
    held_out_plan,
    rich_truth,
    rig_truth,
    ruler_plan,
    ruler_times,
    run_experiment,
)
from tools.identification_study.wire import wire_records

RIGS = ("johansson_minus", "johansson_plus", "decenter2021")
HELD_OUT_SEED = 100_000
STRUCTURES = {"basic": (), "rich": ("dead_zone", "curve", "datum", "sensor_gain", "sensor_offset")}


@dataclass(frozen=True)
class CaseSpec:
    """Which rig and which experiment. rig : of config/rigs, in place of a drawn one.

    is_wire : the plan of `hil identify`, over the wire.
    """

    kind: str
    seed: int
    turbulence: float = 0.0
    wave_V: float = 0.0
    rig: str = ""
    is_wire: bool = False

    @property
    def key(self) -> str:
        """How a stored outcome is found again."""
        return f"{self.kind} {self.rig} {self.seed} wire={self.is_wire} {self.turbulence:g} {self.wave_V:g}"

    @property
    def name(self) -> str:
        """In a table."""
        return self.rig or f"seed {self.seed}"

    @property
    def with_ruler(self) -> bool:
        """Whether levels are read by a ruler."""
        return bool(self.rig) or self.kind == "rich"

    @property
    def expected(self) -> tuple[str, ...] | None:
        """The right structure; None: not known."""
        return STRUCTURES.get(self.kind)

    def truth(self) -> Truth:
        """The rig."""
        if self.rig:
            return rig_truth(self.rig)
        if self.kind == "rich":
            return rich_truth(self.seed)
        return basic_truth(self.seed, turbulence=self.turbulence, wave_V=self.wave_V)


@dataclass(frozen=True)
class Case:
    """One rig and what was found."""

    spec: CaseSpec
    truth: Truth
    found: Identification
    duration_s: float


def run_case(spec: CaseSpec) -> Case:
    """Draw the rig, do the experiments, and identify it."""
    truth = spec.truth()
    records, held_out = records_of(spec, truth)
    began_s = time.monotonic()
    found = identify(records, file_of(truth), held_out=held_out)
    return Case(spec, truth, found, time.monotonic() - began_s)


def records_of(spec: CaseSpec, truth: Truth) -> tuple[list[LevelRecord], list[LevelRecord]]:
    """The records to fit, and those that are held out."""
    seed = spec.seed
    if spec.is_wire:
        return wire_records(truth, seed, is_full=spec.kind == "rich", with_ruler=spec.with_ruler)
    plan = [*experiment_plan(truth, seed), *(ruler_plan(truth) if spec.with_ruler else [])]
    records = [run_experiment(truth, plan, seed, ruler=ruler_times(plan) if spec.with_ruler else ())]
    return records, [run_experiment(truth, held_out_plan(truth, seed), seed + HELD_OUT_SEED, name="held out")]


def file_of(truth: Truth) -> RigModel:
    """The default file, with the cross-sections and heights of the rig's tanks: those anybody can measure."""
    tanks = truth.settings.tanks
    h1, h2, h3, h4 = parts(tanks.height_cm, 4)
    return RigModel(tanks=TankModel(area_cm2=tanks.area_cm2, height_cm=(h1, h2, h3, h4)))
