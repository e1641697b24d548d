"""The mutation tool: what it draws, and that it tells a mutant that a test kills from one that survives."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tools.mutants import __main__ as mutants
from tools.mutants.generate import sites_of
from tools.mutants.sample import MUST_BE_COMPLETE, ROOMS, draw, modules_of, target_of

ROOT = Path(__file__).resolve().parents[2]
MODULE = '''"""Two limits."""

LIMIT = 5


def is_over(value):
    return value > LIMIT


def is_under(value):
    return value < 0
'''
TEST = """from hil.limits import is_over


def test_the_limit_itself_is_not_over_it():
    assert is_over(6)
    assert not is_over(5)
"""
SCRIPT = """
import sys
from pathlib import Path
from tools.mutants.__main__ import judge
from tools.mutants.generate import mutants_of
from tools.mutants.run import Target

target = Target(Path(sys.argv[1]), "hil.limits", ("tests/toy/test_limits.py",))
work = [(target, mutant) for mutant in mutants_of(target.path)]
accepted = {("hil.limits", *key.split(" -> ")) for key in sys.argv[2:]}
sys.exit(0 if judge("toy", work, 2, accepted, is_complete=True) else 1)
"""
SURVIVORS = ["return value < 0 -> return value <= 0", "return value < 0 -> return value >= 0"]
SURVIVORS += ["return value < 0 -> return value < 1", "return value < 0 -> return value < -1"]


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    """A project with one module and one test, which looks at the first function alone."""
    for folder in ("hil", "tests/toy"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "__init__.py").touch()
    (tmp_path / "tests/__init__.py").touch()
    (tmp_path / "hil/limits.py").write_text(MODULE)
    (tmp_path / "tests/toy/test_limits.py").write_text(TEST)
    (tmp_path / "pyproject.toml").write_text("[tool.pytest.ini_options]\nmarkers = ['live', 'long', 'socketcan']\n")
    return tmp_path


def judged(toy: Path, *accepted: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", SCRIPT, str(toy), *accepted]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


def test_a_survivor_is_named_with_its_line_before_and_after(toy: Path) -> None:
    done = judged(toy)
    assert done.returncode == 1, done.stderr
    assert "0 accepted survivors, 4 unlisted" in done.stdout
    assert "survived: hil.limits:11 " in done.stdout
    assert "      - return value < 0\n      + return value <= 0\n" in done.stdout
    assert "return value > LIMIT" not in done.stdout


@pytest.mark.long
def test_accepted_survivors_pass_and_an_entry_that_does_not_survive_fails(toy: Path) -> None:
    done = judged(toy, *SURVIVORS)
    assert (done.returncode, "4 accepted survivors, 0 unlisted" in done.stdout) == (0, True), done.stdout
    done = judged(toy, *SURVIVORS, "return value > LIMIT -> return value >= LIMIT")
    assert done.returncode == 1
    assert "accepted, but did not survive: hil.limits: return value > LIMIT" in done.stdout


@pytest.mark.long
def test_a_test_that_fails_without_any_change_kills_nothing(toy: Path) -> None:
    (toy / "tests/toy/test_limits.py").write_text(TEST.replace("is_over(6)", "is_over(4)"))
    done = judged(toy)
    assert done.returncode == 1
    assert "fails without any change: tests/toy/test_limits.py::test_the_limit_itself_is_not_over_it" in done.stderr


NAMED = """
import sys
import pytest
from tools.mutants.run import OnlyThese

class Seen:
    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_pycollect_makeitem(self, name):
        made = yield
        if made:
            print("made", name)
        return made

named = [sys.argv[1] + "::" + test for test in sys.argv[2:]]
sys.exit(pytest.main(["-s", "-p", "no:cacheprovider", *named], [OnlyThese(named), Seen()]))
"""
THREE = """import pytest

@pytest.mark.parametrize("x", [1, 2])
def test_a(x): pass
def test_b(): raise ValueError("not asked for")
class TestC:
    def test_a(self): pass
    def test_c(self): raise ValueError("not asked for")
"""


def test_of_tests_named_one_by_one_these_run_and_other_functions_are_not_even_made(tmp_path: Path) -> None:
    (tmp_path / "test_three.py").write_text(THREE)
    command = [sys.executable, "-c", NAMED, "test_three.py", "test_a[2]", "TestC::test_a"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    made = {line for line in done.stdout.splitlines() if line.startswith("made ")}
    assert made == {"made test_a", "made TestC", "made test_c"}, done.stdout
    assert "2 passed" in done.stdout


def test_a_change_elsewhere_in_a_module_does_not_move_the_draw(toy: Path) -> None:
    module = toy / "hil/limits.py"
    before = {site.rank for site in sites_of(module, "hil.limits", 3)}
    assert before.isdisjoint({site.rank for site in sites_of(module, "hil.limits", 4)})
    module.write_text(MODULE.replace("LIMIT = 5\n", "LIMIT = 5\nOTHER = 1\n"))
    assert before < {site.rank for site in sites_of(module, "hil.limits", 3)}


@pytest.mark.parametrize("name", ROOMS)
def test_every_room_has_modules_and_tests_that_name_them_first(name: str) -> None:
    modules = modules_of(ROOT, ROOMS[name])
    assert modules
    assert MUST_BE_COMPLETE.isdisjoint(modules)
    for module in modules:
        target = target_of(ROOT, ROOMS[name], module)
        assert target.path.is_file()
        assert target.tests
        assert all((ROOT / test).is_file() for test in target.tests)
    tests = target_of(ROOT, ROOMS["emulator"], "firmware_sim.parameter_spread").tests
    assert tests[0] == "tests/firmware_sim/test_sim_draw.py"


def test_every_accepted_mutant_has_a_reason_and_its_line_is_still_there(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entries = tomllib.loads(mutants.ACCEPTED.read_text())["mutant"]
    assert all(entry["reason"] for entry in entries)
    assert all(entry["before"] in (ROOT / f"{entry['module'].replace('.', '/')}.py").read_text() for entry in entries)
    outdated = tmp_path / "accepted.toml"
    outdated.write_text('[[mutant]]\nmodule = "hil.loop"\nbefore = "no such line"\nafter = "x"\nreason = "none"\n')
    monkeypatch.setattr(mutants, "ACCEPTED", outdated)
    assert mutants.main(["--sample", "1"]) == 1
    assert capsys.readouterr().out == "accepted, but the line is no longer there: hil.loop: no such line\n"


def test_the_same_seed_draws_the_same_mutants() -> None:
    first, again = (draw(ROOT, ["loop"], 5, 2) for _ in range(2))
    assert first == again
    assert len(first) == 5
    assert first != draw(ROOT, ["loop"], 5, 3)
