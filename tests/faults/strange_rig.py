"""Rigs on which something happens that no hypothesis of the diagnosis describes, for the tests of `unknown`.

The emulator with a function that acts on its tanks, pumps or readings at every level frame (20 ms). Times are those of
the scenario.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import exp, pi, sin, sqrt
from typing import Any

import numpy as np

from firmware_sim.rig import Rig as Emulator
from tests.faults.faults_bench import Keeper, Run, _built, contract, play

STEP_S = 0.02
GRAVITY_CM_S2 = 981.0

Strange = Callable[["StrangeRig", float], None]


class StrangeRig(Emulator):
    """The emulator; `strange(rig, t_s)` is called before each level frame, t_s since the scenario's start."""

    def __init__(self, strange: Strange, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.strange = strange
        self.random = np.random.default_rng(arguments[2])
        self.read: Callable[[list[float]], list[float]] | None = None
        self.kept: dict[str, float] = {}
        given = self.level.levels

        def levels(levels_cm: Any, now_ns: int = 0) -> Any:
            shown = levels_cm if self.read is None else self.read(list(levels_cm))
            return given(tuple(shown), now_ns)

        self.level.levels = levels  # type: ignore[method-assign]

    def _send_levels(self, now_ns: int) -> None:
        if self._start_ns is not None:
            self._advance_tanks(now_ns)
            self.strange(self, (now_ns - self._start_ns) * 1e-9)
        super()._send_levels(now_ns)

    def pour(self, *volumes_cm3: float) -> None:
        """Add these volumes to the four tanks, cm3."""
        self._tanks.stir(list(volumes_cm3))

    def block(self, tank: int, share: float) -> None:
        """Shut a share of a tank's outlet."""
        blocked = list(self._tanks._effects.blocked)
        blocked[tank - 1] = share
        self._tanks.apply_effects(replace(self._tanks._effects, blocked=blocked))

    def split(self, first: float, second: float) -> None:
        """Let the valves have these splits."""
        self._tanks.set_valve_split((first, second))

    def give(self, first: float, second: float) -> None:
        """Let the pumps give these shares of their flows."""
        self._paths.effectiveness = [first, second]

    def outflow(self, tank: int) -> float:
        """What the outlet of a tank lets out, cm3/s."""
        area = self.parameters.tanks.outlet_cm2[tank - 1]
        return float(area * sqrt(2.0 * GRAVITY_CM_S2 * max(self.levels_cm[tank - 1], 0.0)))


def oscillating_pump(at_s: float = 20.0, period_s: float = 8.0, share: float = 0.3) -> Strange:
    """The gain of pump 1 oscillates."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= at_s:
            rig.give(1.0 - share + share * sin(2.0 * pi * (t_s - at_s) / period_s), 1.0)

    return act


def hose_in_other_tank(at_s: float = 20.0) -> Strange:
    """The hose of pump 2 to tank 3 falls out and hangs in tank 4: its water goes there."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= at_s:
            pumps = rig.parameters.pumps
            moved = (1.0 - pumps.valve_split[1]) * pumps.gain_cm3_Vs[1] * rig._tanks.flow_V[1] * STEP_S
            taken = min(moved, rig.levels_cm[2] * rig.parameters.tanks.area_cm2[2])
            rig.pour(0.0, 0.0, -taken, moved)

    return act


def drain_in_other_tank(at_s: float = 20.0) -> Strange:
    """What tank 3 lets out falls into tank 2 and no longer into tank 1."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= at_s:
            moved = rig.outflow(3) * STEP_S
            rig.pour(-moved, moved, 0.0, 0.0)

    return act


def stone_in_outlet(tank: int = 1, at_s: float = 20.0) -> Strange:
    """A stone blocks 60 % of an outlet and frees it again, at random, every second or five."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= max(at_s, rig.kept.get("next", 0.0)):
            rig.kept["next"] = t_s + rig.random.uniform(1.0, 5.0)
            rig.kept["shut"] = 0.6 - rig.kept.get("shut", 0.0)
            rig.block(tank, rig.kept["shut"])

    return act


def bent_sensor(sensor: int = 1, at_s: float = 20.0) -> Strange:
    """A sensor becomes nonlinear, and that changes: it reads h + c ((h - 10)^2 / 10 + 2), c within 0.3, in 15 s."""

    def act(rig: StrangeRig, t_s: float) -> None:
        bend = 0.3 * sin(2.0 * pi * (t_s - at_s) / 15.0) if t_s >= at_s else 0.0

        def read(levels: list[float]) -> list[float]:
            levels[sensor - 1] += bend * ((levels[sensor - 1] - 10.0) ** 2 / 10.0 + 2.0)
            return levels

        rig.read = read

    return act


def swapped_sensors(at_s: float = 20.0) -> Strange:
    """The plugs of sensors 3 and 4 are swapped."""

    def act(rig: StrangeRig, t_s: float) -> None:
        rig.read = (lambda h: [h[0], h[1], h[3], h[2]]) if t_s >= at_s else None

    return act


def swapped_outlets(at_s: float = 20.0) -> Strange:
    """The two hoses of pump 1 are swapped: gamma becomes 1 - gamma."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= at_s and not rig.kept:
            rig.kept["done"] = 1.0
            first, second = rig.parameters.pumps.valve_split
            rig.split(1.0 - first, second)

    return act


def swapped_pipes(at_s: float = 20.0) -> Strange:
    """The pipes of both pumps to the lower tanks are swapped: pump 1 feeds tank 2, pump 2 tank 1."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= at_s:
            pumps = rig.parameters.pumps
            to1, to2 = (pumps.valve_split[i] * pumps.gain_cm3_Vs[i] * rig._tanks.flow_V[i] * STEP_S for i in (0, 1))
            rig.pour(to2 - to1, to1 - to2, 0.0, 0.0)

    return act


def bucket(tank: int = 1, volume_cm3: float = 60.0, at_s: float = 20.0, again_s: float = 1e9) -> Strange:
    """Water is poured into a tank by hand within half a second; again after again_s."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= at_s and (t_s - at_s) % again_s < 0.5:
            volumes = [0.0] * 4
            volumes[tank - 1] = volume_cm3 * STEP_S / 0.5
            rig.pour(*volumes)

    return act


def cross_talk(at_s: float = 20.0) -> Strange:
    """Sensor 1 also reads a tenth of what sensor 2 reads beyond its value at the time, and sensor 2 of sensor 1."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= at_s:
            rig.read = lambda h: [h[0] + 0.15 * h[1], h[1] - 0.1 * h[0], h[2], h[3]]

    return act


def waves(at_s: float = 20.0, wave_cm: float = 0.1) -> Strange:
    """Waves of 50 mV (0.1 cm) on every sensor, correlated over 3 s."""
    kept = exp(-STEP_S / 3.0)
    state = np.zeros(4)

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= at_s:
            state[:] = kept * state + wave_cm * sqrt(1.0 - kept**2) * rig.random.normal(size=4)
            rig.read = lambda h: [float(a + b) for a, b in zip(h, state, strict=True)]

    return act


def leaking_siphon(at_s: float = 20.0) -> Strange:
    """A hose hangs as a siphon between tank 2 and tank 1: 8 cm3/s times the root of the difference, either way."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= at_s:
            apart = rig.levels_cm[1] - rig.levels_cm[0] + 3.0
            moved = 8.0 * (abs(apart) ** 0.5) * (1.0 if apart > 0.0 else -1.0) * STEP_S
            rig.pour(moved, -moved, 0.0, 0.0)

    return act


def jumping_valve(at_s: float = 20.0) -> Strange:
    """The valve of pump 2 jumps to another split every two seconds, at random."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= max(at_s, rig.kept.get("next", 0.0)):
            rig.kept["next"] = t_s + 2.0
            rig.split(rig.parameters.pumps.valve_split[0], rig.random.uniform(0.3, 0.9))

    return act


def outside_hose(tank: int = 2, at_s: float = 20.0, flow_cm3_s: float = 12.0) -> Strange:
    """Somebody fills a lower tank with a garden hose, steadily."""

    def act(rig: StrangeRig, t_s: float) -> None:
        if t_s >= at_s:
            volumes = [0.0] * 4
            volumes[tank - 1] = flow_cm3_s * STEP_S
            rig.pour(*volumes)

    return act


STRANGE: dict[str, Callable[[], Strange]] = {
    "oscillating pump": oscillating_pump,
    "hose of pump 2 in tank 4": hose_in_other_tank,
    "tank 3 drains into tank 2": drain_in_other_tank,
    "stone in outlet 1": stone_in_outlet,
    "stone in outlet 3": lambda: stone_in_outlet(tank=3),
    "bent sensor 1": bent_sensor,
    "sensors 3 and 4 swapped": swapped_sensors,
    "outlets of pump 1 swapped": swapped_outlets,
    "pipes swapped": swapped_pipes,
    "bucket into tank 1": bucket,
    "buckets into tank 3": lambda: bucket(tank=3, volume_cm3=30.0, again_s=10.0),
    "cross-talk of sensors 1 and 2": cross_talk,
    "waves of 50 mV": waves,
    "siphon between tanks 1 and 2": leaking_siphon,
    "jumping valve 2": jumping_valve,
    "garden hose into tank 2": outside_hose,
}


def play_strange(strange: Strange, scenario: dict[str, Any], seed: int = 1, *, checks: bool = False) -> Run:
    """One run in lockstep on such a rig."""
    _, _, truth, faults = _built(scenario)
    keeper = Keeper()
    rig = StrangeRig(strange, truth, faults, seed, contract().fingerprint, keeper.on_change)
    return play(scenario, seed=seed, emulator=rig, checks=checks)
