"""For `tools.fuzz`, whose targets the tests hold to what hypothesis comes up with."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
