"""Mutation tests: exit code 1 for a survivor that is not accepted, and for a list of accepted ones that is outdated.

python -m tools.mutants                           # every mutant of the safety modules
python -m tools.mutants hil.wire.frame_check      # of one of them
python -m tools.mutants --sample 100 --seed 7     # 100 mutants drawn over all rooms
python -m tools.mutants --sample 20 --room glr    # over one room
"""

from __future__ import annotations

import argparse
import sys
import time
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tools.mutants.generate import Mutant, mutants_of
from tools.mutants.run import Fate, Judgement, Target, run_all, unchanged
from tools.mutants.sample import ROOMS, draw

ROOT = Path(__file__).resolve().parents[2]
ACCEPTED = Path(__file__).with_name("accepted.toml")
TABLE_TESTS = "tests/safety/test_safety_table.py"
INTERLOCK_TESTS = "tests/safety/test_safety_interlocks.py"
SUPERVISOR_TESTS = "tests/safety/test_safety_supervisor.py"
WIRE_TESTS = ("tests/wire/test_wire_checks.py",)
SAFETY: dict[str, tuple[str, ...]] = {
    "hil.core.supervisor": (TABLE_TESTS, INTERLOCK_TESTS, SUPERVISOR_TESTS),
    "hil.core.interlocks": (INTERLOCK_TESTS, TABLE_TESTS, SUPERVISOR_TESTS),
    "hil.core.live_levels": ("tests/safety/test_safety_live_levels.py",),
    "hil.wire.frame_check": WIRE_TESTS,
}
"""Safety module, and the tests that have to kill all its mutants; first those that kill most of them per second."""

Key = tuple[str, str, str]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the mutants and compare the survivors with the list of accepted ones."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.mutants", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("modules", nargs="*", help=f"of {', '.join(SAFETY)}; default: all")
    parser.add_argument("--sample", type=int, default=0, help="draw so many mutants over all rooms instead")
    parser.add_argument("--seed", type=int, default=1, help="of the sample; default 1")
    parser.add_argument("--room", action="append", choices=list(ROOMS), help="draw in this room; may be repeated")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time; default 2")
    options = parser.parse_args(arguments)
    accepted = {
        (entry["module"], entry["before"], entry["after"])
        for entry in tomllib.loads(ACCEPTED.read_text(encoding="utf-8"))["mutant"]
    }
    outdated = [key for key in sorted(accepted) if not _is_in_the_code(ROOT, key)]
    for module, before, _ in outdated:
        print(f"accepted, but the line is no longer there: {module}: {before}")
    if outdated:
        return 1
    if options.sample:
        work = draw(ROOT, options.room or ROOMS, options.sample, options.seed)
        title = f"sample of {len(work)}, seed {options.seed}"
        return 0 if judge(title, work, options.jobs, accepted, is_complete=False) else 1
    is_good = True
    for module in options.modules or SAFETY:
        target = Target(ROOT, module, SAFETY[module])
        work = [(target, mutant) for mutant in mutants_of(target.path)]
        is_good &= judge(module, work, options.jobs, accepted, is_complete=True)
    return 0 if is_good else 1


def judge(title: str, work: list[tuple[Target, Mutant]], jobs: int, accepted: set[Key], *, is_complete: bool) -> bool:
    """Run these mutants and print the result; whether the survivors are exactly the accepted ones.

    is_complete : whether these are all mutants of their modules, so that an accepted one that is not among them is
    outdated. Raises RuntimeError when a test that killed a mutant also fails without it.
    """
    started = time.monotonic()

    def show_survivor(target: Target, mutant: Mutant) -> None:
        what = "accepted" if key_of(target.module, mutant) in accepted else "survived"
        print(f"  {what}: {target.module}:{mutant.line} {mutant.operator}", flush=True)
        print(f"      - {mutant.before}\n      + {mutant.after}", flush=True)

    judgements = run_all(work, jobs, show_survivor)
    _check_killers(work, judgements)
    fates = [judgement.fate for judgement in judgements]
    survived = [
        (target.module, mutant) for (target, mutant), fate in zip(work, fates, strict=True) if fate is Fate.SURVIVED
    ]
    keys = {key_of(module, mutant) for module, mutant in survived}
    unlisted = [(module, mutant) for module, mutant in survived if key_of(module, mutant) not in accepted]
    ran = {key_of(target.module, mutant) for target, mutant in work}
    modules = {target.module for target, _ in work} if is_complete else set()
    stale = [key for key in accepted if (key in ran or key[0] in modules) and key not in keys]
    print(
        f"{title}: {len(work)} mutants, {len(work) - len(survived)} killed "
        f"({fates.count(Fate.TIMED_OUT)} by the clock), {len(survived) - len(unlisted)} accepted survivors, "
        f"{len(unlisted)} unlisted; {time.monotonic() - started:.0f} s"
    )
    for module, before, after in stale:
        print(f"  accepted, but did not survive: {module}: {before}  ->  {after}")
    return not unlisted and not stale


def _is_in_the_code(root: Path, key: Key) -> bool:
    """Whether the module still has the line that an accepted mutant changes."""
    file = Target(root, key[0], ()).path
    return file.is_file() and key[1] in (line.strip() for line in file.read_text(encoding="utf-8").splitlines())


def _check_killers(work: list[tuple[Target, Mutant]], judgements: list[Judgement]) -> None:
    """Run every test that killed a mutant on the unchanged modules. Raises RuntimeError when one fails."""
    killers = sorted({judgement.killer for judgement in judgements if judgement.killer})
    if killers:
        target = replace(work[0][0], tests=tuple(killers), needs_compiler=False)
        (judgement,) = run_all([(target, unchanged(target))], 1)
        if judgement.fate is not Fate.SURVIVED:
            raise RuntimeError(
                f"this test fails without any change: {judgement.killer or 'none, but they take too long'}"
            )


def key_of(module: str, mutant: Mutant) -> Key:
    """How the list of accepted mutants names one."""
    return module, mutant.before, mutant.after


if __name__ == "__main__":
    sys.exit(main())
