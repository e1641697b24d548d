"""A temporary project with scenarios, for tests of the pytest plugin."""

from importlib.metadata import entry_points

import pytest

PLUGIN = "hil.testing.pytest_plugin"
IS_INSTALLED = any(entry.value == PLUGIN for entry in entry_points(group="pytest11"))
LOADED = () if IS_INSTALLED else ("-p", PLUGIN)
"""Options for an environment that was made before the plugin was."""

SCENARIO = """[scenario]
name = "short"
duration_s = 2.0

[[accept]]
name = "no trip"
no_trip = true

[[accept]]
name = "dry tanks"
level_max_cm = 0.1
"""


def write(pytester: pytest.Pytester, **scenarios: str) -> None:
    for name, text in scenarios.items():
        (pytester.path / f"{name}.scenario.toml").write_text(text)
