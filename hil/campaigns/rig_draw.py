"""Rigs drawn for a campaign: the same seed gives the same rig, whatever fault is played on it.

Each quantity has a random stream of its own, so that a key more in [draw] does not change what the others draw.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

from hil.campaigns.draw_spec import RATIOS, Draw, DrawnReferences
from hil.core.types import Pair, Quad
from hil.edge.config.settings_file import SettingsError

DIGITS = 4
"""Significant digits of a drawn value."""

MAX_TRIES = 1000
HOLDING_SHARES = (0.05, 0.9)
"""Least and largest share of the pumps' largest voltage that may hold a drawn reference."""

FILL_MAX = 0.9
"""Largest level of an upper tank at a drawn reference, as a share of its height."""

FLOW_SHARES = (0.2, 1.0)
"""Share of the pumps' largest voltage between which `flow_ratio` is given."""


@dataclass(frozen=True)
class RigNumbers:
    """The rig that the draws start from. Tanks 1, 2 (lower), 3, 4 (upper); pumps 1, 2.

    start_V : of the emulator. operating_point_V, range_V : of the rig file.
    """

    gain_cm3_Vs: Pair
    dead_zone_V: Pair
    curve_1_V: Pair
    lag_s: Pair
    valve_split: Pair
    outlet_cm2: Quad
    datum_cm: Quad
    height_cm: Quad
    gravity_cm_s2: float
    level_gain_V_cm: Quad
    start_V: Pair
    operating_point_V: Pair
    range_V: Pair

    def flow_cm3_s(self, pump: int, voltage_V: float) -> float:
        """Flow of a pump (0 or 1) in the steady state: gain x (1 + curve x), x = max(0, voltage - dead zone)."""
        x = max(0.0, voltage_V - self.dead_zone_V[pump])
        return self.gain_cm3_Vs[pump] * x * (1.0 + self.curve_1_V[pump] * x)

    def voltage_V(self, pump: int, flow_cm3_s: float) -> float:  # noqa: N802 - a unit
        """The voltage that gives a flow; 0 V for none, inf where the pump's curve never reaches it."""
        if flow_cm3_s <= 0.0:
            return 0.0
        flow_V, curve = flow_cm3_s / self.gain_cm3_Vs[pump], self.curve_1_V[pump]
        inner = 1.0 + 4.0 * curve * flow_V
        return math.inf if inner < 0.0 else self.dead_zone_V[pump] + 2.0 * flow_V / (1.0 + math.sqrt(inner))

    def outflow_cm3_s(self, tank: int, level_cm: float) -> float:
        """Outflow of a tank (0 to 3)."""
        head_cm = level_cm + self.datum_cm[tank]
        return self.outlet_cm2[tank] * math.sqrt(2.0 * self.gravity_cm_s2 * head_cm)

    def holding_flows_cm3_s(self, lower_cm: Pair) -> Pair:
        """Flows of the pumps that hold the lower levels; negative or inf where no flow does."""
        out1, out2 = self.outflow_cm3_s(0, lower_cm[0]), self.outflow_cm3_s(1, lower_cm[1])
        g1, g2 = self.valve_split
        excess = g1 + g2 - 1.0
        if excess == 0.0:
            return math.inf, math.inf
        return (g2 * out1 - (1.0 - g2) * out2) / excess, (g1 * out2 - (1.0 - g1) * out1) / excess

    def holds(self, lower_cm: Pair) -> bool:
        """Whether the rig can hold these levels well within the pumps' range and with upper tanks that are not full."""
        flows = self.holding_flows_cm3_s(lower_cm)
        low_V, high_V = (share * self.range_V[1] for share in HOLDING_SHARES)
        if not all(flow > 0.0 and low_V <= self.voltage_V(pump, flow) <= high_V for pump, flow in enumerate(flows)):
            return False
        g1, g2 = self.valve_split
        upper = ((2, (1.0 - g2) * flows[1]), (3, (1.0 - g1) * flows[0]))
        return all(flow <= self.outflow_cm3_s(tank, FILL_MAX * self.height_cm[tank]) for tank, flow in upper)


@dataclass(frozen=True)
class DrawnRig:
    """A drawn rig. values : what was drawn, for the table of outcomes. overlay : what is merged into the scenario."""

    values: Mapping[str, Any]
    overlay: Mapping[str, Any]


def draw_rig(spec: Draw, base: RigNumbers, seed: int, duration_s: float) -> DrawnRig:
    """The rig of a seed. Raises SettingsError where the drawn rig can't be started or can't hold any reference."""
    values = _values(spec, seed)
    rig = _applied(base, values)
    emulator: dict[str, Any] = {"pumps": _pumps(rig, values), "tanks": {}, "sensors": {}}
    known: dict[str, Any] = {"pumps": dict(emulator["pumps"]), "tanks": {}, "sensors": {}, "control": {}}
    if "outlet_ratio" in values:
        emulator["tanks"]["outlet_cm2"] = known["tanks"]["outlet_cm2"] = _rounded(rig.outlet_cm2)
    if "scale_error" in values:
        emulator["sensors"]["scale_error"] = list(values["scale_error"])
        known["sensors"]["gain_V_cm"] = _rounded(
            [k * (1.0 + e) for k, e in zip(base.level_gain_V_cm, values["scale_error"], strict=True)]
        )
    start_V = values.get("start_V", base.start_V)
    emulator["tanks"]["start_V"] = _same_flow_V(base, rig, start_V, seed)
    if spec.rig_knows:
        known["control"]["operating_point_V"] = _same_flow_V(base, rig, base.operating_point_V, seed)
    else:
        known = {"control": {}}
    if "period_s" in values:
        known["control"]["period_s"] = values["period_s"]
    overlay: dict[str, Any] = {"emulator": emulator, "rig": known}
    if spec.references is not None:
        overlay["reference"] = _references(spec.references, rig, seed, duration_s)
        values["references"] = [[step["at_s"], *step["levels_cm"]] for step in overlay["reference"]]
    if not spec.rig_knows:
        values["flow_ratio"] = [_flow_ratio(base, rig, pump) for pump in (0, 1)]
        values["lag_s"] = _rounded(rig.lag_s)
    return DrawnRig(values, _without_empty(overlay))


def _values(spec: Draw, seed: int) -> dict[str, Any]:
    """One draw for each pump, tank or sensor, and one of each list of choices."""
    values: dict[str, Any] = {}
    for name, parts in (("gain_ratio", 2), ("curve_1_V", 2), ("dead_zone_V", 2), ("lag_ratio", 2)):
        values |= _spans(spec, name, parts, seed)
    for name in ("outlet_ratio", "scale_error"):
        values |= _spans(spec, name, 4, seed)
    for name in ("period_s", "start_V"):
        choices: Sequence[Any] = getattr(spec, name)
        if choices:
            values[name] = _stream(seed, name).choice(choices)
    return values


def _spans(spec: Draw, name: str, parts: int, seed: int) -> dict[str, list[float]]:
    span: Pair | None = getattr(spec, name)
    if span is None:
        return {}
    random = _stream(seed, name)
    if name in RATIOS:
        low, high = math.log(span[0]), math.log(span[1])
        return {name: _rounded([math.exp(random.uniform(low, high)) for _ in range(parts)])}
    return {name: _rounded([random.uniform(*span) for _ in range(parts)])}


def _applied(base: RigNumbers, values: Mapping[str, Any]) -> RigNumbers:
    """The rig with the drawn values."""
    ones = (1.0,) * 4
    gain, lag = values.get("gain_ratio", ones[:2]), values.get("lag_ratio", ones[:2])
    outlet = values.get("outlet_ratio", ones)
    o1, o2, o3, o4 = (area * ratio for area, ratio in zip(base.outlet_cm2, outlet, strict=True))
    d1, d2 = values.get("dead_zone_V", base.dead_zone_V)
    c1, c2 = values.get("curve_1_V", base.curve_1_V)
    return RigNumbers(
        gain_cm3_Vs=(base.gain_cm3_Vs[0] * gain[0], base.gain_cm3_Vs[1] * gain[1]),
        dead_zone_V=(d1, d2),
        curve_1_V=(c1, c2),
        lag_s=(base.lag_s[0] * lag[0], base.lag_s[1] * lag[1]),
        valve_split=base.valve_split,
        outlet_cm2=(o1, o2, o3, o4),
        datum_cm=base.datum_cm,
        height_cm=base.height_cm,
        gravity_cm_s2=base.gravity_cm_s2,
        level_gain_V_cm=base.level_gain_V_cm,
        start_V=base.start_V,
        operating_point_V=base.operating_point_V,
        range_V=base.range_V,
    )


def _pumps(rig: RigNumbers, values: Mapping[str, Any]) -> dict[str, Any]:
    keys = {
        "gain_ratio": ("gain_cm3_Vs", rig.gain_cm3_Vs),
        "curve_1_V": ("curve_1_V", rig.curve_1_V),
        "dead_zone_V": ("dead_zone_V", rig.dead_zone_V),
        "lag_ratio": ("lag_s", rig.lag_s),
    }
    return {key: _rounded(value) for name, (key, value) in keys.items() if name in values}


def _same_flow_V(base: RigNumbers, rig: RigNumbers, voltages_V: Pair, seed: int) -> list[float]:  # noqa: N802 - a unit
    """Voltages at which the drawn pumps give the flow of the undrawn ones. Raises SettingsError if there are none."""
    found = [rig.voltage_V(pump, base.flow_cm3_s(pump, voltage_V)) for pump, voltage_V in enumerate(voltages_V)]
    if max(found) > rig.range_V[1]:
        raise SettingsError(
            f"draw: seed {seed}: the drawn pumps can't give the flow of {list(voltages_V)} V within "
            f"{rig.range_V[1]:g} V; lower start_V or narrow gain_ratio, curve_1_V and dead_zone_V"
        )
    return _rounded(found)


def _references(spec: DrawnReferences, rig: RigNumbers, seed: int, duration_s: float) -> list[dict[str, Any]]:
    random = _stream(seed, "references")
    steps: list[dict[str, Any]] = []
    at_s = random.uniform(*spec.every_s)
    while at_s < duration_s:
        steps.append({"at_s": round(at_s, 3), "levels_cm": _levels_cm(spec, rig, random, seed)})
        at_s += random.uniform(*spec.every_s)
    return steps


def _levels_cm(spec: DrawnReferences, rig: RigNumbers, random: Random, seed: int) -> list[float]:
    for _ in range(MAX_TRIES):
        first, second = _rounded([random.uniform(*spec.levels_cm) for _ in range(2)])
        if rig.holds((first, second)):
            return [first, second]
    raise SettingsError(
        f"draw.references.levels_cm = {list(spec.levels_cm)}: the rig of seed {seed} can hold none of them; "
        "give levels that its pumps can hold within 5 to 90 % of their range"
    )


def _flow_ratio(base: RigNumbers, rig: RigNumbers, pump: int) -> list[float]:
    """Least and largest flow of a drawn pump, divided by the undrawn one's, between `FLOW_SHARES` of its range."""
    low_V, high_V = (share * rig.range_V[1] for share in FLOW_SHARES)
    steps = [low_V + (high_V - low_V) * step / 40 for step in range(41)]
    ratios = [rig.flow_cm3_s(pump, v) / flow for v in steps if (flow := base.flow_cm3_s(pump, v)) > 0.0]
    return _rounded([min(ratios, default=1.0), max(ratios, default=1.0)])


def _stream(seed: int, name: str) -> Random:
    return Random(f"rig/{seed}/{name}")  # noqa: S311 - a draw that anyone can repeat is what is wanted


def _rounded(values: Sequence[float]) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values]


def _without_empty(overlay: Mapping[str, Any]) -> dict[str, Any]:
    """Without tables that say nothing."""
    kept = {name: _without_empty(one) if isinstance(one, Mapping) else one for name, one in overlay.items()}
    return {name: one for name, one in kept.items() if one != {}}
