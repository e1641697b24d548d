"""`python -m hil.core.identification` compiles the simulation now and keeps it on disk, so that no fit waits for it."""

from __future__ import annotations

import numpy as np

from hil.core.identification.parameters import RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.simulation import simulate


def compile_ahead() -> None:
    """Compile the simulation, unless that has been done: half a minute."""
    simulate(RigModel(), LevelRecord("two rows", np.array([0.0, 0.1]), np.ones((2, 2)), np.ones((2, 4))))


if __name__ == "__main__":
    compile_ahead()
