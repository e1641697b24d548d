"""Page of every settings key: unit, range and default from the settings' own classes, meaning from the files' comments.

Rig and emulator are explained by config/rig.toml and config/emulator.toml as they are shipped; scenario, campaign and
benchmark by the annotated examples in docs/reference/annotated, which have every key once.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from firmware_sim.settings import EmulatorSettings
from hil.bench.choice_table import ChoiceTable, TableChoice
from hil.bench.designs import DESIGNS
from hil.bench.detectors import DETECTORS
from hil.bench.law_choices import LAWS
from hil.campaigns.benchmark_spec import BenchmarkSpec
from hil.campaigns.spec import Spec
from hil.edge.config.rig_file import Rig
from hil.edge.config.scenario_file import Scenario
from tools.reference import FOLDER, ROOT
from tools.reference.comments import comments_of
from tools.reference.markdown import code, table
from tools.reference.ranges import range_of, table_of
from tools.reference.units import unit_of

CHOICES: tuple[tuple[str, ChoiceTable[Any]], ...] = (
    ("Control laws", LAWS),
    ("Designs", DESIGNS),
    ("Fault detectors", DETECTORS),
)


@dataclass(frozen=True)
class SettingsFile:
    """One kind of settings file. example : the file whose comments say what each key means."""

    title: str
    about: str
    model: type[BaseModel]
    example: Path
    is_shipped: bool


FILES = (
    SettingsFile(
        "Scenario file",
        "One experiment: `hil simulate`, `hil run`, `firmware-sim --scenario`. An unknown key is an error.",
        Scenario,
        FOLDER / "annotated/scenario.toml",
        is_shipped=False,
    ),
    SettingsFile(
        "Rig file",
        "`config/rig.toml`: the process and the bench as the controller knows them. A scenario's `[rig]` table "
        "replaces single keys. The column *shipped* has the value in the project's own file. `tanks.datum_cm`, "
        "`pumps.dead_zone_V`, `curve_1_V` and `delay_s`, `sensors.offset_V` and the tables `start` and `uncertainty` "
        "may be left out, which gives that value; every other key is required.",
        Rig,
        ROOT / "config/rig.toml",
        is_shipped=True,
    ),
    SettingsFile(
        "Emulator file",
        "`config/emulator.toml`: the process and the nodes inside the emulator. A scenario's `[emulator]` table "
        "replaces single keys.",
        EmulatorSettings,
        ROOT / "config/emulator.toml",
        is_shipped=True,
    ),
    SettingsFile(
        "Campaign file",
        "Many runs: `hil campaign`.",
        Spec,
        FOLDER / "annotated/campaign.toml",
        is_shipped=False,
    ),
    SettingsFile(
        "Benchmark file",
        "Laws and detectors compared: `hil benchmark`.",
        BenchmarkSpec,
        FOLDER / "annotated/benchmark.toml",
        is_shipped=False,
    ),
)


@dataclass(frozen=True)
class Key:
    """One settings key. path : "safety.level_max_cm"; within a list of tables: "fault[].kind"."""

    path: str
    field: FieldInfo
    default: str

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self.path.rpartition(".")[2]


def keys_of(model: type[BaseModel], shipped: dict[str, Any] | None = None, prefix: str = "") -> Iterator[Key]:
    """Every key of a model and of the tables in it, in their order."""
    for name, field in model.model_fields.items():
        inner, is_list = table_of(field)
        value = None if shipped is None else shipped.get(name)
        if inner is not None:
            below = value if isinstance(value, dict) else None
            yield from keys_of(inner, below, f"{prefix}{name}{'[]' if is_list else ''}.")
        else:
            yield Key(f"{prefix}{name}", field, _default(field, value))


def keys_of_file(file: SettingsFile) -> list[Key]:
    """Every key of a settings file."""
    shipped = tomllib.loads(file.example.read_text(encoding="utf-8")) if file.is_shipped else None
    return list(keys_of(file.model, shipped))


def settings_page() -> str:
    """The whole page."""
    parts = [
        "# Settings\n\nAll settings are TOML files. A value of the wrong type, out of range or under an unknown key is "
        "an error: one line with file, key, value and range, and exit code 2. Lists have their entries in the order "
        "pump 1, 2 and tank 1, 2 (lower), 3, 4 (upper). The last part of a key's name is its unit.\n"
    ]
    for file in FILES:
        parts.append(f"\n## {file.title}\n\n{file.about}\n\n{_table(file)}")
        if not file.is_shipped:
            parts.append(
                f"\nAn example with every key:\n\n```toml\n{file.example.read_text(encoding='utf-8').strip()}\n```\n"
            )
    for title, choices in CHOICES:
        rows = [(code(row.name), row.summary) for row in _built_in(choices)]
        parts.append(
            f"\n## {title}\n\nNames for the key `{choices.key}`. An installed package adds names by entry points of "
            f"the group `{choices.group}`.\n\n{table(('name', 'what it is'), rows)}"
        )
    return "".join(parts)


def range_of_key(key: Key) -> str:
    """What a key accepts, in words."""
    choices = next((choices for _, choices in CHOICES if choices.key == key.path), None)
    if choices is None:
        return range_of(key.field)
    return ", ".join(code(f'"{row.name}"') for row in _built_in(choices)) + ", or an installed one"


def _built_in(choices: ChoiceTable[Any]) -> list[TableChoice[Any]]:
    rows = [choices.find(name, choices.key) for name in choices.names]
    return [row for row in rows if not row.package]


def _table(file: SettingsFile) -> str:
    comments = comments_of(file.example)
    head = ("key", "unit", "range", "shipped" if file.is_shipped else "default", "meaning")
    rows = [
        (code(key.path), unit_of(key.name), range_of_key(key), key.default, comments.get(key.path, ""))
        for key in keys_of_file(file)
    ]
    return table(head, rows)


def _default(field: FieldInfo, shipped: object) -> str:
    if shipped is not None:
        return code(_toml(shipped))
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    return "none" if default in (None, (), {}, PydanticUndefined) else code(_toml(default))


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(part) for part in value)}]"
    return f"{value:g}" if isinstance(value, float) else str(value)
