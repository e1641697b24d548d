"""For `faults_bench`, and the benches of bus and live tests that the same faults are played on."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), *(str(HERE.parent / name) for name in ("bus", "live", "wire", "safety", "cli"))]
