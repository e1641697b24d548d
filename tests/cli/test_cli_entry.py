"""Ways to start the command beside its console script."""

import subprocess
import sys
from pathlib import Path

import hil


def test_python_dash_m_hil_is_the_command(tmp_path: Path) -> None:
    """`python -m hil` used to fail: the package had no `__main__`."""
    done = subprocess.run(
        [sys.executable, "-m", "hil", "--version"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == f"hil {hil.__version__}\n"
