"""Interfaces of the kernel for the tests, and the emulator that serves one of them for a whole session."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.socketcan.kernel_links import Cable, Loop
from tests.socketcan.socketcan_bench import Rig

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "bus")]

from tests.socketcan.kernel_fixtures import cable, loop  # noqa: E402, F401 - fixtures


@pytest.fixture(scope="session")
def rig(cable: Loop | Cable, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:  # noqa: F811 - the fixture
    """The emulator on the far end of the cable."""
    from tests.socketcan.socketcan_bench import emulator

    with emulator(cable.far, tmp_path_factory.mktemp("rig")) as one:
        yield one
