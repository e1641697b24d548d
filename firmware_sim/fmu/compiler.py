"""The system's C compiler: which one, and how the unit's library is made with it."""

import os
import platform
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O1", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=off")
"""The last one: no fused multiply-add, so that every processor rounds as the emulator does."""

TIMEOUT_S = 120.0


class CompilerError(RuntimeError):
    """There is no compiler, or it failed."""


def find_compiler() -> list[str]:
    """The compiler's command: that of the environment variable CC, or the first of COMPILERS. Raises CompilerError."""
    asked = os.environ.get("CC", "").strip()
    if asked:
        try:
            command = shlex.split(asked)
        except ValueError:  # a quotation mark without its other one
            command = []
        if not command or shutil.which(command[0]) is None:
            raise CompilerError(f"no C compiler: CC = {asked!r} is no program")
        return command
    found = next((name for name in COMPILERS if shutil.which(name) is not None), None)
    if found is None:
        raise CompilerError(f"no C compiler: install {', '.join(COMPILERS[:-1])} or {COMPILERS[-1]}, or name one in CC")
    return [found]


def library_path(name: str) -> str:
    """Path of a library for this computer in the archive of a unit, as FMI 2.0 asks for it."""
    if sys.platform == "darwin":
        return f"binaries/darwin64/{name}.dylib"
    machine = platform.machine().lower()
    folder = "linux64" if machine in ("x86_64", "amd64") else f"{machine}-linux"
    return f"binaries/{folder}/{name}.so"


def compiled(folder: Path, source: str, name: str) -> bytes:
    """The library made from a source file in a folder. Raises CompilerError with the compiler's first error."""
    command = [*find_compiler(), *FLAGS, "-o", name, source, "-lm"]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)  # noqa: S603
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CompilerError(f"{command[0]}: {error}") from None
    if done.returncode != 0:
        lines = done.stderr.splitlines()
        first = next((line for line in lines if "error" in line), lines[0] if lines else "no message")
        raise CompilerError(f"{command[0]} failed with code {done.returncode}: {first}")
    return (folder / name).read_bytes()
