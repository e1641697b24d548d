"""How many readings by a ruler: `python -m tools.identification_study.readings --seeds 10 --first-seed 11 [--wire]`.

For each drawn rich rig the information of its records, near the true values, and that of its ten readings by a ruler,
which counts n/10 times for n readings of the same kind (or 10 with an error of sqrt(10/n) mm). From the covariance: the
standard deviations of k, gamma and a, and how often all eight are within 0.5 % of the truth.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from hil.core.identification.estimate import estimate
from hil.core.identification.intervals import scaled_inverse
from hil.core.identification.parameters import RigModel, values_of, with_values
from hil.core.identification.unknowns import FREE
from tools.identification_study.cases import STRUCTURES, CaseSpec, file_of, records_of
from tools.identification_study.tables import GAINS
from tools.identification_study.truth import RULER_SHARES, Truth

Array = NDArray[np.float64]

COUNTS = (1, 2, 4, 6, 8, 10, 12, 16, 24)
LIMIT = 0.005
DRAWS = 20_000


def true_model(truth: Truth) -> RigModel:
    """The rig as a model of the identification."""
    file = file_of(truth)
    return with_values(file, {name: truth.value(name) for name in values_of(file)})


def information_of(spec: CaseSpec) -> tuple[Array, Array, Array]:
    """Information (p, p) of the records and of the ruler's readings, and what picks the relative errors: (8, p)."""
    truth = spec.truth()
    records, _ = records_of(spec, truth)
    found = estimate(records, true_model(truth), dict.fromkeys(STRUCTURES["rich"], FREE))
    at = [found.names.index(name) for name in GAINS]
    pick = np.zeros((len(GAINS), len(found.names)))
    pick[np.arange(len(at)), at] = 1.0 / np.array([truth.value(name) for name in GAINS])
    return found.normal.information - found.normal.ruler, found.normal.ruler, pick


def covariance_of(parts: tuple[Array, Array, Array], readings: int) -> Array:
    """(8, 8) of the relative errors with so many readings."""
    records, ruler, pick = parts
    total: Array = pick @ scaled_inverse(records + ruler * readings / len(RULER_SHARES)) @ pick.T
    return total


def row(rigs: Sequence[tuple[Array, Array, Array]], readings: int) -> tuple[str, ...]:
    """Ranges of the standard deviations over the rigs, and the share of experiments within the limit."""
    covariances = [covariance_of(parts, readings) for parts in rigs]
    sd = np.sqrt([np.diag(one) for one in covariances])
    random = np.random.default_rng(1)
    shares = [
        float(np.mean(np.abs(random.multivariate_normal(np.zeros(len(GAINS)), one, DRAWS)).max(axis=1) <= LIMIT))
        for one in covariances
    ]
    groups = [sd[:, [i for i, name in enumerate(GAINS) if name[:-1] == group]] for group in ("k", "gamma", "a")]
    ranges = [f"{100.0 * group.min():.2f} to {100.0 * group.max():.2f} %" for group in groups]
    return str(readings), *ranges, f"{100.0 * np.mean(shares):.0f} %", f"{100.0 * np.min(shares):.0f} %"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tools.identification_study.readings", description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=11)
    parser.add_argument("--wire", action="store_true", help="the full experiment of hil identify --emulator")
    options = parser.parse_args()
    rigs = []
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        rigs.append(information_of(CaseSpec("rich", seed, is_wire=options.wire)))
        print(f"seed {seed}", flush=True)
    table = Table(title=f"standard deviations on {len(rigs)} rich rigs")
    for name in ("readings", "k", "gamma", "a", "all within 0.5 %", "on the worst rig"):
        table.add_column(name, justify="right")
    for readings in COUNTS:
        table.add_row(*row(rigs, readings))
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
