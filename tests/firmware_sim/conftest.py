"""What several files of the emulator's tests share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.firmware_sim.fmu_bench import UnitFile


@pytest.fixture(scope="session")
def unit(tmp_path_factory: pytest.TempPathFactory) -> UnitFile:
    """The co-simulation unit of emulator.toml; other rigs are made of it by its parameters."""
    from tests.firmware_sim.fmu_bench import UnitFile
    from tests.firmware_sim.sim_bench import shipped

    return UnitFile.made(shipped(), tmp_path_factory.mktemp("unit"))
