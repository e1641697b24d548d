"""Reference pages of the documentation, made from the code: `python -m tools.reference`, which `make docs` calls."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs/reference"
