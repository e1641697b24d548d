"""Reference pages of the documentation, made from the code: `python -m tools.reference`, which `make docs` calls.

Reasons: docs/decisions/0019-documentation-by-zensical.md.
"""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs/reference"
