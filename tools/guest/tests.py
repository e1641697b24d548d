"""The tests that need AF_CAN, found by their marker without importing all others, which would take minutes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

MARK = "mark.socketcan"


def command(root: Path, options: list[str]) -> list[str]:
    """The pytest command for every test marked socketcan below root, in one process, without plugins."""
    files = sorted(str(one.relative_to(root)) for one in root.glob("tests/**/test_*.py") if MARK in one.read_text())
    without_plugins = ["env", "PYTEST_DISABLE_PLUGIN_AUTOLOAD=1"]  # importing plugins takes longer than the tests
    return [
        *without_plugins,
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "-m",
        "socketcan and not long",
        *options,
        *files,
    ]


def run_here(arguments: list[str]) -> int:
    """Run them on this host."""
    return subprocess.run(arguments, check=False).returncode
