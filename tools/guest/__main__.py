"""Command line of the guest. Exit code: that of the command or the tests; 125 when there is no guest."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

from tools.guest import host, kernel, machine, tests

NO_GUEST = 125
LIMIT_S = 1200.0


def main() -> int:
    """Set up, run one command, or run the tests."""
    parser = argparse.ArgumentParser(prog="python -m tools.guest", description="A guest kernel with real SocketCAN.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("setup", help="fetch Debian's kernel into the cache")
    verbs.add_parser("packages", help="print the Debian packages that are needed")
    run = verbs.add_parser("run", help="boot, run one command in this folder, power off")
    run.add_argument("--limit", type=float, default=LIMIT_S, metavar="S", help="maximum time of the command")
    run.add_argument("command", nargs=argparse.REMAINDER)
    test = verbs.add_parser("test", help="run the tests marked socketcan")
    test.add_argument("options", nargs=argparse.REMAINDER, help="for pytest")
    given = parser.parse_args()
    try:
        if given.verb == "setup":
            print(kernel.fetch(host.cache_dir()).image)
        elif given.verb == "packages":
            print(" ".join(host.PACKAGES.values()))
        elif given.verb == "run":
            return machine.run(_kernel(), _without_dashes(given.command), given.limit)
        else:
            return _test(_without_dashes(given.options))
    except (host.GuestError, machine.GuestLostError) as error:
        print(f"guest: {error}", file=sys.stderr)
        return NO_GUEST
    return 0


def _test(options: list[str]) -> int:
    """Run them on this kernel if possible, else in the guest; without either say why, as an error where CI is set."""
    command = tests.command(Path.cwd(), options)
    obstacle = host.obstacle()
    if not obstacle:
        return tests.run_here(command)
    try:
        started_s = time.monotonic()
        code = machine.run(_kernel(), command, LIMIT_S)
        print(f"guest: booted, ran and powered off in {time.monotonic() - started_s:.0f} s")
    except host.GuestError as error:
        if os.environ.get("CI"):
            raise
        print(f"socketcan tests skipped: {obstacle}, and {error}")
        return 0
    return code


def _kernel() -> kernel.Kernel:
    for name in host.PACKAGES:
        host.program(name)
    return kernel.find(host.cache_dir()) or kernel.fetch(host.cache_dir())


def _without_dashes(words: list[str]) -> list[str]:
    return words[1:] if words[:1] == ["--"] else words


if __name__ == "__main__":
    sys.exit(main())
