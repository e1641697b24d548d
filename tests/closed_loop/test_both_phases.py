"""Runs on Johansson's rig with its valves on the other side of gamma1 + gamma2 = 1, and on their way there."""

from pathlib import Path

import numpy as np
import pytest

import hil
from hil.review.ticks import Floats

SCENARIO = """[scenario]
name = "phase"
duration_s = {duration_s}

{more}
[diagnosis]
method = "glr"

[control]
reconfigure = true
design = "rig"

[emulator]
parameter_spread = {spread}
{emulator}
"""

RIM_CM = 20.0


def simulate(
    folder: Path, rig: str, duration_s: float, more: str, *, spread: float = 0.0, emulator: str = "", seed: int = 1
) -> hil.RunResult:
    file = folder / "phase.toml"
    file.write_text(SCENARIO.format(duration_s=duration_s, more=more, spread=spread, emulator=emulator))
    return hil.simulate(file, rig=rig, seed=seed)


def fault(kind: str, target: int, value: float, at_s: float, ramp_s: float | None = None) -> str:
    ramp = "" if ramp_s is None else f"ramp_s = {ramp_s}\n"
    return f'[[fault]]\nat_s = {at_s}\nkind = "{kind}"\ntarget = {target}\nvalue = {value}\n{ramp}'


def highest_cm(run: hil.RunResult) -> float:
    return max(float(np.nanmax(run.series[f"true_h{tank}_cm"])) for tank in (1, 2, 3, 4))


def errors(run: hil.RunResult, output: int) -> Floats:
    return run.series[f"r{output}_V"] - 0.5 * run.series[f"true_h{output}_cm"]


@pytest.mark.long
@pytest.mark.parametrize("step", [(0.3, -0.3), (0.0, 0.3)])
def test_references_are_reached_without_offset(tmp_path: Path, step: tuple[float, float]) -> None:
    """The rig used to be refused. The zero permits 40 s for these steps, a decay at twice its mirror image 160 s."""
    change = f"[[reference]]\nat_s = 10.0\nchange_V = [{step[0]}, {step[1]}]\n"
    run = simulate(tmp_path, "johansson_plus", 310.0, change)
    assert (run.status, run.alarms) == ("complete", ())
    times = run.series["t_s"]
    for output in (1, 2):
        error = errors(run, output)
        assert np.abs(error[times > 190.0]).max() < 0.02
        assert abs(error[times > 290.0].mean()) < 0.003


@pytest.mark.long
@pytest.mark.parametrize("pump", [1, 2])
def test_a_pump_that_loses_two_fifths_is_found_and_hardly_seen(tmp_path: Path, pump: int) -> None:
    run = simulate(tmp_path, "johansson_plus", 60.0, fault("pump_effectiveness", pump, 0.6, 20.0))
    assert run.status == "complete"
    assert [(alarm.kind, alarm.target) for alarm in run.alarms] == [("pump_effectiveness", pump)]
    assert run.series[f"theta{pump}"][-1] == pytest.approx(0.6, abs=0.02)
    assert any(event.code == "reconfigured" for event in run.events)
    for output in (1, 2):
        assert np.abs(errors(run, output)).max() < 0.05
        assert abs(errors(run, output)[-1]) < 0.01


@pytest.mark.long
@pytest.mark.parametrize(
    ("rig", "pump", "value", "ramp_s"),
    [
        ("johansson_plus", 1, 0.85, 60.0),
        ("johansson_plus", 2, 0.8, 60.0),
        ("johansson_minus", 1, 0.2, 60.0),
        ("johansson_minus", 2, 0.1, 60.0),
    ],
)
def test_a_valve_that_drifts_through_one_ends_in_an_orderly_way(
    tmp_path: Path, rig: str, pump: int, value: float, ramp_s: float
) -> None:
    """From both sides: no law is stable there, and no tank comes near its rim."""
    run = simulate(tmp_path, rig, 110.0, fault("valve_split", pump, value, 20.0, ramp_s), spread=0.03)
    assert (run.status, run.reason) == ("stopped", "no_stable_law")
    assert highest_cm(run) < RIM_CM - 1.0
    assert abs(run.series["v1_V"][-1]) + abs(run.series["v2_V"][-1]) < 0.5


@pytest.mark.long
def test_a_run_from_empty_tanks_reaches_its_first_reference(tmp_path: Path) -> None:
    """With the ramp of a minimum-phase rig level 2 rose to 17 cm, and the start phase failed."""
    run = simulate(tmp_path, "johansson_plus", 5.0, "", spread=0.03, emulator="tanks.start_V = [0.0, 0.0]")
    assert run.status == "complete"
    assert run.series["t_s"][0] < -390.0
    assert highest_cm(run) < RIM_CM - 3.0
    assert all(abs(errors(run, output)[-1]) < 0.2 for output in (1, 2))
