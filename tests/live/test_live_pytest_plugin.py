"""The fixtures of the pytest plugin that start an emulator and run on it in real time."""

import pytest

from tests.api.plugin_project import LOADED, SCENARIO, write

pytestmark = pytest.mark.live
pytest_plugins = ("pytester",)

LIVE = """
def test_a_run_on_an_emulator(run, emulator):
    result = run("live.scenario.toml", on=emulator(seed=3), rerun=False)
    assert (result.status, result.manifest.plan.mode) == ("complete", "live")
    assert (result.folder / "kpi.json").is_file()
"""


def test_a_run_on_an_emulator_that_the_fixture_has_started(pytester: pytest.Pytester) -> None:
    write(pytester, live=SCENARIO)
    pytester.makepyfile(test_live=LIVE)
    done = pytester.runpytest_subprocess(*LOADED, "--hil", "test_live.py", timeout=120)
    done.assert_outcomes(passed=1)
