"""Settings of the emulator: emulator.toml, a scenario's [emulator] table, which has priority, and its [[fault]]s.

All values are checked on loading; every error is one line with file, key, value and what is allowed.
"""

from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import ValidationError

from firmware_sim.equations import flow_voltage
from firmware_sim.faults.base import Fault
from firmware_sim.faults.catalogue import KINDS
from firmware_sim.frames import contract_fingerprint
from firmware_sim.rig_file import key_in_rig, read_rig
from firmware_sim.setting_types import Table, listed, one_of, parts, per_part, within
from firmware_sim.settings_file import (
    SettingsError,
    check_kind,
    dotted,
    first_complaint,
    holds,
    merged,
    read_text,
    read_toml,
)

__all__ = ["EmulatorSettings", "SettingsError", "default_config_dir", "equilibrium_cm", "load", "load_fingerprint"]

Area = Annotated[float, within(0.1, 1e5)]
Outlet = Annotated[float, within(1e-4, 1e3)]
Volt = Annotated[float, within(0.0, 10.0)]
PumpGain = Annotated[float, within(0.01, 1e3)]
Share = Annotated[float, within(0.0, 1.0)]


class TankSettings(Table):
    """Tanks 1, 2 (lower), 3, 4 (upper), after eq. (1) of Hajiani and Poshtan (2012).

    turbulence_cm3_sqrt_s is the intensity of a white noise on the flow into each tank: the volume that it has added
    after t seconds has a standard deviation of turbulence * sqrt(t). datum_cm : how far the outlet, or the end of its
    hose, lies below the tank's zero: at level h the head is h + datum. overflow_to_lower : share of the overflow of
    tanks 3 and 4 that falls into tanks 1 and 2.
    """

    area_cm2: Annotated[tuple[Area, Area, Area, Area], listed(4)]
    outlet_cm2: Annotated[tuple[Outlet, Outlet, Outlet, Outlet], listed(4)]
    height_cm: Annotated[float | tuple[float, ...], per_part(4, 1.0, 1e3)]
    datum_cm: Annotated[float | tuple[float, ...], per_part(4, 0.0, 1e3)] = 0.0
    overflow_to_lower: Annotated[float | tuple[float, ...], per_part(2, 0.0, 1.0)] = 0.0
    gravity_cm_s2: Annotated[float, within(1.0, 1e4)]
    start_V: Annotated[tuple[Volt, Volt], listed(2)]
    hold_until_run: bool
    turbulence_cm3_sqrt_s: Annotated[float | tuple[float, ...], per_part(4, 0.0, 100.0)] = 0.0


class PumpSettings(Table):
    """Two pumps with their valves, and the converter that drives them (range 0 .. 10 V).

    wear_per_h is the share of its gain as new that a pump loses per hour of the scenario. The flow is
    gain * x * (1 + curve_1_V * x), with x = max(0, voltage - dead_zone_V); lag_s acts on the flow, and after delay_s it
    arrives at the valve. split_scatter : relative standard deviation with which the valve's split is drawn again each
    time the flow starts.
    """

    gain_cm3_Vs: Annotated[tuple[PumpGain, PumpGain], listed(2)]
    dead_zone_V: Annotated[float | tuple[float, ...], per_part(2, 0.0, 9.0)] = 0.0
    curve_1_V: Annotated[float | tuple[float, ...], per_part(2, -0.05, 1.0)] = 0.0
    valve_split: Annotated[tuple[Share, Share], listed(2)]
    split_scatter: Annotated[float | tuple[float, ...], per_part(2, 0.0, 0.5)] = 0.0
    lag_s: Annotated[float | tuple[float, ...], per_part(2, 0.0, 60.0)]
    lag_spread: Annotated[float, within(0.0, 1.0)] = 0.0
    delay_s: Annotated[float | tuple[float, ...], per_part(2, 0.0, 10.0)] = 0.0
    dac_bits: Annotated[int, one_of(0, 8, 10, 12, 14, 16)]
    wear_per_h: Annotated[float | tuple[float, ...], per_part(2, 0.0, 10.0)] = 0.0

    def flow_voltages(self, applied_V: tuple[float, float]) -> tuple[float, float]:
        """Flow of each pump in the steady state, divided by its gain, in V: the voltage itself for a straight pump."""
        (v1, v2), (d1, d2), (c1, c2) = applied_V, parts(self.dead_zone_V, 2), parts(self.curve_1_V, 2)
        return flow_voltage(v1, d1, c1), flow_voltage(v2, d2, c2)


class SensorSettings(Table):
    """Level sensors and the converter that reads them (range 0 .. 10.24 V).

    A sensor gives offset_V + gain_V_cm * level; a negative gain is that of a sensor whose voltage falls when the level
    rises. noise_V is white, wave_V has a correlation time of 3 s. scale_error is the error of each sensor's gain, as a
    share of it: four values, or the largest error, within which the run's seed draws all four.
    """

    gain_V_cm: Annotated[float | tuple[float, ...], per_part(4, 0.01, 10.0, is_signed=True)]
    offset_V: Annotated[float | tuple[float, ...], per_part(4, -20.0, 20.0)] = 0.0
    noise_V: Annotated[float | tuple[float, ...], per_part(4, 0.0, 1.0)]
    wave_V: Annotated[float | tuple[float, ...], per_part(4, 0.0, 1.0)] = 0.0
    scale_error: Annotated[float | tuple[float, ...], per_part(4, -0.5, 0.5)] = 0.0
    adc_bits: Annotated[int, one_of(0, 12, 16)]


class NodeSettings(Table):
    """Cycle times of the frames, watchdog time and boot time."""

    levels_period_s: Annotated[float, within(0.001, 1.0)]
    status_period_s: Annotated[float, within(0.001, 1.0)]
    heartbeat_period_s: Annotated[float, within(0.01, 10.0)]
    watchdog_s: Annotated[float, within(0.01, 10.0)]
    boot_s: Annotated[float, within(0.0, 60.0)]


class EmulatorSettings(Table):
    """The whole of emulator.toml.

    parameter_spread : largest deviation of outlets, pump gains and valve splits from the file's values, as a share of
    them; the run's seed draws each (see `firmware_sim.parameter_spread`).
    """

    parameter_spread: Annotated[float, within(0.0, 0.5)] = 0.0
    tanks: TankSettings
    pumps: PumpSettings
    sensors: SensorSettings
    nodes: NodeSettings


def default_config_dir() -> Path:
    """Return the config directory of a checkout, or the one that the wheel puts beside the package.

    Raises SettingsError when there is neither.
    """
    beside = Path(__file__).resolve().parent.parent
    for folder in (beside / "config", beside / "fourtank_config"):
        if (folder / "bench.dbc").is_file():
            return folder
    raise SettingsError(f"{beside}: no config directory with a bench.dbc here; name one with --config")


def load(
    emulator_toml: Path, scenario: Path | None = None, rig: Path | None = None, *, is_empty: bool = False
) -> tuple[EmulatorSettings, tuple[Fault, ...]]:
    """Read and check emulator.toml and, if given, the emulator's part of a scenario.

    rig : a rig file; tanks, pumps, sensors and start are then those of this rig, and emulator.toml has only what a rig
    file can't say. A scenario's [emulator] table has priority over both. is_empty : the tanks
    start empty, whatever start_V says. Raises SettingsError.
    """
    base = read_toml(emulator_toml)
    scenario_data = {} if scenario is None else read_toml(scenario)
    check_kind(base, emulator_toml, "nodes", "an emulator file")
    check_kind(scenario_data, scenario, "scenario", "a scenario")
    overlay = scenario_data.get("emulator", {})
    if not isinstance(overlay, dict):
        raise SettingsError(f"{scenario}: emulator = {overlay!r}: must be a table")
    of_rig = {} if rig is None else read_rig(rig)

    def where(path: tuple[int | str, ...]) -> str:
        """File and key that a value comes from."""
        if scenario is not None and holds(overlay, path):
            return f"{scenario}: {dotted(('emulator', *path))}"
        if rig is not None and holds(of_rig, path):
            return f"{rig}: {dotted(key_in_rig(path))}"
        return f"{emulator_toml}: {dotted(path)}"

    try:
        settings = EmulatorSettings.model_validate(merged(merged(base, of_rig), overlay))
        if is_empty:
            settings = settings.model_copy(update={"tanks": settings.tanks.model_copy(update={"start_V": (0.0, 0.0)})})
    except ValidationError as error:
        path, what = first_complaint(error)
        raise SettingsError(f"{where(path)}{what}") from None
    _check_start(settings, where(("tanks", "start_V")))
    return settings, _faults(scenario_data, scenario)


def load_fingerprint(dbc: Path) -> int:
    """CRC-32 of the wire contract, which the nodes send in their heartbeats. Raises SettingsError."""
    return contract_fingerprint(read_text(dbc))


def equilibrium_cm(settings: EmulatorSettings) -> tuple[float, float, float, float]:
    """Levels of the equilibrium at constant pump voltages start_V: eq. (1) with all derivatives zero.

    A tank whose outlet lies so low that it could carry more than flows in is empty.
    """
    tanks, pumps = settings.tanks, settings.pumps
    q1, q2 = (k * v for k, v in zip(pumps.gain_cm3_Vs, pumps.flow_voltages(tanks.start_V), strict=True))
    g1, g2 = pumps.valve_split
    upper3, upper4 = (1.0 - g2) * q2, (1.0 - g1) * q1
    through = (g1 * q1 + upper3, g2 * q2 + upper4, upper3, upper4)
    heads_cm = [(q / a) ** 2 / (2.0 * tanks.gravity_cm_s2) for q, a in zip(through, tanks.outlet_cm2, strict=True)]
    h = [max(0.0, head_cm - datum_cm) for head_cm, datum_cm in zip(heads_cm, parts(tanks.datum_cm, 4), strict=True)]
    return h[0], h[1], h[2], h[3]


def _extremes(settings: EmulatorSettings) -> tuple[EmulatorSettings, ...]:
    """The settings, and those with the largest inflow and smallest outlets that the spread allows."""
    spread, tanks, pumps = settings.parameter_spread, settings.tanks, settings.pumps
    if not spread:
        return (settings,)
    smallest = tanks.model_copy(update={"outlet_cm2": tuple(a * (1.0 - spread) for a in tanks.outlet_cm2)})
    gains = tuple(k * (1.0 + spread) for k in pumps.gain_cm3_Vs)
    g1, g2 = pumps.valve_split
    splits = [(g1 * (1 + s1 * spread), g2 * (1 + s2 * spread)) for s1 in (-1, 1) for s2 in (-1, 1)]
    return tuple(
        settings.model_copy(
            update={
                "tanks": smallest,
                "pumps": pumps.model_copy(
                    update={"gain_cm3_Vs": gains, "valve_split": (min(split[0], 1.0), min(split[1], 1.0))}
                ),
            }
        )
        for split in splits
    )


def _check_start(settings: EmulatorSettings, where: str) -> None:
    """Refuse a start with a level above the rim. where : file and key of the voltages. Raises SettingsError."""
    spread = settings.parameter_spread
    heights_cm = parts(settings.tanks.height_cm, 4)
    highest_cm, height_cm = max(
        (pair for extreme in _extremes(settings) for pair in zip(equilibrium_cm(extreme), heights_cm, strict=True)),
        key=lambda pair: pair[0] - pair[1],
    )
    if highest_cm > height_cm:
        start_V = list(settings.tanks.start_V)
        may = f" with parameter_spread = {spread:g} can give" if spread else " gives"
        raise SettingsError(
            f"{where} = {start_V}:{may} a level of {highest_cm:.2f} cm, which is outside 0 .. {height_cm:g} cm"
        )


def _faults(scenario_data: dict[str, Any], scenario: Path | None) -> tuple[Fault, ...]:
    entries = scenario_data.get("fault", [])
    if not isinstance(entries, list):
        raise SettingsError(f"{scenario}: fault = {entries!r}: must be an array of tables, [[fault]]")
    return tuple(_fault(entry, f"{scenario}: fault[{index}]") for index, entry in enumerate(entries))


def _fault(entry: object, where: str) -> Fault:
    if not isinstance(entry, dict):
        raise SettingsError(f"{where} = {entry!r}: must be a table")
    if "kind" not in entry:
        raise SettingsError(f"{where}.kind: key is missing")
    kind = entry["kind"]
    if not isinstance(kind, str) or kind not in KINDS:
        raise SettingsError(f"{where}.kind = {kind!r}: must be one of {', '.join(KINDS)}")
    try:
        return cast(Fault, KINDS[kind].model_validate(entry))
    except ValidationError as error:
        path, what = first_complaint(error)
        raise SettingsError(f"{where}.{dotted(path)}{what}") from None
