"""Any experiment, not only the paper's: runs against the loop in continuous time, window by window."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from tests.closed_loop.conftest import Plan, Planned
from tests.closed_loop.loop_experiment import Experiment, Loss, Run, Step, simulate
from tests.closed_loop.loop_reference import Reference, plant_of

PERIOD_S, SHORT_PERIOD_S = 0.04, 0.02


def experiment(
    name: str, duration_s: float, steps: tuple[Step, ...], losses: tuple[Loss, ...] = (), **choices: Any
) -> Experiment:
    """Windows: between one event and the next, and the whole."""
    edges = sorted({step.at_s for step in steps} | {loss.at_s for loss in losses} | {duration_s})
    windows = [(f"w{i}", a, b) for i, (a, b) in enumerate(pairwise(edges))]
    return Experiment(
        name, duration_s, steps, losses, (*windows, ("whole", 0.0, duration_s)), period_s=PERIOD_S, **choices
    )


EXPERIMENTS = (
    experiment(
        "unequal steps of both signs, pump 2 loses half, late report",
        180.0,
        (Step(20.0, "change_V", (0.4, -0.3)), Step(120.0, "change_V", (-0.2, 0.25))),
        (Loss(60.0, 2, 0.5),),
        delay_s=0.5,
    ),
    experiment(
        "calibrated, steps down, pump 1 loses half, report at once",
        180.0,
        (Step(20.0, "change_V", (-0.5, -0.2)), Step(120.0, "change_V", (0.3, 0.1))),
        (Loss(60.0, 1, 0.5),),
        design="calibrated",
        delay_s=0.0,
    ),
    experiment(
        "levels in cm, a loss that passes, reported after 3 s",
        180.0,
        (Step(10.0, "levels_cm", (10.0, 14.0)),),
        (Loss(60.0, 1, 0.6, until_s=120.0),),
        delay_s=3.0,
    ),
    experiment(
        "levels in V, gains kept while pump 1 has 40 % left",
        180.0,
        (Step(10.0, "levels_V", (6.6, 6.0)),),
        (Loss(60.0, 1, 0.4),),
        reconfigure=False,
    ),
    experiment(
        "calibrated, both pumps at different times, reported after 3 s",
        180.0,
        (Step(20.0, "levels_V", (6.4, 6.1)),),
        (Loss(60.0, 1, 0.7), Loss(100.0, 2, 0.5)),
        design="calibrated",
        delay_s=3.0,
    ),
    experiment(
        "one loss within another of the same pump, and a second pump",
        200.0,
        (Step(150.0, "change_V", (0.3, 0.3)),),
        (Loss(20.0, 1, 0.8), Loss(50.0, 1, 0.5, until_s=100.0), Loss(120.0, 2, 0.6, until_s=170.0)),
    ),
    experiment(
        "tanks and pumps other than believed",
        180.0,
        (Step(20.0, "change_V", (0.3, 0.2)), Step(120.0, "change_V", (-0.3, 0.1))),
        (Loss(70.0, 1, 0.7), Loss(70.0, 2, 0.6)),
        emulator={
            "tanks.outlet_cm2": [0.0731, 0.0558, 0.0696, 0.0581],
            "pumps.gain_cm3_Vs": [3.43, 3.25],
            "pumps.valve_split": [0.69, 0.615],
        },
    ),
    experiment(
        "calibrated, pumps other than believed, gains kept, a loss that passes",
        180.0,
        (Step(20.0, "change_V", (0.2, -0.2)),),
        (Loss(60.0, 2, 0.8, until_s=120.0),),
        design="calibrated",
        reconfigure=False,
        emulator={"pumps.gain_cm3_Vs": [3.25, 3.43]},
    ),
    experiment(
        "what is left of pump 1 can't hold the reference",
        200.0,
        (Step(120.0, "change_V", (-0.3, 0.4)),),
        (Loss(20.0, 1, 0.25),),
    ),
)


@pytest.fixture(scope="module")
def runs(plan_run: Plan) -> dict[str, Planned]:
    return {experiment.name: plan_run(experiment) for experiment in EXPERIMENTS}


def assert_agrees_with_continuous_time(run: Run, experiment: Experiment, within_Vs: float) -> None:
    """Each window's IAE within half a per cent, or within_Vs where the error is next to nothing."""
    assert run.kpi.status == "complete"
    for window, expected in Reference(experiment, plant_of(experiment)).window_iae().items():
        assert run.kpi.iae_Vs[window] == pytest.approx(expected, rel=0.005, abs=within_Vs), window


@pytest.mark.parametrize("experiment", [EXPERIMENTS[0], EXPERIMENTS[-1]], ids=lambda experiment: experiment.name)
def test_a_run_agrees_with_the_loop_in_continuous_time(runs: dict[str, Planned], experiment: Experiment) -> None:
    """At a control period of 40 ms, which adds an error of first order. All of them: the long tests, at 20 ms."""
    assert_agrees_with_continuous_time(runs[experiment.name].result(), experiment, 0.004)


@pytest.mark.long
@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda experiment: experiment.name)
def test_the_shorter_the_period_the_nearer_to_continuous_time(experiment: Experiment, tmp_path: Path) -> None:
    """The same at 20 ms."""
    shorter = replace(experiment, period_s=SHORT_PERIOD_S)
    assert_agrees_with_continuous_time(simulate(shorter.toml(), tmp_path / "run"), shorter, 0.002)


def test_an_unreachable_reference_is_said_to_be_one(runs: dict[str, Planned]) -> None:
    run = runs[EXPERIMENTS[-1].name].result()
    events = [event for event in run.events if event.code == "target"]
    assert [event.t_s for event in events] == [pytest.approx(21.0), pytest.approx(120.0)]
    assert "pump 1 would need" in events[0].text
