"""Drawn rigs and their experiments, made with the emulator's own tanks, pumps and sensors, without a bus.

The plan of the voltages knows the rig: it is no plan for a bench, and only stands in for one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_sim.level_node import converter
from firmware_sim.parameter_spread import Turbulence, drawn
from firmware_sim.pump_path import PumpPaths
from firmware_sim.sensor_signal import AddedSignal
from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings, equilibrium_cm, load
from firmware_sim.tanks import Tanks
from hil.core.identification.records import LevelRecord, RulerReading
from hil.core.types import Pair

Array = NDArray[np.float64]

CONFIG = Path(__file__).resolve().parents[2] / "config"
PERIOD_S = 0.02
MEAN_OF = 5
NS_PER_PERIOD = 20_000_000
RULER_SD_CM = 0.1
RULER_SHARES = tuple(1.0 - 0.03 * (number * 0.618 % 1.0) for number in range(10))
"""Voltages at which levels are read, as shares of the largest."""
STIRRED_CM = 0.3
"""Turbulence stirs only tanks with some water. The emulator also stirs empty ones, which can only add water: at 0.03
cm3/sqrt(s) a steady 0.06 cm3/s, which no rig has, and which no model of a rig would find."""
RULER_STREAM, PLAN_STREAM, TRUTH_STREAM = 11, 12, 13
SATURATION_V = (0.0, 10.2375)

Plan = list[tuple[float, float, float]]
"""Duration in s and the voltage of each pump."""


@dataclass(frozen=True)
class Truth:
    """A rig: the emulator's settings, and the largest voltages of each pump alone and of both, by its tanks' rims."""

    settings: EmulatorSettings
    alone_V: Pair
    both_V: Pair

    def value(self, name: str) -> float:
        """The true value of a parameter by the name it has in `hil.core.identification.parameters`."""
        group, index = name[:-1], int(name[-1]) - 1
        tanks, pumps, sensors = self.settings.tanks, self.settings.pumps, self.settings.sensors
        if group == "sensor_gain":
            return parts(sensors.gain_V_cm, 4)[index] * (1.0 + parts(sensors.scale_error, 4)[index])
        if group == "overflow":
            return parts(tanks.overflow_to_lower, 2)[index - 2]
        of_group = {
            "k": pumps.gain_cm3_Vs,
            "gamma": pumps.valve_split,
            "a": tanks.outlet_cm2,
            "lag": parts(pumps.lag_s, 2),
            "dead_zone": parts(pumps.dead_zone_V, 2),
            "curve": parts(pumps.curve_1_V, 2),
            "delay": parts(pumps.delay_s, 2),
            "datum": parts(tanks.datum_cm, 4),
            "sensor_offset": parts(sensors.offset_V, 4),
        }
        return of_group[group][index]


def default_settings(rig: str | None = None) -> EmulatorSettings:
    """The emulator's settings, or those of a rig of config/rigs; it starts with empty tanks."""
    path = None if rig is None else CONFIG / "rigs" / f"{rig}.toml"
    settings, _ = load(CONFIG / "emulator.toml", None, path)
    return settings.model_copy(update={"tanks": settings.tanks.model_copy(update={"start_V": (0.0, 0.0)})})


def basic_truth(seed: int, *, turbulence: float = 0.0, wave_V: float = 0.0) -> Truth:
    """The default rig with k, gamma, a within 20 % and the lags within 50 % of the file."""
    settings = default_settings()
    tanks = settings.tanks.model_copy(update={"turbulence_cm3_sqrt_s": turbulence})
    pumps = settings.pumps.model_copy(update={"lag_spread": 0.5})
    sensors = settings.sensors.model_copy(update={"wave_V": wave_V})
    settings = settings.model_copy(update={"tanks": tanks, "pumps": pumps, "sensors": sensors, "parameter_spread": 0.2})
    settings = drawn(settings, seed)
    pumps = settings.pumps.model_copy(update={"lag_spread": 0.0})
    return with_safe_tops(settings.model_copy(update={"parameter_spread": 0.0, "pumps": pumps}))


def rich_truth(seed: int) -> Truth:
    """As `basic_truth`, with dead zones, curves, datums, sensors of their own, and 2 mV of waves."""
    settings = basic_truth(seed).settings
    draw = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(TRUTH_STREAM,))).uniform
    tanks = settings.tanks.model_copy(update={"datum_cm": (*draw(0.5, 2.0, 2).tolist(), *draw(0.2, 0.5, 2).tolist())})
    pumps = settings.pumps.model_copy(
        update={
            "dead_zone_V": tuple(draw(0.2, 1.0, 2).tolist()),
            "curve_1_V": tuple((draw(0.01, 0.03, 2) * np.where(draw(-1.0, 1.0, 2) > 0.3, -1.0, 1.0)).tolist()),
        }
    )
    sensors = settings.sensors.model_copy(
        update={
            "scale_error": tuple(draw(-0.05, 0.05, 4).tolist()),
            "offset_V": tuple(draw(0.03, 0.15, 4).tolist()),
            "wave_V": 0.002,
        }
    )
    return with_safe_tops(settings.model_copy(update={"tanks": tanks, "pumps": pumps, "sensors": sensors}))


def rig_truth(name: str) -> Truth:
    """A rig of config/rigs."""
    return with_safe_tops(default_settings(name))


def with_safe_tops(settings: EmulatorSettings) -> Truth:
    """The truth with the largest voltages at which no tank of this rig gets fuller than 85 % in the steady state."""
    heights_cm = parts(settings.tanks.height_cm, 4)

    def is_safe(pair: Pair) -> bool:
        tanks = settings.tanks.model_copy(update={"start_V": pair})
        levels_cm = equilibrium_cm(settings.model_copy(update={"tanks": tanks}))
        return all(h <= 0.85 * top for h, top in zip(levels_cm, heights_cm, strict=True))

    shares = np.arange(1.0, 0.05, -0.01).tolist()
    alone_1 = next(10.0 * share for share in shares if is_safe((10.0 * share, 0.0)))
    alone_2 = next(10.0 * share for share in shares if is_safe((0.0, 10.0 * share)))
    both = next((alone_1 * share, alone_2 * share) for share in shares if is_safe((alone_1 * share, alone_2 * share)))
    return Truth(settings, (alone_1, alone_2), both)


def experiment_plan(truth: Truth, seed: int) -> Plan:
    """12 min: fill, drain, single pumps, both, a binary sequence."""
    (s1, s2), (v1, v2) = truth.alone_V, truth.both_V
    head: Plan = [(10.0, 0.0, 0.0), (60.0, s1, 0.0), (60.0, 0.0, 0.0), (60.0, 0.0, s2), (60.0, v1, v2)]
    return [*head, *_binary(truth.both_V, seed, 410.0), (60.0, 0.0, 0.0)]


def ruler_plan(truth: Truth) -> Plan:
    """High levels that stand nearly still, to be read at the end of each segment but the first."""
    v1, v2 = truth.both_V
    return [(130.0, v1, v2), *((25.0, share * v1, share * v2) for share in RULER_SHARES)]


def ruler_times(plan: Plan) -> tuple[tuple[float, int], ...]:
    """When a tank (0..3) is read in a plan that ends with a `ruler_plan`: at first all, then the lower two."""
    end_s = sum(duration_s for duration_s, _, _ in plan) - 1.0
    times_s = [end_s - 25.0 * left for left in reversed(range(len(RULER_SHARES)))]
    return tuple((at_s, tank) for at_s in times_s for tank in (range(4) if at_s == times_s[0] else range(2)))


def held_out_plan(truth: Truth, seed: int) -> Plan:
    """5 min of another binary sequence."""
    (s1, s2), (v1, v2) = truth.alone_V, truth.both_V
    head: Plan = [(5.0, 0.0, 0.0), (30.0, 0.8 * s1, 0.0), (30.0, 0.0, 0.8 * s2), (30.0, 0.8 * v1, 0.9 * v2)]
    return [*head, *_binary(truth.both_V, seed + 500_000, 165.0), (40.0, 0.0, 0.0)]


def rest_plan(voltage_V: float, duration_s: float) -> Plan:
    """Constant voltages."""
    return [(duration_s, voltage_V, voltage_V)]


def _binary(top_V: Pair, seed: int, duration_s: float) -> Plan:
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(PLAN_STREAM,)))
    plan: Plan = []
    left_s = duration_s
    while left_s > 1e-6:
        hold_s = min(left_s, float(random.choice([4.0, 8.0, 16.0, 30.0])))
        v1, v2 = (np.array(top_V) * random.choice([0.3, 0.6, 1.0], 2)).tolist()
        plan.append((hold_s, v1, v2))
        left_s -= hold_s
    return plan


def run_experiment(
    truth: Truth, plan: Plan, seed: int, *, name: str = "experiment", ruler: tuple[tuple[float, int], ...] = ()
) -> LevelRecord:
    """Carry out a plan from empty tanks. ruler : (time in s, tank 0..3) of each reading by a ruler, of 1 mm.

    Each row is the mean of the five readings around its time.
    """
    voltage_V, reading_V, level_cm = _raw(truth, plan, seed)
    n = len(reading_V) // MEAN_OF
    time_s: Array = np.arange(n, dtype=float) * PERIOD_S * MEAN_OF
    padded = np.concatenate([np.full((MEAN_OF // 2, 4), nan), reading_V])[: n * MEAN_OF].reshape(n, MEAN_OF, 4)
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(RULER_STREAM,)))
    read = tuple(
        RulerReading(at_s, tank, float(level_cm[round(at_s / PERIOD_S), tank] + RULER_SD_CM * random.standard_normal()))
        for at_s, tank in ruler
    )
    return LevelRecord(
        name=name,
        time_s=time_s,
        voltage_V=voltage_V[::MEAN_OF][:n],
        reading_V=np.nanmean(padded, axis=1),
        samples=np.isfinite(padded).sum(axis=1).astype(float),
        saturation_V=SATURATION_V,
        initial_cm=(0.0, 0.0, 0.0, 0.0),
        ruler=read,
    )


def _raw(truth: Truth, plan: Plan, seed: int) -> tuple[Array, Array, Array]:
    """Voltages, readings and levels every 20 ms."""
    settings = truth.settings
    tanks, paths, added = Tanks(settings), PumpPaths(settings, seed), AddedSignal(settings, seed)
    stirring = Turbulence(settings, seed) if any(parts(settings.tanks.turbulence_cm3_sqrt_s, 4)) else None
    gains = [truth.value(f"sensor_gain{i}") for i in (1, 2, 3, 4)]
    converters = [converter(settings.sensors.adc_bits) for _ in gains]
    voltages = [(v1, v2) for duration_s, v1, v2 in plan for _ in range(round(duration_s / PERIOD_S))]
    readings: list[list[float]] = []
    levels: list[tuple[float, ...]] = []
    for at, pair in enumerate(voltages):
        signals = [g * h + extra for g, h, extra in zip(gains, tanks.levels_cm, added.next_V(), strict=True)]
        readings.append([convert(signal)[0] for convert, signal in zip(converters, signals, strict=True)])
        levels.append(tanks.levels_cm)
        paths.give(pair, [1.0, 1.0], at * NS_PER_PERIOD)
        if paths.next_ns is not None:
            paths.advance(at * NS_PER_PERIOD)
        tanks.advance(PERIOD_S, paths.flow_V, paths.effectiveness)
        if stirring is not None:
            volumes_cm3 = zip(stirring.volumes_cm3(), tanks.levels_cm, strict=True)
            tanks.stir([volume if level > STIRRED_CM else 0.0 for volume, level in volumes_cm3])
    return np.array(voltages), np.array(readings), np.array(levels)


def without(record: LevelRecord, sensors: tuple[int, ...]) -> LevelRecord:
    """A record without some of the sensors (0..3)."""
    readings = record.reading_V.copy()
    readings[:, list(sensors)] = nan
    return replace(record, reading_V=readings)
