"""The pytest plugin: off unless asked for with `--hil` or `hil_scenarios = true` in pytest's settings.

It then collects `*.scenario.toml`, one test for each limit, and gives the fixtures of `hil.testing.fixtures`. pytest
loads this module in every project of an environment where `hil` is installed, so it imports nothing by itself.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest

SUFFIX = ".scenario.toml"
INI = "hil_scenarios"


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options."""
    group = parser.getgroup("hil", "four-tank bench")
    group.addoption("--hil", action="store_true", help=f"collect *{SUFFIX} as tests, and give the fixtures of hil")
    group.addoption("--hil-seed", type=_seed, default=1, metavar="N", help="seed of the emulator's noise (default: 1)")
    group.addoption(
        "--hil-rig", metavar="RIG", help="a rig file, or the name of a shipped one, for collected scenarios"
    )
    group.addoption("--hil-out", metavar="DIR", help="folder for the run folders and reports of collected scenarios")
    parser.addini(INI, f"collect *{SUFFIX} as tests, and give the fixtures of hil", type="bool", default=False)


def _seed(text: str) -> int:
    """Raise ValueError, which pytest names with the option."""
    if not text.isdecimal():
        raise ValueError(text)
    return int(text)


def pytest_configure(config: pytest.Config) -> None:
    """Load the fixtures, if asked for."""
    if is_asked_for(config):
        config.pluginmanager.register(import_module("hil.testing.fixtures"), "hil_fixtures")


def is_asked_for(config: pytest.Config) -> bool:
    """Whether the plugin is on."""
    return bool(config.getoption("--hil") or config.getini(INI))


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """A scenario's file, if asked for."""
    if not file_path.name.endswith(SUFFIX) or not is_asked_for(parent.config):
        return None
    from hil.testing.scenario_items import ScenarioFile

    return ScenarioFile.from_parent(parent, path=file_path)
