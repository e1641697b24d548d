"""Every script of docs/examples runs, on the public face alone, and says what its text promises."""

import re
import runpy
from collections.abc import Callable
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


@pytest.fixture
def run_example(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[str], str]:
    monkeypatch.chdir(tmp_path)

    def run(name: str) -> str:
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        return capsys.readouterr().out

    return run


@pytest.mark.long
def test_simulate_and_plot(run_example: Callable[[str], str], tmp_path: Path) -> None:
    out = run_example("simulate_and_plot")
    assert "paper: complete" in out
    assert re.search(r"IAE gain_fall: 0\.3\d\d, 0\.2\d\d V s", out)
    assert "<svg" in (tmp_path / "paper.svg").read_text()


@pytest.mark.long
def test_fault_and_report(run_example: Callable[[str], str], tmp_path: Path) -> None:
    out = run_example("fault_and_report")
    assert "played:   pump_effectiveness 1 = 0.4 at 200.0 s" in out
    assert "reported: pump_effectiveness 1" in out
    assert "200.2" in out
    assert "<html" in (tmp_path / "pump_loss.html").read_text()


@pytest.mark.long
def test_an_lqr_as_a_design_of_ones_own(run_example: Callable[[str], str]) -> None:
    out = run_example("lqr_design")
    figures = dict(re.findall(r"^(\w+) +IAE ([0-9.]+)", out, re.MULTILINE))
    assert set(figures) == {"rig", "LqrDesign"}
    assert float(figures["LqrDesign"]) < 10.0, "it controls: without control this window comes to more than 40 V s"


@pytest.mark.long
def test_a_detector_of_ones_own(run_example: Callable[[str], str]) -> None:
    out = run_example("own_detector")
    reported = re.findall(r"pump_effectiveness (\d) reported at ([0-9.]+) s", out)
    assert [pump for pump, _ in reported] == ["1", "2"]
    assert all(200.0 < float(at_s) < 202.0 for _, at_s in reported)
    assert re.search(r"1\.00 before, 0\.(3[89]|4[012]) a minute after", out)


@pytest.mark.long
def test_a_control_law_of_ones_own(run_example: Callable[[str], str]) -> None:
    """Two PI controllers follow steps, though later than the state feedback with its feedforward, and nothing trips."""
    out = run_example("own_law")
    errors = re.findall(r"^[a-zA-Z ]+: complete, IAE ([0-9.]+), ([0-9.]+) V s", out, re.MULTILINE)
    assert len(errors) == 2
    ours, two_pi = ([float(error) for error in pair] for pair in errors)
    assert all(0.0 < error < 1.0 for error in ours)
    assert all(1.0 < error < 4.0 for error in two_pi)


@pytest.mark.long
def test_a_small_campaign(run_example: Callable[[str], str]) -> None:
    out = run_example("small_campaign")
    assert "pump_effectiveness 1 = 0.4: 100% found" in out
    assert "broken invariants: 0" in out


@pytest.mark.long
def test_the_exported_plant_beside_the_emulator(run_example: Callable[[str], str], tmp_path: Path) -> None:
    out = run_example("plant_elsewhere")
    samples, difference_cm = re.findall(r"^(\d+) samples, largest difference of a level: (\S+) cm$", out, re.MULTILINE)[
        0
    ]
    assert int(samples) > 5000
    assert float(difference_cm) < 1e-6
    assert "<svg" in (tmp_path / "plant_elsewhere.svg").read_text()


@pytest.mark.parametrize("file", sorted(EXAMPLES.rglob("*.py")), ids=lambda file: file.stem)
def test_examples_use_the_public_face_alone(file: Path) -> None:
    text = file.read_text()
    assert not re.search(r"\b(from|import) (hil\.|firmware_sim)", text)
    assert not re.search(r"from hil import", text), "as `import hil`, so that a reader sees what is of the bench"
