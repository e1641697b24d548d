"""Which steps of a long run are drawn: the recording for the viewer need not have more points than anyone can see.

The text files of the run have every step (docs/decisions/0048-runs-as-tables-and-long-runs.md).
"""

from __future__ import annotations

from math import ceil, isfinite

import numpy as np
import numpy.typing as npt

MAX_STEPS = 100_000
"""Of a recording that has every step: 2.8 h at 10 Hz."""


def coarseness(duration_s: float, period_s: float) -> int:
    """One of so many rows is drawn of a run of this length; 1 for a run whose end is not known (inf)."""
    steps = duration_s / period_s
    return max(ceil(steps / MAX_STEPS), 1) if isfinite(steps) else 1


def extreme_rows(values: npt.NDArray[np.float64], coarser: int) -> npt.NDArray[np.intp]:
    """Rows of (n, m) values that keep the lowest and the highest value of each column in every stretch of rows.

    A stretch is as long as it takes for at most about one row of `coarser` to be kept. The last row is always kept.
    """
    count, columns = values.shape
    if coarser == 1 or count == 0:
        return np.arange(count)
    stretch = (2 * columns + 1) * coarser
    whole = count - count % stretch
    found = [np.array([count - 1])]
    for start, part, length in ((0, values[:whole], stretch), (whole, values[whole:], count - whole)):
        if len(part):
            found.append(start + _extremes(part.reshape(-1, length, columns)))
    return np.unique(np.concatenate(found))


def _extremes(stretches: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
    """First row, lowest and highest of each column in each of (s, length, m) stretches; NaN is neither."""
    count, length, _ = stretches.shape
    lowest = np.argmin(np.where(np.isnan(stretches), np.inf, stretches), axis=1)
    highest = np.argmax(np.where(np.isnan(stretches), -np.inf, stretches), axis=1)
    places = np.hstack([np.zeros((count, 1), dtype=np.intp), lowest, highest])
    rows: npt.NDArray[np.intp] = places + length * np.arange(count)[:, None]
    return rows.ravel()
