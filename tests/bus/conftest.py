"""For `tools.fuzz`, whose targets the tests hold to what hypothesis comes up with, and for `kernel_links`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).parent.parent / "socketcan"))

from kernel_fixtures import cable, loop  # noqa: F401 - fixtures
