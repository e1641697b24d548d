"""Timings, as ratios wherever there is something to compare with: `python -m tools.benchmark [--write] [--quick]`.

What is compared takes turns within one process, round by round, so that a busy machine slows both alike. A figure is
the median over the rounds with the lowest beside it; a ratio is the median of the rounds' own ratios.
"""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCENARIO = ROOT / "config/scenarios/paper_glr.toml"
"""What is measured, but where a table says otherwise: the paper's experiment with the full diagnosis."""
