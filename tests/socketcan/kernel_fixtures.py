"""Fixtures of kernel interfaces, for every folder whose tests use them."""

import os
from collections.abc import Iterator
from typing import TypeVar

import pytest

from tests.socketcan.kernel_links import Cable, Loop
from tools.guest.host import obstacle

L = TypeVar("L", Loop, Cable)


def _links(kind: type[L]) -> L:
    reason = obstacle()
    if reason:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"{reason} (make test-socketcan finds another)")
    return kind()


@pytest.fixture(scope="session")
def loop() -> Iterator[Loop]:
    """A vcan interface, both of whose ends are the same."""
    links = _links(Loop)
    yield links
    links.remove()


@pytest.fixture(scope="session")
def cable() -> Iterator[Cable]:
    """Two interfaces wired to one another: in the guest two controllers, elsewhere a vxcan."""
    links = _links(Cable)
    yield links
    links.remove()
