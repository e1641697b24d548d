"""How far the parameters of a rig have moved from its file, by the record of an ordinary run.

Gains, splits, outlets and lags are estimated from the record (`estimate`), each with a wide prior around its value in
the file. The prior holds what the record does not determine: a run at rest shows the levels that its voltages hold,
four combinations of the parameters, and nothing of each alone. A parameter counts as determined only if the record has
made its standard deviation a tenth of the prior's. Waves and turbulence are part of the estimate's noise model, so
that a lively rig determines less.

Why: `docs/decisions/0033-is-the-file-still-right.md`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from hil.core.identification.parameters import PARAMETERS, Choice, RigModel, values_of
from hil.core.identification.records import LevelRecord
from hil.core.uncertainty import Uncertainty

Array = NDArray[np.float64]

CHECKED = ("k", "gamma", "a")
"""The groups that are reported."""
PRIOR = 0.1
"""One standard deviation of the prior of a gain, split or outlet, as a share of the file's value."""
DETERMINED = 0.1
"""A determined parameter has at most this share of the prior's standard deviation left."""
LAG_PRIOR = 0.5
MIN_MOVE_V = 0.2
"""A run whose voltages stay within so much is not looked at: it is at rest."""
MIN_DURATION_S = 60.0


@dataclass(frozen=True, slots=True)
class Moved:
    """A parameter that a run determines.

    file, estimate, sd : in its unit. file_sd : how far the rig may be off its file, by the file itself. shift_sd : the
    move in standard deviations of both.
    """

    name: str
    file: float
    estimate: float
    sd: float
    file_sd: float

    @property
    def shift_sd(self) -> float:
        """(estimate - file) in standard deviations."""
        return (self.estimate - self.file) / hypot(self.sd, self.file_sd)

    @property
    def share(self) -> float:
        """(estimate - file) relative to the file's value."""
        return self.estimate / self.file - 1.0


@dataclass(frozen=True, slots=True)
class Drift:
    """What a run says about the file. moved : determined parameters, in the order of `PARAMETERS`.

    undetermined : names of the others. why : for which reason none is determined, "" otherwise.
    """

    moved: tuple[Moved, ...]
    undetermined: tuple[str, ...]
    why: str = ""

    def __getitem__(self, name: str) -> Moved:
        return next(one for one in self.moved if one.name == name)


ALL_CHECKED = tuple(row.name for row in PARAMETERS if row.group in CHECKED)


def drift_of(record: LevelRecord, file: RigModel, uncertainty: Uncertainty) -> Drift:
    """Compare a record with the file's model. uncertainty : of the file, as shares."""
    why = _too_little(record)
    if why:
        return Drift((), ALL_CHECKED, why)
    from hil.core.identification.estimate import estimate  # compiled code: a short run need not load it

    was = values_of(file)
    choices = {name: Choice("prior", PRIOR * was[name]) for name in ALL_CHECKED}
    for lag in ("lag1", "lag2"):
        choices[lag] = Choice("prior", LAG_PRIOR * was[lag]) if was[lag] > 0.0 else Choice("fixed")
    found = estimate((record,), file, choices, near={})
    values = dict(zip(found.names, found.values.tolist(), strict=True))
    sd = dict(zip(found.names, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
    shares = _shares(uncertainty)
    moved = tuple(
        Moved(name, was[name], values[name], sd[name], shares[name] * was[name])
        for name in ALL_CHECKED
        if sd[name] <= DETERMINED * PRIOR * was[name]
    )
    names = {one.name for one in moved}
    undetermined = tuple(name for name in ALL_CHECKED if name not in names)
    return Drift(moved, undetermined, "" if moved else "the run's movement determines none of them alone")


def _too_little(record: LevelRecord) -> str:
    if record.time_s[-1] - record.time_s[0] < MIN_DURATION_S:
        return f"less than {MIN_DURATION_S:g} s without a fault"
    if float(np.ptp(record.voltage_V, axis=0).max()) < MIN_MOVE_V:
        return f"no pump was moved by {MIN_MOVE_V:g} V"
    return ""


def _shares(uncertainty: Uncertainty) -> dict[str, float]:
    values = (*uncertainty.pump_gain, *uncertainty.valve_split, *uncertainty.outlet)
    return dict(zip(ALL_CHECKED, values, strict=True))


def rate_per_hour(hours: Array, estimates: Array, sds: Array) -> tuple[float, float]:
    """Slope of estimates over time with its standard deviation, per hour, by weighted least squares; two or more."""
    weight = sds**-2.0
    centre = float((weight * hours).sum() / weight.sum())
    spread = float((weight * (hours - centre) ** 2).sum())
    return float((weight * (hours - centre) * estimates).sum() / spread), 1.0 / sqrt(spread)
