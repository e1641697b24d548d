"""What the records can't tell: directions of the parameters that move no prediction, named in words.

The whitened sensitivities, priors left out, are scaled by how far each parameter may plausibly be off. A singular value
is then by how many standard deviations the data see such a difference. Directions that the data know to less than
`KNOWN_SHARE` of that difference are null directions, and a parameter that the data know no better is not identifiable.
(Singular value decomposition of scaled sensitivities: Miao, Xia, Perelson and Wu, SIAM Review 53, 2011.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.parameters import BY_NAME
from hil.core.identification.records import LevelRecord
from hil.core.identification.result import NullDirection

Array = NDArray[np.float64]

KNOWN_SHARE = 0.3
"""Data that shrink the plausible range of a parameter to this share of it, or less, determine the parameter."""
MIN_SINGULAR = 1e-5
NAMED_WEIGHT = 0.05
MOVED_V = 0.3
"""A law that holds a level moves its pumps by less, by the noise of the sensors."""
MOVED_QUANTILES = (0.01, 0.99)

_RELATIVE = {"k": 0.2, "a": 0.2, "sensor_gain": 0.1}
_ABSOLUTE = {
    "gamma": 0.1,
    "lag": 0.2,
    "dead_zone": 0.5,
    "curve": 0.02,
    "delay": 0.3,
    "datum": 3.0,
    "sensor_offset": 0.1,
    "overflow": 0.3,
}
INITIAL_CM = 1.0


def plausible(name: str, value: float) -> float:
    """How far a parameter may be off its value, one standard deviation, before anything is measured."""
    if name not in BY_NAME:
        return INITIAL_CM
    group = BY_NAME[name].group
    if group in _RELATIVE:
        return _RELATIVE[group] * max(abs(value), 1e-9)
    return max(_ABSOLUTE[group], abs(value)) if group == "lag" else _ABSOLUTE[group]


@dataclass(frozen=True, eq=False)
class Identifiability:
    """undetermined : names of the parameters that the data do not determine. directions : (d, p) of all unknowns."""

    undetermined: tuple[str, ...]
    directions: Array
    names: tuple[str, ...]
    scale: Array


def identifiability(rows: Array, information: Array, names: Sequence[str], values: Sequence[float]) -> Identifiability:
    """Which parameters the data determine.

    rows : (m, p) whitened sensitivities. information : (p, p) of readings by a ruler. values : (p,) of the unknowns.
    """
    scale = np.array([plausible(name, value) for name, value in zip(names, values, strict=True)])
    squares, axes = np.linalg.eigh(information)
    ruler = (axes * np.sqrt(np.maximum(squares, 0.0))).T
    triangle = np.linalg.qr(np.concatenate([rows, ruler]) * scale, mode="r")
    _, singular, transposed = np.linalg.svd(triangle)
    vectors = transposed.T
    spread = np.sqrt(np.sum((vectors / np.maximum(singular, MIN_SINGULAR)) ** 2, axis=1))
    unknown = singular < 1.0 / KNOWN_SHARE
    undetermined = tuple(name for name, sd in zip(names, spread, strict=True) if sd > KNOWN_SHARE and name in BY_NAME)
    directions = _sparse(vectors[:, unknown].T)
    is_of_the_rig = [any(abs(d[i]) > NAMED_WEIGHT for i, n in enumerate(names) if n in BY_NAME) for d in directions]
    return Identifiability(undetermined, directions[np.array(is_of_the_rig, dtype=bool)], tuple(names), scale)


def _sparse(basis: Array) -> Array:
    """The same space (d, p) by directions that share as few parameters as possible, each with a largest weight of 1."""
    d = len(basis)
    if d == 0:
        return basis
    left = basis.copy()
    pivots: list[int] = []
    for row in range(d):
        sizes = np.linalg.norm(left[row:], axis=0)
        sizes[pivots] = -1.0
        pivot = int(np.argmax(sizes))
        pivots.append(pivot)
        best = row + int(np.argmax(np.abs(left[row:, pivot])))
        left[[row, best]] = left[[best, row]]
        left[row] /= left[row, pivot]
        for other in range(d):
            if other != row:
                left[other] -= left[other, pivot] * left[row]
    size = np.abs(left).max(axis=1, keepdims=True)
    result: Array = left / size
    return result


def described(
    found: Identifiability, records: Sequence[LevelRecord], levels_cm: Sequence[Array]
) -> tuple[NullDirection, ...]:
    """The null directions with their names and what would tell the parameters apart."""
    result = []
    for direction in found.directions:
        weights = {
            name: float(weight)
            for name, weight in zip(found.names, direction, strict=True)
            if abs(weight) > NAMED_WEIGHT and name in BY_NAME
        }
        names = tuple(weights)
        result.append(NullDirection(names, tuple(weights.values()), _text(names, records, levels_cm)))
    return tuple(result)


def listed(names: Sequence[str]) -> str:
    """Names in a sentence: "k1, k2 and a3"; four of a group together."""
    words: list[str] = []
    for group, text in (("sensor_gain", "sensor gains"), ("sensor_offset", "sensor offsets")):
        own = [name for name in names if name in BY_NAME and BY_NAME[name].group == group]
        if len(own) == 4:
            words.append(f"all four {text}")
            names = [name for name in names if name not in own]
    words = [*names, *words]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _text(names: Sequence[str], records: Sequence[LevelRecord], levels_cm: Sequence[Array]) -> str:
    groups = {BY_NAME[name].group for name in names}
    pumps = sorted({BY_NAME[name].index for name in names if BY_NAME[name].key.startswith("pumps.")})
    together = f"{listed(names)} {'is not determined' if len(names) == 1 else 'can only be known together'}"
    idle = [pump for pump in (0, 1) if not moves(records, pump)]
    if len(idle) == 2:
        return f"neither pump moved: {together}: a record is needed in which each pump steps between several voltages"
    if idle and pumps and set(pumps) <= set(idle) | set(pumps) and idle[0] in pumps:
        return f"pump {idle[0] + 1} never moved: {together}: a record is needed in which it moves"
    blind = [f"tank {tank + 1}" for tank in range(4) if not any(_has_readings(record, tank) for record in records)]
    if blind:
        return f"{listed(blind)} without readings: {together}: a record is needed with readings of all tanks"
    if "sensor_gain" in groups:
        sides = sorted({BY_NAME[name].index % 2 for name in names if BY_NAME[name].group == "sensor_gain"})
        where = "one tank on each side" if len(sides) == 2 else f"tank {sides[0] + 1} or {sides[0] + 3}"
        return f"{together}: read the level of {where} by a ruler"
    dry = [
        tank
        for tank in range(4)
        if any(BY_NAME[name].index == tank and BY_NAME[name].group in ("a", "datum") for name in names)
        and max(float(np.max(level[:, tank])) for level in levels_cm) < 0.5
    ]
    if dry:
        return f"tank {dry[0] + 1} held no water: {together}: a record is needed in which it fills and drains"
    if "overflow" in groups:
        return f"{together}: a record is needed in which that tank overflows"
    if groups & {"datum"}:
        return f"{together}: a record is needed in which these tanks drain from high levels until they are empty"
    if groups & {"dead_zone", "curve"}:
        return f"{together}: a record is needed with more different voltages, small and large ones"
    if groups & {"lag", "delay"}:
        return f"{together}: a record is needed with more steps of the voltage"
    return f"{together}: a longer record is needed, with larger movements of both pumps"


def _has_readings(record: LevelRecord, tank: int) -> bool:
    return bool(np.isfinite(record.reading_V[:, tank]).any())


def moves(records: Sequence[LevelRecord], pump: int) -> bool:
    """Whether the voltage of a pump (0, 1) changes by more than `MOVED_V` within any record.

    The first and the last moments do not count: a run begins and ends at 0 V.
    """
    ends = [np.quantile(record.voltage_V[:, pump], MOVED_QUANTILES) for record in records]
    return any(float(high - low) > MOVED_V for low, high in ends)
