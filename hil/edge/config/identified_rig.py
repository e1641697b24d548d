"""From an identification to a rig file: which values, with how many digits, and what else must follow them.

Operating voltages and the level at which a run trips follow only where the rig could not be run otherwise; each such
change is said in a note.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, floor, isfinite, log10

import numpy as np

from hil.core.identification.parameters import PARAMETERS, RigModel
from hil.core.identification.result import FittedParameter, Identification
from hil.core.tanks import equilibrium, holding_voltages
from hil.core.types import Pair
from hil.edge.config.rig_file import Rig
from hil.edge.config.rig_file_writer import Value, rig_text_with
from hil.edge.config.settings_file import SettingsError, of_all, validated

UNCERTAINTY = {"k": "pump_gain", "gamma": "valve_split", "a": "outlet", "lag": "lag"}
"""Group of parameters -> its key of [uncertainty]."""

FLOORS = {"pump_gain": 0.01, "valve_split": 0.01, "outlet": 0.01, "lag": 0.1}
"""Smallest share in [uncertainty]: docs/decisions/0032-identified-rig-file.md."""

MAX_LAG_SHARE = 5.0
EXACT_DIGITS = 6
NOISE_CHANGE = 0.1
"""The noise in the file is replaced if it is off by this share."""

FULL_SHARE = 0.9
"""Of safety.level_max_cm: the operating voltages are kept if they hold no level above this, or above the old one."""

SHRINK, MAX_SHRINKS = 0.95, 40
"""Where no voltages hold the old lower levels: the next lower ones that are tried, and how often."""

ROUNDING = 1.01
"""Voltages to 0.01 V hold levels that may be higher by this."""


@dataclass(frozen=True)
class IdentifiedRig:
    """The rig file's text. notes : what was changed beyond the identified values, or can't be said in the file.

    trouble : why no run can use the file; "" if it loads. rig : the settings then.
    """

    text: str
    old_text: str
    notes: tuple[str, ...]
    trouble: str
    rig: Rig | None

    def diff(self, old_name: str = "old", new_name: str = "identified.toml") -> str:
        """The unified difference to the old file; "" if there is none."""
        old, new = self.old_text.splitlines(), self.text.splitlines()
        return "\n".join(difflib.unified_diff(old, new, old_name, new_name, lineterm="", n=1))


def identified_rig(identification: Identification, old_text: str, where: str = "identified.toml") -> IdentifiedRig:
    """The rig file for an identification that started from a rig file with this text.

    Raises SettingsError when the old text is no rig file.
    """
    old = validated(Rig, tomllib.loads(old_text), "the old rig file")
    parameters = {parameter.name: parameter for parameter in identification.parameters}
    values = {**_values(parameters, old), **_noise(identification, old), **_uncertainty(parameters, old)}
    limit_cm, limit_notes = _trip_level(identification.model, old)
    voltage_V, voltage_notes = _operating_point(identification.model, old, limit_cm)
    values["safety.level_max_cm"], values["control.operating_point_V"] = limit_cm, voltage_V
    notes = [*_unsaid(parameters), *limit_notes, *voltage_notes]
    text = rig_text_with(old_text, values)
    try:
        rig, trouble = validated(Rig, tomllib.loads(text), where), ""
    except SettingsError as error:
        return IdentifiedRig(text, old_text, tuple(notes), str(error), None)
    before, after = old.level_sensors.signal_gain, rig.level_sensors.signal_gain
    if before != after:
        notes.append(
            f"The level signals, in which scenarios give references in V, have {after:g} V/cm now and had "
            f"{before:g} V/cm, because the sensors' gains differ."
        )
    return IdentifiedRig(text, old_text, tuple(notes), trouble, rig)


def rounded(parameter: FittedParameter) -> float:
    """The value with as many digits as its interval justifies: one unit of the last is at most half a sd."""
    value, sd = parameter.value, parameter.sd
    if value == parameter.was or value == 0.0:
        return value
    if sd > 0.0 and isfinite(sd):
        places = -floor(log10(0.5 * sd))
        most = EXACT_DIGITS - 1 - floor(log10(abs(value)))
        return round(value, min(places, most)) or value
    return significant(value, EXACT_DIGITS)


def significant(value: float, digits: int) -> float:
    """The value with so many significant digits."""
    return float(f"{value:.{digits}g}")


def _values(parameters: Mapping[str, FittedParameter], old: Rig) -> dict[str, Value]:
    """Every key of which a parameter has changed, with one value for each pump, tank or sensor."""
    values: dict[str, Value] = {}
    groups: dict[str, list[str]] = {}
    for row in PARAMETERS:
        if row.key:
            groups.setdefault(row.key, []).append(row.name)
    for key, names in groups.items():
        found = [parameters.get(name) for name in names]
        if any(one is not None and one.value != one.was for one in found):
            section, _, name = key.partition(".")
            before = getattr(getattr(old, section), name)
            befores = before if isinstance(before, tuple) else (before,) * len(names)
            values[key] = [
                float(was) if one is None or one.value == one.was else rounded(one)
                for one, was in zip(found, befores, strict=True)
            ]
    return values


def _noise(identification: Identification, old: Rig) -> dict[str, Value]:
    before, after = of_all(old.sensors.noise_V), identification.model.noise_V
    if not all(isfinite(noise_V) and noise_V > 0.0 for noise_V in after):
        return {}
    if all(abs(new - was) <= NOISE_CHANGE * was for new, was in zip(after, before, strict=True)):
        return {}
    return {"sensors.noise_V": [significant(noise_V, 2) for noise_V in after]}


def _uncertainty(parameters: Mapping[str, FittedParameter], old: Rig) -> dict[str, Value]:
    """One standard deviation as a share of the value, at least the floor; what was not identified keeps the old one."""
    values: dict[str, Value] = {}
    for group, key in UNCERTAINTY.items():
        rows = [row for row in PARAMETERS if row.group == group]
        shares = list(getattr(old.uncertainty.of_each, key))
        for row in rows:
            found = parameters.get(row.name)
            if found is not None and found.status == "identified" and found.value != 0.0:
                shares[row.index] = _share(
                    found.sd / abs(found.value), FLOORS[key], MAX_LAG_SHARE if key == "lag" else 1.0
                )
        values[f"uncertainty.{key}"] = shares
    return values


def _share(share: float, least: float, most: float) -> float:
    """Two significant digits, rounded up."""
    if not isfinite(share) or share >= most:
        return most
    if share <= least:
        return least
    unit = 10.0 ** (floor(log10(share)) - 1)
    return float(f"{ceil(share / unit - 1e-9) * unit:.2g}")


def _unsaid(parameters: Mapping[str, FittedParameter]) -> list[str]:
    found = [parameters[row.name] for row in PARAMETERS if not row.key and row.name in parameters]
    said = [f"{one.name} = {one.value:.3g}" for one in found if one.status == "identified"]
    return [f"A rig file can't say {', '.join(said)}; the file leaves it out."] if said else []


def _trip_level(model: RigModel, old: Rig) -> tuple[float, list[str]]:
    """safety.level_max_cm, lower than before if a sensor could not show the old one within its range; and why."""
    limit_cm, (low_V, high_V) = old.safety.level_max_cm, old.sensors.range_V
    ends_cm = [
        ((high_V if gain > 0.0 else low_V) - offset_V) / gain
        for gain, offset_V in zip(model.sensors.gain_V_cm, model.sensors.offset_V, strict=True)
    ]
    if min(ends_cm) >= limit_cm:
        return limit_cm, []
    shown_cm = floor(10.0 * min(ends_cm)) / 10.0
    return shown_cm, [
        f"Sensor {int(np.argmin(ends_cm)) + 1} can't show a level above {min(ends_cm):.2f} cm within its range. A run "
        f"now trips at {shown_cm:g} cm; it did at {limit_cm:g} cm."
    ]


def _operating_point(model: RigModel, old: Rig, limit_cm: float) -> tuple[Pair, list[str]]:
    """The operating voltages, others than before if those would fill a tank too far or leave one empty; and why."""
    voltage_V = old.control.operating_point_V
    before_cm = equilibrium(old.tank_model, old.operating_drives)
    after_cm = equilibrium(model.tanks, model.pumps.drive(voltage_V))
    highest_cm = min(max(FULL_SHARE * limit_cm, max(before_cm)), limit_cm)
    if min(after_cm) > 0.0 and max(after_cm) <= highest_cm:
        return voltage_V, []
    shown = ", ".join(f"{level_cm:.1f}" for level_cm in after_cm)
    why = f"The old operating voltages {voltage_V[0]:g}, {voltage_V[1]:g} V would hold {shown} cm in this rig"
    lower_cm: Pair = before_cm[:2]
    for _ in range(MAX_SHRINKS):
        found = _voltages(model, lower_cm, highest_cm)
        if found is not None:
            kept = "the old levels" if lower_cm == before_cm[:2] else "lower levels than before"
            return found, [
                f"{why}. The new ones, {found[0]:g}, {found[1]:g} V, hold {kept} of tanks 1 and 2: "
                f"{lower_cm[0]:.1f}, {lower_cm[1]:.1f} cm."
            ]
        lower_cm = (SHRINK * lower_cm[0], SHRINK * lower_cm[1])
    return voltage_V, [f"{why}, and no voltages were found that hold the levels of before, or lower ones."]


def _voltages(model: RigModel, lower_cm: Pair, highest_cm: float) -> Pair | None:
    """Voltages to 0.01 V that hold these lower levels within the range; None if there are none."""
    try:
        drives = holding_voltages(model.tanks, lower_cm)
    except ValueError:
        return None
    first_V, second_V = model.pumps.voltage(drives)
    found = (round(first_V, 2), round(second_V, 2))
    low_V, high_V = model.pumps.range_V
    if min(drives) <= 0.0 or min(found) < low_V or max(found) > high_V:
        return None
    levels_cm = equilibrium(model.tanks, model.pumps.drive(found))
    return found if min(levels_cm) > 0.0 and max(levels_cm) <= ROUNDING * highest_cm else None
