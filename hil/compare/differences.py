"""What differs in the configuration of runs: the keys of their merged settings, and the files copied beside them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hil.edge.record.manifest import Manifest

ABSENT = "–"
NAMED_BY_SETTINGS = ("rig.toml",)
"""Copies whose content is in the merged settings, key by key; those of scenarios are, too."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A key whose value is not the same in all runs. values : as text, of each run; a dash where it has no such key."""

    key: str
    values: tuple[str, ...]


def differences(manifests: Sequence[Manifest]) -> tuple[Difference, ...]:
    """The keys that differ, in the order of the settings; the run's own facts first, versions and files last."""
    flat = [dict(_facts(manifest)) for manifest in manifests]
    keys = dict.fromkeys(key for one in flat for key in one)
    found = []
    for key in keys:
        values = tuple(one.get(key, ABSENT) for one in flat)
        if len(set(values)) > 1:
            found.append(Difference(key, values))
    return (*found, *_files([manifest.plan.copies for manifest in manifests]))


def _facts(manifest: Manifest) -> Iterator[tuple[str, str]]:
    plan = manifest.plan
    yield "mode", plan.mode
    yield "seed", _text(plan.seed)
    yield from _flat("", plan.settings)
    for name, version in manifest.versions.items():
        yield f"versions.{name}", version


def _flat(key: str, value: Any) -> Iterator[tuple[str, str]]:
    """Keys and values; a list of plain values is one value, a list of tables has its place in the key."""
    if isinstance(value, Mapping):
        for name, inside in value.items():
            yield from _flat(f"{key}.{name}" if key else str(name), inside)
    elif isinstance(value, list) and any(isinstance(one, Mapping) for one in value):
        for place, inside in enumerate(value):
            yield from _flat(f"{key}[{place}]", inside)
    elif value != []:
        yield key, _text(value)


def _files(copies: Sequence[Mapping[str, str]]) -> Iterator[Difference]:
    """Copied files that no setting repeats, such as the DBC and the emulator's own file."""
    names = dict.fromkeys(name for one in copies for name in one)
    for name in names:
        if name in NAMED_BY_SETTINGS or name.startswith("scenarios/"):
            continue
        texts = [one.get(name) for one in copies]
        kinds = {text: number for number, text in enumerate(dict.fromkeys(text for text in texts if text is not None))}
        if len(set(texts)) > 1:
            values = tuple(ABSENT if text is None else f"text {chr(ord('A') + kinds[text] % 26)}" for text in texts)
            yield Difference(f"file {name}", values)


def _text(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, list):
        return f"[{', '.join(_text(one) for one in value)}]"
    return str(value)
