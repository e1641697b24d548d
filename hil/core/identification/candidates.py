"""The extensions of the basic model that records can tell at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hil.core.identification.parameters import BY_NAME, EXTENSIONS, PARAMETERS, Choice, RigModel
from hil.core.identification.records import LevelRecord

RIM_MARGIN_CM = 0.3


def candidates(
    records: Sequence[LevelRecord],
    start: RigModel,
    choices: Mapping[str, Choice],
    structures: Sequence[str] | None,
) -> tuple[str, ...]:
    """The extensions that may be chosen, beside those that are settled. Raises ValueError for an unknown name."""
    for name in structures or ():
        if name not in EXTENSIONS:
            raise ValueError(f"structure {name!r}: must be one of {', '.join(EXTENSIONS)}")
    groups = {row.group for row in PARAMETERS}
    for key in choices:
        if key not in groups and key not in BY_NAME:
            raise ValueError(f"choice for {key!r}: no parameter and no group of that name")
    settled = {BY_NAME[key].group if key in BY_NAME else key for key in choices}
    wanted = EXTENSIONS if structures is None else tuple(structures)
    can_tell = {
        "sensor_gain": any(record.ruler for record in records),
        "overflow": any(_reaches_rim(record, start) for record in records),
    }
    return tuple(
        group for group in wanted if group not in settled and (structures is not None or can_tell.get(group, True))
    )


def _reaches_rim(record: LevelRecord, start: RigModel) -> bool:
    for tank in (2, 3):
        gain, offset_V = start.sensors.gain_V_cm[tank], start.sensors.offset_V[tank]
        level_cm = (record.reading_V[:, tank] - offset_V) / gain
        known = level_cm[np.isfinite(level_cm)]
        if len(known) and float(np.quantile(known, 0.999)) > start.tanks.height_cm[tank] - RIM_MARGIN_CM:
            return True
    return False
