"""The benchmarks page names modules and functions that are there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/reference/benchmarks.md").read_text(encoding="utf-8")


def test_every_function_of_the_profile_is_in_its_module() -> None:
    """Names and line numbers used to be those of modules that have moved."""
    rows = re.findall(r"^\| ((?:hil|firmware_sim)[\w.]*) \| (\w+) \((\w+\.py)\) \|", PAGE, re.MULTILINE)
    assert len(rows) > 20
    for package, function, module in rows:
        folder = ROOT / package.split(".")[0]
        files = [file for file in folder.rglob(module) if package.replace(".", "/") in file.as_posix()]
        assert any(re.search(rf"\bdef {function}\b", file.read_text(encoding="utf-8")) for file in files), (
            f"{package}: {function} ({module})"
        )


def test_the_packages_of_the_profile_are_there() -> None:
    for name in re.findall(r"^\| (hil\.\w+) \|", PAGE, re.MULTILINE):
        path = ROOT / name.replace(".", "/")
        assert path.is_dir() or path.with_suffix(".py").is_file(), name
