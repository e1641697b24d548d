"""Writes the unit of a rig to a file, and says what it leaves out."""

import os
from pathlib import Path

from firmware_sim.faults import Fault
from firmware_sim.fmu.archive import archive
from firmware_sim.fmu.compiler import library_path
from firmware_sim.fmu.model_description import MODEL_NAME
from firmware_sim.fmu.variables import Causality, variables
from firmware_sim.parameter_spread import drawn
from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings, SettingsError

SUFFIX = ".fmu"


def export(file: Path, settings: EmulatorSettings, faults: tuple[Fault, ...], seed: int) -> str:
    """Write the unit, and return lines about it for the terminal.

    seed : of what the settings let a seed draw once: outlets, gains, splits, lags, sensor scales. Raises SettingsError
    for a file name that can't be, CompilerError without a compiler and OSError when the file can't be written.
    """
    if file.suffix != SUFFIX:
        raise SettingsError(f"--fmu {file}: the name must end in {SUFFIX}")
    if not file.parent.is_dir():
        raise SettingsError(f"--fmu {file}: there is no folder {file.parent}")
    rig = drawn(settings, seed)
    content = archive(rig)
    unfinished = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        unfinished.write_bytes(content)
        unfinished.replace(file)
    except OSError as error:
        raise SettingsError(f"--fmu {file}: {error.strerror}") from None
    finally:
        unfinished.unlink(missing_ok=True)
    causality = [one.causality for one in variables(rig)]
    counts = ", ".join(f"{causality.count(one)} {one.value}s" for one in Causality)
    library = library_path(MODEL_NAME)
    lines = [f"firmware-sim wrote {file}: FMI 2.0 co-simulation, {library} and sources; {counts}"]
    missing = left_out(rig, faults)
    if missing:
        lines.append(f"firmware-sim: not in the unit: {', '.join(missing)}")
    return "".join(f"{line}\n" for line in lines)


def left_out(settings: EmulatorSettings, faults: tuple[Fault, ...]) -> list[str]:
    """What the emulator would play with these settings and the unit does not."""
    tanks, pumps, sensors = settings.tanks, settings.pumps, settings.sensors
    candidates = (
        ("sensor noise", any(parts(sensors.noise_V, 4))),
        ("waves", any(parts(sensors.wave_V, 4))),
        ("turbulence", any(parts(tanks.turbulence_cm3_sqrt_s, 4))),
        ("play of the valves (split_scatter)", any(parts(pumps.split_scatter, 2))),
        ("converters (dac_bits, adc_bits)", bool(pumps.dac_bits or sensors.adc_bits)),
        (f"the scenario's {len(faults)} faults (they are inputs)", bool(faults)),
    )
    return [name for name, is_there in candidates if is_there]
