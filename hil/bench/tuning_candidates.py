"""Options of a law to try: for the state feedback its poles, for any other law the numbers among its options.

The state feedback's candidates scale the rig file's output poles; `control.noise_gain_max` of each is what its gains
need, so that no pole is slowed. Any other law's candidates are spread evenly in the logarithm over the ranges of its
options (a Halton sequence, which fills any number of dimensions). The range of an option is what its field declares:

    gain: Annotated[float, Field(gt=0.0, le=100.0, json_schema_extra={"tune": [1.0, 20.0]})] = 5.0

and without `tune` a quarter to four times the value in force, within the field's limits. A list is scaled as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo

from hil.bench.designs import DESIGNS
from hil.bench.law_choices import LAWS, STATE_FEEDBACK, options_model
from hil.bench.law_setup import LawOptions
from hil.campaigns.tuning_choice import Candidate
from hil.core.eigenstructure import DesignError
from hil.core.gain_design import gain_matrix, noise_gain
from hil.core.tanks import equilibrium, linearise
from hil.edge.config.rig_file import Rig
from hil.edge.config.settings_file import SettingsError, validated

SPEEDS = (0.5, 3.0)
"""Slowest and fastest output poles, relative to the rig file's."""

RANGE = 4.0
DIGITS = 3
PRIMES = (2, 3, 5, 7, 11, 13, 17, 19)
BOUNDLESS = 1e6


def candidates(rig: Rig, law: str, options: Mapping[str, Any], count: int, where: str) -> tuple[Candidate, ...]:
    """The present options, and `count` others. options : in force. Raises SettingsError."""
    if law == STATE_FEEDBACK:
        return _of_state_feedback(rig, count, where)
    return _of_options(rig, law, options, count, where)


def _of_state_feedback(rig: Rig, count: int, where: str) -> tuple[Candidate, ...]:
    control = rig.control
    now = {"control.output_poles": list(control.output_poles), "control.noise_gain_max": control.noise_gain_max}
    found = [Candidate("present", now, rig=_tables(now), is_present=True)]
    slow, fast = map(math.log, SPEEDS)
    for place in range(count):
        factor = _rounded(math.exp(slow + (fast - slow) * place / max(count - 1, 1)))
        poles = [_rounded(factor * pole) for pole in control.output_poles]
        try:
            needed = _rounded(1.01 * _noise_gain(rig, poles))
        except DesignError:
            continue  # an eigenvalue of the rig itself, or no stable design with these poles
        values = {"control.output_poles": poles, "control.noise_gain_max": needed}
        if values != now:
            found.append(Candidate(f"poles x {factor:g}", values, rig=_tables(values)))
    if len(found) < 2:
        raise SettingsError(f"{where}: control.output_poles: no design with other poles can be had on this rig")
    return tuple(found)


def _noise_gain(rig: Rig, poles: list[float]) -> float:
    """What the design with these poles needs. Raises DesignError."""
    free = rig.model_copy(
        update={"control": rig.control.model_copy(update={"output_poles": tuple(poles), "noise_gain_max": BOUNDLESS})}
    )
    linear = linearise(rig.tank_model, equilibrium(rig.tank_model, rig.operating_drives))
    K = gain_matrix(DESIGNS.find("rig", "").make(free).gains(linear))
    return noise_gain(K, rig.tank_model.level_gain_V_cm)


def _of_options(rig: Rig, law: str, options: Mapping[str, Any], count: int, where: str) -> tuple[Candidate, ...]:
    model = options_model(LAWS.find(law, where), where)
    present = {} if model is None else _present(rig, model, options, where)
    factors = {} if model is None else _factors(model, present, where)
    if not factors:
        raise SettingsError(f"{where}: control.law = {law!r}: has no number among its options that could be tuned")
    found = [Candidate("present", dict(options), control={"law": law, "options": dict(options)}, is_present=True)]
    for number in range(1, count + 1):
        values = {
            name: _times(present[name], low * (high / low) ** _halton(number, PRIMES[place % len(PRIMES)]))
            for place, (name, (low, high)) in enumerate(factors.items())
        }
        tried = {**options, **values}
        label = ", ".join(f"{name} {_text(value)}" for name, value in values.items())
        found.append(Candidate(f"{number}: {label}", tried, control={"law": law, "options": tried}))
    return tuple(found)


def _present(rig: Rig, model: type[LawOptions], options: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The options in force; a law may have other values for other rigs, which its options' `values` says."""
    checked = validated(model, dict(options), where)
    values = getattr(checked, "values", None)
    return dict(values(rig.tank_model)) if callable(values) else checked.model_dump()


def _factors(model: type[LawOptions], present: Mapping[str, Any], where: str) -> dict[str, tuple[float, float]]:
    """Least and largest factor of each option that is a number, or a list of numbers."""
    factors = {}
    for name, field in model.model_fields.items():
        parts = _numbers(present.get(name))
        if not parts:
            continue
        extra = field.json_schema_extra
        declared: Any = extra.get("tune") if isinstance(extra, dict) else None
        size = max(parts)
        low, high = (declared[0] / size, declared[1] / size) if declared else (1.0 / RANGE, RANGE)
        least, most = _limits(field)
        low, high = max(low, least / min(parts)), min(high, most / size)
        if not 0.0 < low < high:
            raise SettingsError(f"{where}: control.options.{name}: no other value is allowed by its range")
        factors[name] = (low, high)
    return factors


def _numbers(value: Any) -> list[float]:
    """Sizes of the numbers of an option; none if it is something else, or 0."""
    parts = list(value) if isinstance(value, list | tuple) else [value]
    is_all = all(isinstance(one, float) and one != 0.0 for one in parts)
    return [abs(one) for one in parts] if is_all else []


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, list | tuple):
        return [_rounded(factor * one) for one in value]
    return _rounded(factor * value)


def _text(value: Any) -> str:
    return "/".join(f"{one:g}" for one in value) if isinstance(value, list) else f"{value:g}"


def _limits(field: FieldInfo) -> tuple[float, float]:
    """Of a number that is not negative."""
    low, high = 0.0, math.inf
    for limit in field.metadata:
        if isinstance(limit, Ge | Gt):
            low = max(low, float(str(limit.ge if isinstance(limit, Ge) else limit.gt)))
        if isinstance(limit, Le | Lt):
            high = min(high, float(str(limit.le if isinstance(limit, Le) else limit.lt)))
    return low, high


def _halton(number: int, base: int) -> float:
    """The number-th member of the van der Corput sequence, between 0 and 1."""
    value, share = 0.0, 1.0
    while number:
        share /= base
        number, digit = divmod(number, base)
        value += share * digit
    return value


def _tables(values: Mapping[str, Any]) -> dict[str, Any]:
    return {"control": {key.partition(".")[2]: value for key, value in values.items()}}


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
