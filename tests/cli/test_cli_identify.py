"""`hil identify` on the terminal: what it announces, asks, refuses and writes."""

import io
import json
import sys
from pathlib import Path

import pytest

from hil.bench import identify_inputs
from tests.cli.cli_bench import CONFIG, CommandLine, assert_refused

EXPERIMENT = ("--emulator", "--minutes", "0.4", "--no-rerun")


@pytest.mark.long
def test_an_experiment_with_the_emulator_ends_with_the_parameters(tmp_path: Path, command_line: CommandLine) -> None:
    out = tmp_path / "x"
    done = command_line("hil", "identify", *EXPERIMENT, "--out", out)
    assert done.code == 0, done
    assert "phase 1 of 5, fill: pumps at 0 V until the tanks are empty" in done.out
    assert json.loads((out / "identification.json").read_text())["parameters"]["k1"]["status"] == "identified"
    assert (out / "identified.toml").is_file()

    from_runs = command_line(
        "hil", "identify", out, out / "phases" / "02_steps", "--out", tmp_path / "of runs", "--no-rerun"
    )
    assert from_runs.code == 0, from_runs
    assert (tmp_path / "of runs" / "report.html").is_file()


def test_a_phase_begins_only_when_it_is_confirmed(
    tmp_path: Path, command_line: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bus does not exist: a phase that began would fail with exit code 2."""
    for answer in ("n\n", ""):
        monkeypatch.setattr(sys, "stdin", io.StringIO(answer))
        done = command_line("hil", "identify", "-i", "slcan", "-c", "/dev/none", "--out", tmp_path / "x")
        assert done.code == 0, done
        assert "stopped between two phases; the same command goes on" in " ".join(done.out.split())
    assert not list((tmp_path / "x" / "phases").iterdir())


@pytest.mark.long
def test_a_truth_may_be_a_rig_a_scenario_or_an_emulator_file(tmp_path: Path, command_line: CommandLine) -> None:
    done = command_line(
        "hil", "identify", *EXPERIMENT, "--truth", "decenter2021", "--out", tmp_path / "falling sensors"
    )
    assert done.code == 4, done
    assert "tank 1 reads 11.7" in done.err
    assert "hil calibrate" in done.err
    scenario = tmp_path / "weak.toml"
    scenario.write_text('[scenario]\nname = "weak"\nduration_s = 9.0\n[emulator]\npumps.gain_cm3_Vs = [2.664, 3.35]\n')
    done = command_line("hil", "identify", *EXPERIMENT, "--truth", scenario, "--out", tmp_path / "weak")
    assert done.code == 0, done
    figures = json.loads((tmp_path / "weak" / "identification.json").read_text())["parameters"]
    assert figures["k1"]["value"] == pytest.approx(2.664, rel=0.01)
    emulator = identify_inputs.emulator(str(CONFIG / "emulator.toml"), "decenter2021", None, 1)
    assert emulator.parameters.tanks.area_cm2 == (28.0, 32.0, 28.0, 32.0)
    assert identify_inputs.emulator(None, "decenter2021", None, 1).parameters.tanks.area_cm2[0] == 29.79


def test_choices_that_contradict_each_other_are_refused(tmp_path: Path, command_line: CommandLine) -> None:
    out = ("--out", tmp_path / "x")
    assert_refused(command_line("hil", "identify", "--truth", "paper", *out), "--emulator")
    assert_refused(command_line("hil", "identify", "--emulator", "-c", "can0", *out), "exclude each other")
    assert_refused(command_line("hil", "identify", tmp_path, "--emulator", *out), "recorded runs")
    assert_refused(command_line("hil", "identify", tmp_path, *out), "run.json")
    levels = tmp_path / "levels.csv"
    levels.write_text("tank,level_cm\n5,3.0\n")
    assert_refused(command_line("hil", "identify", *EXPERIMENT, "--ruler-file", levels, *out), levels, "tank")


def test_an_experiment_is_gone_on_with_by_the_same_choices_only(tmp_path: Path, command_line: CommandLine) -> None:
    out = tmp_path / "x"
    (out).mkdir()
    (out / "experiment.json").write_text('{"format": 1, "choices": {"structure": "full"}, "phases": ["fill"]}')
    assert_refused(command_line("hil", "identify", *EXPERIMENT, "--out", out), "other choices", out)
    (out / "experiment.json").write_text("{")
    assert_refused(command_line("hil", "identify", *EXPERIMENT, "--out", out), "experiment.json")
