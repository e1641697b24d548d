"""For `kernel_links`, and its fixtures."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "socketcan"))

from kernel_fixtures import cable, loop  # noqa: F401 - fixtures
