"""What the picture of the tanks has to know of the rig. Small to import: it is handed to the recorder's process."""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.pumps import STRAIGHT, PumpPath
from hil.core.tanks import TankModel


@dataclass(frozen=True)
class PictureModel:
    """The rig in the picture. level_max_cm : where the high-level interlock trips; None: not drawn."""

    tanks: TankModel
    pumps: PumpPath = STRAIGHT
    level_max_cm: float | None = None
