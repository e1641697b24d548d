"""The Makefile names modules; a name that is gone would measure nothing."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

MAKEFILE = Path(__file__).resolve().parents[2] / "Makefile"


def test_every_module_whose_coverage_is_demanded_exists() -> None:
    """After a renaming, coverage.py only warned that the module was never imported: its lines counted no longer."""
    listed = re.search(r"addprefix --cov=hil\.,([^)]*)\)", MAKEFILE.read_text(encoding="utf-8"))
    assert listed is not None
    names = listed.group(1).split()
    assert len(names) == 8
    for name in names:
        assert find_spec(f"hil.{name}") is not None, name
