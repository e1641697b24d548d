"""A name of a module or a class of `hil` has one meaning."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WITHOUT_MEANING = {"__init__", "__main__"}

SAME_MEANING = {
    "doctor": "`hil/cli/commands` has a module for each command, by its name; the package does what the command asks",
    "conformance": "as doctor",
    "panel": "as doctor",
    "replay": "as doctor",
    "export": "as doctor",
    "compare": "as doctor",
    "identify": "the command, and the verdict on records that it asks for",
}
"""Modules with one name, and why that is no second meaning. The emulator has names of its own."""

ROLES = {
    "Clock": "protocol of what `hil.runtime` and the probe need of a clock; both are met by MonotonicClock",
    "Port": "protocol of what the loop and the probe need of a bus; both are met by BusPort",
    "Recorder": "the loop's protocol of a recorder, and the recorder into files, which meets it",
}
"""Classes with one name: a user's protocol and what meets it, or the protocols of two users of one thing."""


def modules() -> dict[str, list[str]]:
    """Name -> the modules and packages of that name."""
    found = defaultdict(list)
    for path in sorted((ROOT / "hil").rglob("*.py")):
        if path.stem == "__init__":
            found[path.parent.name].append(path.parent.relative_to(ROOT).as_posix())
        elif path.stem not in WITHOUT_MEANING:
            found[path.stem].append(path.relative_to(ROOT).as_posix())
    return found


def classes() -> dict[str, list[str]]:
    """Name -> the modules that have a public class of that name."""
    found = defaultdict(list)
    for path in sorted((ROOT / "hil").rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[node.name].append(path.relative_to(ROOT).as_posix())
    return found


def test_no_module_name_has_two_meanings() -> None:
    """`design` and `view` used to be commands, and modules that did something else."""
    twice = {name: paths for name, paths in modules().items() if len(paths) > 1}
    assert {name: paths for name, paths in twice.items() if name not in SAME_MEANING} == {}
    assert SAME_MEANING.keys() == twice.keys(), "an entry that is not needed any more"
    assert all(len(twice[name]) == 2 and any("cli/commands" in path for path in twice[name]) for name in SAME_MEANING)


def test_no_class_name_has_two_meanings() -> None:
    """`Clock` used to be a clock, and the offsets of a record's clocks."""
    twice = {name: paths for name, paths in classes().items() if len(paths) > 1}
    assert twice.keys() == ROLES.keys(), twice
