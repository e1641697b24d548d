"""A rig as it is, once for the controller and once for the emulator: nothing on it is as on the paper's rig.

Levels and flows at the operating point are the paper's, so that runs on both rigs compare.
"""

from pathlib import Path
from typing import Any

from hil.edge.config.rig_file import Rig
from hil.edge.config.settings_file import default_config_dir, merged, read_toml, validated

SHARED: dict[str, dict[str, Any]] = {
    "tanks": {
        "outlet_cm2": [0.0598, 0.0483, 0.0552, 0.0408],
        "height_cm": [20.0, 20.0, 21.0, 22.0],
        "datum_cm": [5.0, 5.0, 1.0, 1.2],
    },
    "pumps": {"dead_zone_V": [0.5, 0.4], "curve_1_V": [0.03, 0.035], "lag_s": [0.3, 0.5], "delay_s": [0.4, 0.25]},
    "sensors": {
        "gain_V_cm": [-0.45, 0.5, 0.05, -0.05],
        "offset_V": [9.5, 0.1, 1.0, 8.0],
        "noise_V": [0.0045, 0.005, 0.0005, 0.0005],
    },
}
"""Keys that rig file and emulator file have in common."""

OPERATING_V = [3.27, 3.14]
RIG: dict[str, Any] = {**SHARED, "control": {"operating_point_V": OPERATING_V}}
EMULATOR: dict[str, dict[str, Any]] = {
    "tanks": {**SHARED["tanks"], "start_V": OPERATING_V},
    "pumps": SHARED["pumps"],
    "sensors": {**SHARED["sensors"], "adc_bits": 16},
}


def real_rig(**over: dict[str, Any]) -> Rig:
    """The rig file as the controller has it; `over` replaces keys, table by table."""
    data = merged(merged(read_toml(default_config_dir() / "rig.toml"), RIG), over)
    return validated(Rig, data, "real rig")


def scenario(path: Path, text: str, *, spread: float = 0.03) -> Path:
    """A scenario file on this rig. text : everything but [rig] and [emulator]."""
    lines = [text]
    for name, tables in (("rig", RIG), ("emulator", EMULATOR)):
        lines.append(f"[{name}]")
        lines += [f"{table}.{key} = {value}" for table, values in tables.items() for key, value in values.items()]
    lines.append(f"parameter_spread = {spread}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
