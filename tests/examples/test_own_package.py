"""A design, a detector and a control law of an installed package, and the wheel itself in an empty folder."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "docs" / "examples" / "own_package"
PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
OFFLINE = ["--no-deps", "--no-build-isolation", "--no-index"]

SCENARIO = """
[scenario]
name = "own"
duration_s = 8.0

[[fault]]
at_s = 3.0
kind = "pump_effectiveness"
target = 1
value = 0.5

[control]
design = "lqr"

[diagnosis]
method = "innovation"
"""

OWN_LAW = """
[scenario]
name = "own_law"
duration_s = 5.0

[control]
law = "two_pi"
options = {{ gain = {gain} }}
"""


def installed(source: Path, target: Path) -> Path:
    """The package installed into a directory of its own; a copy is built, so that nothing is left beside the source."""
    copy = shutil.copytree(source, target.parent / "source", ignore=shutil.ignore_patterns("__pycache__", "dist"))
    subprocess.run([*PIP, "install", *OFFLINE, "--target", target, copy], check=True)
    return target


@pytest.fixture(scope="module")
def own_package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(PACKAGE, tmp_path_factory.mktemp("own") / "site")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """hil itself, built and installed as a wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in ("hil", "firmware_sim", "config"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    subprocess.run([*PIP, "install", *OFFLINE, "--target", folder / "site", source], check=True)
    return folder / "site"


def run(folder: Path, site: Path, *command: str | Path, columns: str = "100") -> subprocess.CompletedProcess[str]:
    """A command in `folder` that finds packages in `site` first."""
    environment = {**os.environ, "PYTHONPATH": str(site), "COLUMNS": columns}
    return subprocess.run(
        [sys.executable, *map(str, command)], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_a_design_of_an_installed_package_shows_up_in_hil_design(own_package: Path, tmp_path: Path) -> None:
    done = run(tmp_path, own_package, "-m", "hil", "design")
    assert (done.returncode, done.stderr) == (0, "")
    assert "lqr: from the package fourtank-example" in done.stdout
    assert "rig: " in done.stdout


def test_a_scenario_names_the_packages_design_and_detector(own_package: Path, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(SCENARIO)
    done = run(tmp_path, own_package, "-m", "hil", "simulate", "own.toml", "--out", "run", "--no-rerun", "--no-report")
    assert (done.returncode, done.stderr) == (0, "")
    assert '"pump_effectiveness"' in (tmp_path / "run" / "events.jsonl").read_text()


def test_a_scenario_names_the_packages_law_and_its_options(own_package: Path, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(OWN_LAW.format(gain=8.0))
    out = ("--out", "run", "--no-rerun", "--no-report")
    done = run(tmp_path, own_package, "-m", "hil", "simulate", "own.toml", *out)
    assert (done.returncode, done.stderr) == (0, "")
    assert "law_integral_1_V" in (tmp_path / "run" / "ticks.csv").read_text().splitlines()[0].split(",")
    (tmp_path / "own.toml").write_text(OWN_LAW.format(gain=-1.0))
    done = run(tmp_path, own_package, "-m", "hil", "simulate", "own.toml", *out)
    assert done.returncode == 2
    assert done.stderr == "hil: own.toml: control.options.gain = -1.0: must be a number above 0 and at most 100\n"


def test_without_the_package_its_names_are_refused_with_those_that_there_are(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(SCENARIO)
    done = run(tmp_path, tmp_path, "-m", "hil", "simulate", "own.toml", "--out", "run")
    assert done.returncode == 2
    assert done.stderr == "hil: own.toml: control.design = 'lqr': must be one of rig, calibrated\n"


def test_a_package_that_cannot_be_imported_is_named(own_package: Path, tmp_path: Path) -> None:
    broken = shutil.copytree(own_package, tmp_path / "site")
    (broken / "fourtank_example" / "design.py").write_text("import no_such_module\n")
    (tmp_path / "own.toml").write_text(SCENARIO)
    done = run(tmp_path, broken, "-m", "hil", "simulate", "own.toml", "--out", "run")
    assert done.returncode == 2
    assert "package fourtank-example" in done.stderr
    assert "No module named 'no_such_module'" in done.stderr
    listed = run(tmp_path, broken, "-m", "hil", "design")
    assert listed.returncode == 0, "the designs of hil are shown all the same"
    assert "not available" in listed.stdout
    assert "\nrig: " in listed.stdout


TEN_LINES = """\
import hil
import numpy as np
from scipy.linalg import solve_continuous_are
class Lqr:
    follows_reference = True
    def gains(self, linear):
        A = np.block([[linear.A, np.zeros((4, 2))], [-linear.C, np.zeros((2, 2))]])
        B = np.vstack([linear.B, np.zeros((2, 2))])
        return hil.Gains.from_matrix(B.T @ solve_continuous_are(A, B, 0.1 * np.eye(6), np.eye(2)))
print(hil.__file__, hil.simulate("paper", design=Lqr()).iae_Vs["reference_step"])
"""


def test_a_script_of_ten_lines_runs_in_an_empty_folder_with_the_wheel(wheel: Path, tmp_path: Path) -> None:
    assert len(TEN_LINES.splitlines()) == 10
    script = tmp_path / "script.py"
    script.write_text(TEN_LINES)
    done = run(tmp_path, wheel, script)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(str(wheel))
    first, second = (float(number.strip("()\n")) for number in done.stdout.split(" ", 1)[1].split(","))
    assert 1.0 < first < 20.0
    assert 1.0 < second < 20.0
    assert [path.name for path in tmp_path.iterdir()] == ["script.py"], "the record stayed in memory"


def test_the_wheel_knows_its_scenarios_by_name(wheel: Path, tmp_path: Path) -> None:
    """`hil simulate paper` in an empty folder used to end with "can't be read"."""
    out = ("--out", "run", "--duration", "5", "--no-rerun", "--no-report")
    done = run(tmp_path, wheel, "-m", "hil", "simulate", "paper", *out)
    assert done.returncode == 0
    assert done.stderr.startswith("hil: WARNING: the run ends at 5 s, before these faults begin: ")
    assert done.stderr.count("\n") == 1
    assert (tmp_path / "run" / "kpi.json").is_file()
    rig = run(tmp_path, wheel, "-m", "hil", "design", "--rig", "johansson_minus")
    assert (rig.returncode, rig.stderr) == (0, "")
    version = run(tmp_path, wheel, "-m", "hil", "--version")
    assert version.stdout.startswith("hil ")
    unknown = run(tmp_path, wheel, "-m", "hil", "simulate", "papier")
    assert unknown.returncode == 2
    assert (
        "papier: no such file, and no shipped name; shipped scenarios: hold, leak, paper, paper_glr" in unknown.stderr
    )
