"""A rig file as the emulator's truth: what it says of tanks, pumps and sensors, in the emulator's own keys.

The emulator reads the file with its own code and its own ranges. What a rig file says of control, limits and the bus is
the controller's business and is not looked at. An optional key that the rig file leaves out has the rig file's
default, whatever emulator.toml says: a rig is written once.
"""

from pathlib import Path
from typing import Any

from firmware_sim.settings_file import SettingsError, check_kind, read_toml

REQUIRED = (
    ("tanks", "area_cm2"),
    ("tanks", "outlet_cm2"),
    ("tanks", "height_cm"),
    ("tanks", "gravity_cm_s2"),
    ("pumps", "gain_cm3_Vs"),
    ("pumps", "valve_split"),
    ("pumps", "lag_s"),
    ("sensors", "gain_V_cm"),
    ("sensors", "noise_V"),
)

OPTIONAL = {
    ("tanks", "datum_cm"): 0.0,
    ("pumps", "dead_zone_V"): 0.0,
    ("pumps", "curve_1_V"): 0.0,
    ("pumps", "delay_s"): 0.0,
    ("sensors", "offset_V"): 0.0,
}

START = ("tanks", "start_V")
OPERATING_POINT = ("control", "operating_point_V")
"""The emulator starts in the equilibrium of the rig's operating point."""


def read_rig(file: Path) -> dict[str, Any]:
    """The rig file's part of the emulator's settings, as tables; values are not checked. Raises SettingsError."""
    data = read_toml(file)
    check_kind(data, file, "safety", "a rig file")
    layer: dict[str, Any] = {"tanks": {}, "pumps": {}, "sensors": {}}
    for table, key in REQUIRED:
        layer[table][key] = _value(data, table, key, file)
    for (table, key), default in OPTIONAL.items():
        layer[table][key] = data[table].get(key, default)
    layer[START[0]][START[1]] = _value(data, *OPERATING_POINT, file)
    return layer


def key_in_rig(path: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """The key of the rig file that a key of the emulator's settings comes from."""
    return (*OPERATING_POINT, *path[2:]) if path[:2] == START else path


def find_rig(rig: str, folder: Path, shipped: Path) -> Path:
    """The file of a rig given by path or by name: a path that exists is taken as it is.

    folder, shipped : the configuration in use, and the one that comes with the package; rigs/NAME.toml in them.
    Raises SettingsError that lists the names there are.
    """
    path = Path(rig)
    if path.exists():
        return path
    folders = [folder / "rigs", shipped / "rigs"]
    if path.name == rig:
        name = rig.removesuffix(".toml")
        for file in (one / f"{name}.toml" for one in folders):
            if file.is_file():
                return file
    names = ", ".join(sorted({file.stem for one in folders for file in one.glob("*.toml")}))
    raise SettingsError(f"{rig}: no such file, and no shipped name; shipped rigs: {names}")


def _value(data: dict[str, Any], table: str, key: str, file: Path) -> Any:
    values = data.get(table)
    if values is None:
        raise SettingsError(f"{file}: {table}: table is missing")
    if not isinstance(values, dict):
        raise SettingsError(f"{file}: {table} = {values!r}: must be a table")
    if key not in values:
        raise SettingsError(f"{file}: {table}.{key}: key is missing")
    return values[key]
