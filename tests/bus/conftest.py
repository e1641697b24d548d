"""For `tools.fuzz`, whose targets the tests hold to what hypothesis comes up with, and for `kernel_links`."""

from tests.socketcan.kernel_fixtures import cable, loop  # noqa: F401 - fixtures
