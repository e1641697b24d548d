"""`python -m tools.benchmark.identify --cascaded-tanks FILE`: the engine of `hil identify` on a real record."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tools.benchmark.cascaded_tanks import STRUCTURES, DataError, Result, best, load

IN_PRINT = "In print, predicted half: best linear model 0.75 V, nonlinear state space 0.34 to 0.45 V."
INITIAL = (
    "The initial levels of the predicted half are fitted to its first 120 s, as in the literature on this record; "
    "no parameter sees it."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser("python -m tools.benchmark.identify", description=__doc__)
    parser.add_argument(
        "--cascaded-tanks", type=Path, metavar="FILE", help="the public record, CSV with uEst, yEst, uVal, yVal"
    )
    options = parser.parse_args(arguments)
    if options.cascaded_tanks is None:
        print("nothing to do: give the record with --cascaded-tanks FILE; it is not part of the project")
        return 0
    try:
        estimation, test = load(options.cascaded_tanks)
    except (DataError, OSError) as error:
        print(f"tools.benchmark.identify: {error}", file=sys.stderr)
        return 2
    table = Table(title="cascaded tanks: RMSE of the simulation, V", title_justify="left")
    for name in ("structure", "fitted half", "predicted half", "s"):
        table.add_column(name)
    results = {}
    for structure in STRUCTURES:
        begin_s = time.perf_counter()
        results[structure] = found = best(estimation, test, structure)
        seconds = f"{time.perf_counter() - begin_s:.0f}"
        table.add_row(structure, f"{found.rmse_V:.3f}", f"{found.test_rmse_V:.3f}", seconds)
    console = Console(width=max(Console().width, 100))
    console.print(table, IN_PRINT, INITIAL, "", sep="\n", highlight=False)
    chosen = min(results, key=lambda structure: results[structure].rmse_V)
    console.print(f"Chosen by the fitted half: {chosen}.", highlight=False)
    console.print(values(results[chosen]), highlight=False)
    return 0


def values(result: Result) -> str:
    """The values of a fit in one line."""
    named = ", ".join(f"{name} {value:.4g}" for name, value in zip(result.names, result.values, strict=True))
    return f"{named}, rim of tank 3 {result.height_cm:g} cm"


if __name__ == "__main__":
    sys.exit(main())
