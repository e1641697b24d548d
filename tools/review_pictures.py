"""The pictures of docs/how-to/review-in-rerun.md: `python -m tools.review_pictures`. Needs a Vulkan driver."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from hil.bench import assembly
from hil.bench.lockstep_run import simulate
from hil.bench.run_options import RunOptions
from tools.screenshot import layout_of, screenshot

IMAGES = Path(__file__).parents[1] / "docs" / "images"
PICTURES = (("Tanks", 265.0, "rerun-tanks.png"), ("Diagnosis", 253.0, "rerun-diagnosis.png"))
SEED = 7


def main() -> int:
    """Run the scenario leak, and take a picture of each tab."""
    with TemporaryDirectory() as made:
        folder = Path(made) / "leak"
        simulate(assembly.load(Path("leak")), RunOptions(folder, seed=SEED))
        for tab, at_s, name in PICTURES:
            layout = layout_of(folder, tab, Path(made))
            screenshot(folder / "run.rrd", IMAGES / name, at_s=at_s, layout=layout)
    return 0


if __name__ == "__main__":
    sys.exit(main())
