"""The pytest plugin in a temporary project: scenarios as tests, fixtures, and nothing unless it is asked for."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.api.plugin_project import LOADED, PLUGIN, SCENARIO, write

pytest_plugins = ("pytester",)

PYPROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"

FIXTURES = """
def test_a_run_in_lockstep(run):
    result = run("short.scenario.toml", seed=2)
    assert result.status == "complete"
    assert result.kpi.skipped == 0

def test_a_bench(bench):
    assert bench("paper").scenario.scenario.name == "paper"
    assert bench("short.scenario.toml").scenario.scenario.length_s == 2.0
"""


class KeptModules:
    """In place of pytester's snapshot of `sys.modules`: only tests are forgotten: numpy can't be loaded twice."""

    def __init__(self, preserve: object = None) -> None:
        del preserve

    def restore(self) -> None:
        for name in [name for name in sys.modules if name.startswith("test_inner")]:
            del sys.modules[name]


@pytest.fixture(autouse=True)
def _libraries_stay_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("_pytest.pytester.SysModulesSnapshot", KeptModules)


def test_the_entry_point_is_declared() -> None:
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    assert project["entry-points"]["pytest11"] == {"fourtank_hil": PLUGIN}


def test_it_costs_nothing_at_import() -> None:
    """pytest loads it in every project of the environment."""
    heavy = "{'numpy', 'can', 'pydantic', 'numba', 'typer', 'pandas', 'pytest', 'hil.bench', 'hil.review'}"
    code = f"import sys, {PLUGIN}; print(sorted(set(sys.modules) & {heavy}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_it_is_off_unless_asked_for(pytester: pytest.Pytester) -> None:
    write(pytester, short=SCENARIO)
    pytester.makepyfile(
        test_inner_off="def test_one(request): assert not request.config.pluginmanager.has_plugin('hil_fixtures')"
    )
    pytester.runpytest_inprocess(*LOADED).assert_outcomes(passed=1)


def test_each_limit_is_a_test_and_a_broken_one_shows_value_limit_and_time(pytester: pytest.Pytester) -> None:
    write(pytester, short=SCENARIO)
    (pytester.path / "other.toml").write_text(SCENARIO)
    pytester.makepyfile(test_inner_fixtures=FIXTURES)
    done = pytester.runpytest_inprocess(*LOADED, "--hil", "-v", "--junit-xml=out.xml")
    done.assert_outcomes(passed=4, failed=1)
    done.stdout.fnmatch_lines(["*short.scenario.toml::no trip PASSED*", "*short.scenario.toml::dry tanks FAILED*"])
    done.stdout.re_match_lines([r"dry tanks: 1\d\.\d+ cm; limit: at most 0\.1 cm; when: \d\.\d s"])
    assert 'name="limit" value="at most 0.1 cm"' in (pytester.path / "out.xml").read_text()


@pytest.mark.long
def test_settings_ask_for_it_and_a_run_folder_is_kept(pytester: pytest.Pytester) -> None:
    write(pytester, short=SCENARIO)
    pytester.makefile(".ini", pytest="[pytest]\nhil_scenarios = true\n")
    done = pytester.runpytest_inprocess(*LOADED, "--hil-out=runs", "-k", "trip or end")
    done.assert_outcomes(passed=2)
    assert (pytester.path / "runs" / "short" / "kpi.json").is_file()


def test_a_scenario_that_can_not_be_used_is_one_line(pytester: pytest.Pytester) -> None:
    bad = SCENARIO.replace("no_trip = true", "no_trip = 3")
    write(pytester, bad=bad, endless=SCENARIO.replace("2.0", '"open"'))
    done = pytester.runpytest_inprocess(*LOADED, "--hil")
    done.assert_outcomes(errors=2)
    done.stdout.re_match_lines([r".*bad\.scenario\.toml: accept.*no_trip.*"])
    assert "Traceback" not in done.stdout.str()
