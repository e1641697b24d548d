"""Rooms of the project with the tests that have to kill their mutants, and a seeded sample of those mutants."""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from tools.mutants.generate import Mutant, Site, mutant_at, sites_of
from tools.mutants.run import Target

MUST_BE_COMPLETE = frozenset(
    {"hil.core.supervisor", "hil.core.interlocks", "hil.core.live_levels", "hil.wire.frame_check"}
)
"""Every mutant of these is run anyway."""

SAME_FOR_MYPY = re.compile(r"@dataclass\(.*(frozen|slots)=")
"""Lines that are not drawn: mypy, which runs with the tests, refuses to assign to a frozen or to an unknown field."""


@dataclass(frozen=True)
class Room:
    """Modules (globs below the root) and the folders of the tests that judge them."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    needs_compiler: bool = False


ROOMS = {
    "core": Room(("hil/core/*.py", "hil/core/diagnosis/*.py"), ("tests/core", "tests/safety", "tests/identification")),
    "glr": Room(("hil/core/diagnosis/glr/*.py",), ("tests/glr",), needs_compiler=True),
    "loop": Room(
        ("hil/loop.py", "hil/lockstep.py", "hil/runtime.py"), ("tests/bus", "tests/closed_loop", "tests/faults")
    ),
    "record": Room(("hil/edge/record/*.py",), ("tests/review",)),
    "review": Room(("hil/review/*.py",), ("tests/review", "tests/identification")),
    "emulator": Room(("firmware_sim/*.py", "firmware_sim/faults/*.py"), ("tests/firmware_sim",)),
}


def modules_of(root: Path, room: Room) -> list[str]:
    """Names of a room's modules, but for those that are run completely, and for __main__."""
    files = sorted(file for pattern in room.modules for file in root.glob(pattern))
    names = (".".join(file.relative_to(root).with_suffix("").parts) for file in files if "__" not in file.name)
    return [name for name in names if name not in MUST_BE_COMPLETE]


def target_of(root: Path, room: Room, module: str) -> Target:
    """A module with its room's test files, those first that name the module."""
    files = [str(file.relative_to(root)) for folder in room.tests for file in sorted((root / folder).glob("test_*.py"))]
    package, _, name = module.rpartition(".")
    written = (module, f"from {package} import {name}")
    names_it = {file: any(text in (root / file).read_text(encoding="utf-8") for text in written) for file in files}
    return Target(root, module, tuple(sorted(files, key=lambda file: not names_it[file])), room.needs_compiler)


def draw(root: Path, rooms: Iterable[str], count: int, seed: int) -> list[tuple[Target, Mutant]]:
    """So many mutants, drawn over all places of these rooms where an operator can change something."""
    targets = {
        module: target_of(root, ROOMS[name], module) for name in rooms for module in modules_of(root, ROOMS[name])
    }
    sites = ((site, module) for module, target in targets.items() for site in sites_of(target.path, module, seed))
    return _first(heapq.nsmallest(2 * count + 10, sites, key=lambda entry: entry[0].rank), targets, count)


def _first(sites: list[tuple[Site, str]], targets: dict[str, Target], count: int) -> list[tuple[Target, Mutant]]:
    drawn: list[tuple[Target, Mutant]] = []
    for site, module in sites:
        if len(drawn) == count:
            break
        mutant = mutant_at(site)
        if mutant is not None and not SAME_FOR_MYPY.match(mutant.before):
            drawn.append((targets[module], mutant))
    return drawn
