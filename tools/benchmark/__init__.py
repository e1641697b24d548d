"""Timings, as ratios where there is something to compare with: `python -m tools.benchmark [--write] [--quick]`.

Alternatives run in turns within one process, round by round, so that a busy machine slows all of them equally. A figure
is the median over the rounds, with the lowest one beside it; a ratio is the median of the rounds' own ratios.
"""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCENARIO = ROOT / "config/scenarios/paper_glr.toml"
"""The scenario that is measured, unless a table says otherwise: the paper's experiment with the full diagnosis."""
