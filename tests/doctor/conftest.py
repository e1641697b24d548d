"""For `doctor_bench`, and the benches of live and command-line tests."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), *(str(HERE.parent / name) for name in ("live", "cli"))]
