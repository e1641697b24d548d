"""`python -m tools.mutants [MODULE ...]`: exit code 1 for a survivor that is not accepted, and for a stale list."""

from __future__ import annotations

import argparse
import sys
import time
import tomllib
from pathlib import Path

from tools.mutants.generate import Mutant, mutants_of
from tools.mutants.run import Bench, Verdict, run_all

ROOT = Path(__file__).resolve().parents[2]
ACCEPTED = Path(__file__).with_name("accepted.toml")
SUPERVISOR_TESTS = (
    "tests/safety/test_safety_table.py",
    "tests/safety/test_safety_interlocks.py",
    "tests/safety/test_safety_supervisor.py",
)
WIRE_TESTS = ("tests/wire/test_wire_checks.py",)
TARGETS: dict[str, tuple[str, ...]] = {
    "hil.core.supervisor": SUPERVISOR_TESTS,
    "hil.core.interlocks": SUPERVISOR_TESTS,
    "hil.wire.frame_check": WIRE_TESTS,
}
"""Module under test, and the tests that have to tell its mutants from it, the quickest first."""


def main() -> int:
    """Run them all and compare with the list."""
    parser = argparse.ArgumentParser(prog="python -m tools.mutants", description=__doc__)
    parser.add_argument("modules", nargs="*", default=list(TARGETS), help=f"of {', '.join(TARGETS)}; default: all")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
    chosen = parser.parse_args()
    accepted = {_key(entry): entry["reason"] for entry in tomllib.loads(ACCEPTED.read_text())["mutant"]}
    is_good = True
    for module in chosen.modules:
        is_good &= _judge(module, chosen.jobs, accepted)
    return 0 if is_good else 1


def _judge(module: str, jobs: int, accepted: dict[tuple[str, str, str], str]) -> bool:
    """All mutants of one module; whether the survivors are just the accepted ones."""
    path = ROOT / f"{module.replace('.', '/')}.py"
    mutants = mutants_of(path)
    started = time.monotonic()
    bench = Bench(ROOT, module, TARGETS[module])
    verdicts = run_all(bench, mutants, jobs)
    survived = [m for m, verdict in zip(mutants, verdicts, strict=True) if verdict is Verdict.SURVIVED]
    keys = {(module, m.before, m.after) for m in survived}
    unlisted = [m for m in survived if (module, m.before, m.after) not in accepted]
    stale = [key for key in accepted if key[0] == module and key not in keys]
    print(
        f"{module}: {len(mutants)} mutants, {len(mutants) - len(survived)} killed "
        f"({verdicts.count(Verdict.TIMED_OUT)} by the clock), {len(survived) - len(unlisted)} accepted survivors, "
        f"{len(unlisted)} unlisted; {time.monotonic() - started:.0f} s"
    )
    for mutant in unlisted:
        print(f"  survived: {_shown(module, mutant)}")
    for _, before, after in stale:
        print(f"  accepted, but did not survive: {before}  ->  {after}")
    return not unlisted and not stale


def _shown(module: str, mutant: Mutant) -> str:
    return f"{module}:{mutant.line} {mutant.operator}\n      - {mutant.before}\n      + {mutant.after}"


def _key(entry: dict[str, str]) -> tuple[str, str, str]:
    return entry["module"], entry["before"], entry["after"]


if __name__ == "__main__":
    sys.exit(main())
