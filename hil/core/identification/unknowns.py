"""What a fit looks for: the vector of its unknowns, with start, limits, scale and prior of each.

The unknowns are the parameters that are free or have a prior, in the order of `PARAMETERS`, and behind them the initial
levels of each record that are not known, named "h1 of NAME".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isnan

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.parameters import (
    BASIC,
    BY_NAME,
    PARAMETERS,
    Choice,
    Parameter,
    RigModel,
    values_of,
    with_values,
)
from hil.core.identification.records import LevelRecord
from hil.core.identification.simulation import LEVELS, first_levels
from hil.core.types import Pair, Quad

Array = NDArray[np.float64]

FREE, FIXED = Choice("free"), Choice("fixed")

LIMITS: Mapping[str, Pair] = {
    "gamma": (1e-3, 1.0 - 1e-3),
    "lag": (0.01, 20.0),
    "dead_zone": (0.0, 5.0),
    "curve": (-0.045, 0.5),
    "delay": (0.0, 5.0),
    "datum": (0.0, 100.0),
    "sensor_gain": (-10.0, 10.0),
    "sensor_offset": (-20.0, 20.0),
    "overflow": (0.0, 1.0),
}
"""Limits of each group in its own unit: what a rig file can say. Gains and outlets: within `FACTOR` of the start."""

FACTOR = 20.0

SCALES: Mapping[str, float] = {
    "gamma": 0.5,
    "lag": 0.2,
    "dead_zone": 0.2,
    "curve": 0.01,
    "delay": 0.2,
    "datum": 2.0,
    "sensor_gain": 0.2,
    "sensor_offset": 0.2,
    "overflow": 0.3,
}
"""How far a parameter of a group may be expected to move; of gains and outlets their start."""


def resolved(choices: Mapping[str, Choice]) -> dict[str, Choice]:
    """One choice for every parameter. Keys are names of parameters or of groups; a parameter's own counts first.

    Without a choice the groups of `BASIC` are free and all others fixed. Raises ValueError for an unknown key or a
    prior without a positive sd.
    """
    groups = {row.group for row in PARAMETERS}
    for key, choice in choices.items():
        if key not in BY_NAME and key not in groups:
            raise ValueError(f"choice for {key!r}: no parameter and no group of that name")
        if choice.role == "prior" and not choice.sd > 0.0:
            raise ValueError(f"choice for {key!r}: a prior needs a positive sd, not {choice.sd:g}")
    default = {row.name: FREE if row.group in BASIC else FIXED for row in PARAMETERS}
    return {row.name: choices.get(row.name, choices.get(row.group, default[row.name])) for row in PARAMETERS}


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The unknowns of a fit; p of them.

    names : of all. parameters : those that are parameters of the rig. start, low, high, scale : (p,) values. prior_sd :
    (p,) inf where there is no prior. places : for each record the names of its simulation's derivatives and the columns
    to which they belong. initial_cm : for each record its initial levels; those that are unknown are the start.
    """

    names: tuple[str, ...]
    parameters: tuple[str, ...]
    start: Array
    low: Array
    high: Array
    scale: Array
    prior_sd: Array
    places: tuple[tuple[tuple[str, ...], tuple[int, ...]], ...]
    initial_cm: tuple[Quad, ...]

    def model(self, base: RigModel, values: Array) -> RigModel:
        """The rig with these values (p,) in place of its own."""
        count = len(self.parameters)
        return with_values(base, dict(zip(self.parameters, values[:count].tolist(), strict=True)))

    def initial(self, record: int, values: Array) -> Quad:
        """The initial levels of a record at these values (p,)."""
        level_cm = list(self.initial_cm[record])
        for name, column in zip(*self.places[record], strict=True):
            if name in LEVELS:
                level_cm[LEVELS.index(name)] = float(values[column])
        return level_cm[0], level_cm[1], level_cm[2], level_cm[3]


def unknowns(
    records: Sequence[LevelRecord],
    start: RigModel,
    choices: Mapping[str, Choice],
    limits: Mapping[str, Pair] | None = None,
) -> Unknowns:
    """The unknowns for these records. limits : in place of `LIMITS`, for groups or single parameters.

    A start beyond its limits is moved to the nearest one. Raises ValueError for two records of the same name, a record
    with a voltage that is no number, an unknown key, or a gain or outlet of 0, which has no limits.
    """
    _check(records)
    chosen = resolved(choices)
    rows = [row for row in PARAMETERS if chosen[row.name].role != "fixed"]
    own, values = {**LIMITS, **(limits or {})}, values_of(start)
    columns = [_column(row, values[row.name], own, chosen[row.name].sd) for row in rows]
    dynamic = tuple((row.name, at) for at, row in enumerate(rows) if not row.group.startswith("sensor"))
    places, initial = [], []
    for record in records:
        level_cm = first_levels(start, record)
        initial.append(level_cm)
        own_places = list(dynamic)
        for i, name in enumerate(LEVELS):
            if isnan(record.initial_cm[i]):
                own_places.append((name, len(columns)))
                columns.append((f"{name} of {record.name}", level_cm[i], (0.0, start.tanks.height_cm[i]), 2.0, inf))
        places.append((tuple(name for name, _ in own_places), tuple(at for _, at in own_places)))
    return Unknowns(
        names=tuple(column[0] for column in columns),
        parameters=tuple(row.name for row in rows),
        start=np.array([column[1] for column in columns]),
        low=np.array([column[2][0] for column in columns]),
        high=np.array([column[2][1] for column in columns]),
        scale=np.array([column[3] for column in columns]),
        prior_sd=np.array([column[4] for column in columns]),
        places=tuple(places),
        initial_cm=tuple(initial),
    )


def _check(records: Sequence[LevelRecord]) -> None:
    """Raise ValueError for records that can't be fitted together."""
    for record in records:
        missing = ~np.isfinite(record.voltage_V).all(axis=1)
        if missing.any():
            raise ValueError(f"record {record.name!r}: no voltage at {record.time_s[missing][0]:g} s")
    if len({record.name for record in records}) != len(records):
        raise ValueError(f"records {[record.name for record in records]}: each needs a name of its own")
    if not records:
        raise ValueError("no records to fit")


def _column(
    row: Parameter, value: float, limits: Mapping[str, Pair], sd: float
) -> tuple[str, float, Pair, float, float]:
    """Name, start, limits, scale and prior of a parameter."""
    ends = limits.get(row.name, limits.get(row.group, (value / FACTOR, value * FACTOR)))
    if not ends[0] < ends[1]:
        raise ValueError(f"{row.name} = {value:g} {row.unit}: a parameter that is not fixed must be above 0")
    value = min(max(value, ends[0]), ends[1])
    return row.name, value, ends, SCALES.get(row.group, abs(value)), sd or inf
