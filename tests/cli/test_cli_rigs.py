"""`--rig` of every command: a rig by name or file for the controller, and for the emulator where there is one."""

import json
from pathlib import Path
from runpy import run_path

import pytest

import hil
from hil.bench.emulator_twin import emulator_of
from hil.core.gain_design import GainDesign
from hil.edge.config.shipped import RIGS, shipped_names
from hil.edge.record.run_folder import RunFolder
from tests.cli.cli_bench import CONFIG, ROOT, CommandLine, assert_refused, scenario_text

SHIPPED = ("decenter2021", "johansson_minus", "johansson_plus")


def lqr_example() -> GainDesign:
    """The design of docs/examples/lqr_design.py."""
    design: GainDesign = run_path(str(ROOT / "docs" / "examples" / "lqr_design.py"))["LqrDesign"]()
    return design


def rig_file(folder: Path) -> Path:
    """A rig with weaker pumps: 3 V hold lower levels."""
    text = (CONFIG / "rig.toml").read_text()
    file = folder / "weak.toml"
    file.write_text(text.replace("gain_cm3_Vs = [3.33, 3.35]", "gain_cm3_Vs = [3.0, 3.1]"))
    return file


def test_the_shipped_rigs_are_found_by_name() -> None:
    assert shipped_names(RIGS) == SHIPPED


def test_the_emulator_is_the_rig_and_begins_at_its_operating_point(tmp_path: Path) -> None:
    """A rig given to `hil.load` used to be known to the controller only; the emulator stayed the shipped one."""
    bench = hil.load("rest", rig=rig_file(tmp_path))
    emulator = emulator_of(bench, 1)
    assert emulator.parameters.pumps.gain_cm3_Vs == (3.0, 3.1)
    result = hil.simulate(bench, duration_s=3.0)
    assert result.series["true_h1_cm"][-1] == pytest.approx(result.series["h1_V"][-1] / 0.5, abs=0.05)
    assert abs(result.series["r1_V"][0] - 0.5 * result.series["true_h1_cm"][0]) < 0.01


def test_a_run_folder_keeps_the_rig(command_line: CommandLine, tmp_path: Path) -> None:
    rig = rig_file(tmp_path)
    command = ("hil", "simulate", "rest", "--rig", rig, "--duration", "2", "--no-rerun", "--no-report")
    assert command_line(*command, "--out", tmp_path / "run").code == 0
    plan = RunFolder.open(tmp_path / "run").manifest().plan
    assert plan.copies["rig.toml"] == rig.read_text()
    assert plan.settings["rig"]["pumps"]["gain_cm3_Vs"] == [3.0, 3.1]
    assert command_line("hil", "report", tmp_path / "run").code == 0


@pytest.mark.parametrize(
    "command",
    [
        ("hil", "design"),
        ("hil", "simulate", "rest"),
        ("hil", "run", "rest"),
        ("hil", "doctor"),
        ("hil", "campaign", "rest"),
        ("firmware-sim", "--pty"),
    ],
    ids=lambda command: " ".join(command),
)
def test_an_unknown_rig_is_refused_with_the_names_that_there_are(
    command: tuple[str, ...], command_line: CommandLine
) -> None:
    result = command_line(*command, "--rig", "johanson")
    assert_refused(result, "johanson: no such file, and no shipped name; shipped rigs: " + ", ".join(SHIPPED))


def test_the_design_is_shown_beside_the_bounds_of_the_zero(command_line: CommandLine) -> None:
    """Without a zero in the right half plane there is no bound to show."""
    text = " ".join(command_line("hil", "design", "--rig", "johansson_plus").out.split())
    assert "zeros [1/s] -0.05625, 0.01276" in text
    assert "relative gains -0.636, 1.636; 1.636, -0.636" in text
    assert "pairing pump 2 with y1, pump 1 with y2" in text
    assert "-0.633 y1 +0.774 y2 goes the wrong way first" in text
    assert "the least that the zero permits" in text
    assert "sensitivity peak 1.93, at least 1.12" in text
    other = " ".join(command_line("hil", "design").out.split())
    assert "pairing pump 1 with y1, pump 2 with y2" in other
    assert "the zero permits" not in other


def test_steps_on_the_other_phase_settle_near_what_the_zero_permits() -> None:
    """Squared errors within a fifth of the least where the zero decides, settling within four times its bound."""
    zero = hil.design("rig", rig="johansson_plus").zero
    assert zero is not None
    for name in ("output 1", "output 2", "apart"):
        step = zero.steps[name]
        assert step.least_squared_error < step.squared_error < 1.2 * step.least_squared_error
        assert step.least_settled_s < step.settled_s < 4.0 * step.least_settled_s
    assert zero.steps["both"].settled_s < 70.0
    assert zero.least_peak < zero.peak < 2.0
    assert hil.design("rig").zero is None


def test_a_design_without_feedforward_is_judged_by_its_integrals() -> None:
    """The same gains, but fixed: references act through the integrals alone, and settle later."""
    design = hil.design("rig", rig="johansson_plus")
    assert design.zero is not None

    class Fixed:
        follows_reference = False

        def gains(self, linear: hil.LinearModel) -> hil.Gains:  # noqa: ARG002 - fixed
            return hil.Gains.from_matrix(design.K)

    slower = hil.design(Fixed(), rig="johansson_plus").zero
    assert slower is not None
    assert slower.steps["output 1"].settled_s > 1.5 * design.zero.steps["output 1"].settled_s


def rig_between_the_phases(folder: Path) -> Path:
    """Johansson's other phase with its valves set so that they add up to almost 1."""
    text = (CONFIG / "rigs" / "johansson_plus.toml").read_text()
    file = folder / "between.toml"
    file.write_text(text.replace("valve_split = [0.43, 0.34]", "valve_split = [0.51, 0.475]"))
    return file


def test_a_rig_without_a_design_says_so_and_nothing_is_run(command_line: CommandLine, tmp_path: Path) -> None:
    """Between the two phases no law with integral action is stable; the reason says how near the valves are."""
    rig = rig_between_the_phases(tmp_path)
    shown = command_line("hil", "design", "--rig", rig)
    text = " ".join(shown.out.split())
    assert shown.code == 0
    assert "gamma1 + gamma2 is too near to 1" in text
    assert "pumps.valve_split adds up to 0.985, 0.015 from 1" in text
    assert "None of the designs rig, calibrated is stable on this rig; a design of your own can be" in text
    refused = command_line("hil", "simulate", "steps", "--rig", rig, "--out", tmp_path / "run")
    assert_refused(refused, "between.toml", "too near to 1", "none of the designs rig, calibrated is stable")
    assert not (tmp_path / "run").exists()


def test_a_design_of_ones_own_runs_on_the_other_phase() -> None:
    """The documentation's LQR design is stable on the non-minimum-phase rig, and a run begins at rest."""
    design = lqr_example()
    assert hil.design(design, rig="johansson_plus").is_stable
    result = hil.simulate("rest", rig="johansson_plus", design=design, duration_s=3.0)
    assert result.status == "complete"
    levels_cm = [result.series[f"true_h{tank}_cm"][-1] for tank in (1, 2, 3, 4)]
    assert levels_cm == pytest.approx([12.442, 13.167, 4.730, 4.986], abs=0.1)


def test_a_campaign_runs_on_the_rig(command_line: CommandLine, tmp_path: Path) -> None:
    scenario = tmp_path / "own.toml"
    scenario.write_text(scenario_text(duration="2.0"))
    rig = rig_file(tmp_path)
    options = ("--seeds", "1", "--processes", "1", "--no-report")
    for name, more in (("own", ()), ("weak", ("--rig", rig))):
        assert command_line("hil", "campaign", scenario, *options, *more, "--out", tmp_path / name).code == 0
    rows = [json.loads((tmp_path / name / "outcomes.jsonl").read_text()) for name in ("own", "weak")]
    assert rows[0]["key"] != rows[1]["key"], "another rig is another case"
    assert rows[1]["level_max_cm"] < rows[0]["level_max_cm"] - 1.0
    assert rows[1]["false_alarms"] == 0


@pytest.mark.parametrize("rig", ["decenter2021", "johansson_minus", "johansson_plus"])
def test_a_shipped_rig_rests_at_its_operating_point_without_an_alarm(rig: str) -> None:
    """Sensors that fall with the level, or a tank of another height, must not disturb a healthy run."""
    result = hil.simulate("rest", rig=rig, duration_s=5.0)
    assert (result.status, result.alarms) == ("complete", ())
    levels_cm = [result.series[f"true_h{tank}_cm"] for tank in (1, 2)]
    assert all(abs(level[-1] - level[0]) < 0.2 for level in levels_cm)


def test_the_pumps_of_the_open_hardware_rig_give_what_its_authors_curve_says() -> None:
    """Wire voltage 10 V is full width of their pulses: c1 (1 - c3) / (1 - c2) cm3/s."""
    rig = hil.load("rest", rig="decenter2021").rig
    for pump, (c1, c2, c3) in enumerate(((39.01, -0.00124, 0.03386), (41.15, 0.00987, 0.04304))):
        assert 10.0 * rig.pumps.gain_cm3_Vs[pump] == pytest.approx(c1 * (1.0 - c3) / (1.0 - c2), rel=1e-3)
