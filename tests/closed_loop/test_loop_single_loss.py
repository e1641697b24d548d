"""One pump loses 60 % without a fault signal: the rig's design lives with it, the paper's does not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.closed_loop.conftest import Plan, Planned
from tests.closed_loop.loop_experiment import Experiment, Loss, Run

LOSS_AT_S = 20.0
PUMPS = (1, pytest.param(2, marks=pytest.mark.long))


@pytest.fixture(scope="module")
def runs(plan_run: Plan) -> dict[tuple[str, int], Planned]:
    return {
        (design, pump): plan_run(
            Experiment(
                f"{design}-{pump}",
                240.0,
                losses=(Loss(LOSS_AT_S, pump, 0.4),),
                design=design,
                reconfigure=False,
                period_s=0.05,
            )
        )
        for design, pump in (("rig", 1), ("rig", 2), ("calibrated", 1))
    }


def errors_V(run: Run) -> Any:  # noqa: N802
    return run.pair("r{}_V") - 0.5 * run.levels_cm()[:, :2]


@pytest.mark.parametrize("pump", PUMPS)
def test_the_rigs_design_settles_with_gains_kept(runs: dict[tuple[str, int], Planned], pump: int) -> None:
    run = runs["rig", pump].result()
    assert run.kpi.status == "complete"
    t_s, error = run.columns["t_s"], np.abs(errors_V(run))
    assert error[(t_s > LOSS_AT_S) & (t_s < 60.0)].max() > 0.3
    assert error[(t_s > 180.0) & (t_s < 240.0)].max() < 0.002
    command = run.pair("v{}_V")[(t_s > 180.0) & (t_s < 240.0)]
    assert command.mean(axis=0)[pump - 1] == pytest.approx(3.0 / 0.4, rel=0.002)
    assert command.std(axis=0).max() < 0.01


@pytest.mark.parametrize("pump", PUMPS)
def test_the_other_output_hardly_notices(runs: dict[tuple[str, int], Planned], pump: int) -> None:
    run = runs["rig", pump].result()
    error = np.abs(errors_V(run))[run.columns["t_s"] < 240.0]
    assert error[:, 2 - pump].max() < 0.02 * error[:, pump - 1].max()


def test_the_calibrated_design_loses_pump_1_and_the_supervisor_stops_it(
    runs: dict[tuple[str, int], Planned],
) -> None:
    """Errors grow until tank 2 is about to overflow, 16 s after the loss; the interlock takes both pumps to 0 V."""
    run = runs["calibrated", 1].result()
    assert run.kpi.status == "tripped"
    assert [trip["cause"] for trip in run.kpi.trips] == ["high_level"]
    assert LOSS_AT_S < run.kpi.trips[0]["t_s"] < 60.0
    t_s, error = run.columns["t_s"], np.abs(errors_V(run)).max(axis=1)
    sizes = [error[(t_s >= start) & (t_s < start + 5.0)].max() for start in (20.0, 25.0, 30.0)]
    assert sizes[0] < sizes[1] < sizes[2]
    assert run.levels_cm().max() < 19.2
    assert run.pair("v{}_V")[-1].tolist() == [0.0, 0.0]
