"""Interfaces of the kernel for the tests, and the emulator that serves one of them for a whole session."""

from collections.abc import Iterator

import pytest

from tests.socketcan.kernel_fixtures import cable, loop  # noqa: F401 - fixtures
from tests.socketcan.kernel_links import Cable
from tests.socketcan.socketcan_bench import Rig


@pytest.fixture(scope="module")
def rig(cable: Cable, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:  # noqa: F811 - the fixture
    """The emulator on the far end of the cable."""
    from tests.socketcan.socketcan_bench import emulator

    with emulator(cable.far, tmp_path_factory.mktemp("rig")) as one:
        yield one
