"""The loop with a path: beside an integration of its own, and from MANUAL back to AUTO.

The integration is written from the documents (paper's eq. 1 and 6, decision 37, the head of `hil.core.feedforward`),
with scipy's solve_ivp for tanks, path and estimate. Only the gain K comes from the program.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from hil.core.controller import ControllerConfig
from hil.core.feedforward import PathLimits
from hil.core.following import HEALTHY
from hil.core.gain_design import gain_matrix
from hil.core.laws.path_follower import PathFollower
from hil.core.laws.state_feedback_law import StateFeedbackLaw
from hil.core.types import Action, Pair, Request
from tests.core.core_bench import PERIOD_S, Plant, bench_loop, controller_config, memory_of, reconfiguration, run

Floats = NDArray[np.float64]

AREA_CM2, OUTLET_CM2 = np.array([28.0, 32.0, 28.0, 32.0]), np.array([0.071, 0.057, 0.071, 0.057])
PUMP_CM3_VS, SPLIT, G_CM_S2, SENSOR_V_CM = np.array([3.33, 3.35]), np.array([0.7, 0.6]), 981.0, 0.5
FROM_STEP, LENGTH = 300, 300
GAINS = (1.03, 0.97)
"""Of the true pumps, as shares of the model's: feedback and integrals have something to do."""


def tank_rates(h: Floats, v: Floats) -> Floats:
    """(4,) cm/s, eq. (1)."""
    out = OUTLET_CM2 * np.sqrt(2.0 * G_CM_S2 * np.maximum(h, 0.0))
    direct, crossed = SPLIT * PUMP_CM3_VS * v, (1.0 - SPLIT) * PUMP_CM3_VS * v
    flow_in = np.array([out[2] + direct[0], out[3] + direct[1], crossed[1], crossed[0]])
    return np.asarray((flow_in - out) / AREA_CM2)


def after_a_period(h: Floats, v: Floats) -> Floats:
    """(4,) levels one period later, with constant drives."""
    solved = solve_ivp(lambda _, x: tank_rates(x, v), (0.0, PERIOD_S), h, rtol=1e-8, atol=1e-10)
    return np.asarray(solved.y[:, -1])


def path_drive(h: Floats, v: Floats, target_cm: Floats, held_V: Floats, added_V: Floats) -> Floats:
    """(2,) decision 37: hold the output, and bring it to its target in 0.7 s, within what feedback leaves of the pumps.

    The bounds of the upper tanks are not reached by the steps here.
    """
    effect = SPLIT * PUMP_CM3_VS
    out = OUTLET_CM2 * np.sqrt(2.0 * G_CM_S2 * h)
    hold = (out[:2] - out[2:]) / effect
    wanted = hold + (target_cm[:2] - h[:2]) * AREA_CM2[:2] / effect / 0.7
    wanted = np.clip(wanted, v - 0.9 * 20.0 * PERIOD_S, v + 0.9 * 20.0 * PERIOD_S)
    low, high = -added_V, 10.0 - added_V
    margin_low, margin_high = np.minimum(0.15, 0.05 * (held_V - low)), np.minimum(0.15, 0.05 * (high - held_V))
    return np.asarray(np.clip(wanted, low + margin_low, high - margin_high))


def followed(h: Floats, v: Floats, target_cm: Floats, estimate_cm: Floats) -> Floats:
    """(4,) the path's levels, which follow the estimate while they move."""
    if np.all(np.abs(target_cm[:2] - h[:2]) <= 0.06):
        return h
    most = np.array([0.2, 0.2, 0.4, 0.4]) * np.abs(tank_rates(h, v)) * PERIOD_S
    moved = np.clip(PERIOD_S / 0.5 * (estimate_cm - h), -most, most)
    moved[:2][np.abs(target_cm[:2] - h[:2]) <= 0.06] = 0.0
    return np.asarray(h + moved)


def config_with_path(step_V: Pair = (0.0, 0.0), requests: tuple[tuple[float, Request], ...] = ()) -> ControllerConfig:
    rule = reconfiguration()
    limits = PathLimits(((0.0, 10.0), (0.0, 10.0)), (20.0, 20.0), (0.0, 0.0), 19.0, PERIOD_S)
    law = StateFeedbackLaw(rule, PERIOD_S, 5.0, PathFollower(rule, limits))
    loop = bench_loop(law=law)
    (_, (y1, y2)) = loop.references[0]
    steps = (*loop.references, ((FROM_STEP - 1) * PERIOD_S, (y1 + step_V[0], y2 + step_V[1])))
    return replace(controller_config(replace(loop, references=steps)), requests=requests)


@pytest.mark.parametrize("step_V", [(0.3, 0.3), (0.5, -0.4)])
def test_the_loop_with_a_path_is_what_an_independent_integration_says(step_V: Pair) -> None:
    config, plant = config_with_path(step_V), Plant()
    plant.effectiveness = GAINS
    before, begun = run(config, plant, FROM_STEP)
    h, given = np.array(plant.level_cm), np.array(begun[-1].command_V)
    memory = memory_of(before.loop)
    assert memory.path is not None
    assert before.loop is not None
    path, path_V = np.array(memory.path.path.level_cm), np.array(memory.path.path.drive_V)
    q, y_lower, fed = np.array(memory.integral_Vs), np.array(memory.lower_cm), np.array(memory.level_cm)
    estimate, excess = np.array(before.loop.estimate.level_cm), np.zeros(2)

    rule = config.loop.law.reconfiguration  # type: ignore[attr-defined]
    law = rule.law(config.loop.references[1][1], HEALTHY)
    K = gain_matrix(law.gains)
    K_x, K_q = K[:, :4], K[:, 4:]
    target, held_V = np.array(law.operating_level_cm), np.array(law.operating_V)
    levels, commands = [], []
    for _ in range(LENGTH):
        predicted = after_a_period(estimate, given)
        estimate = predicted + (1.0 - exp(-PERIOD_S / 0.5)) * (h - predicted)
        q = q + PERIOD_S * SENSOR_V_CM * (path[:2] - y_lower) + PERIOD_S / 5.0 * np.linalg.solve(K_q, excess)
        added = -K_x @ (fed - path) - K_q @ q
        path = followed(after_a_period(path, path_V), path_V, target, estimate)
        path_V = path_drive(path, path_V, target, held_V, added)
        y_lower, fed = h[:2], h - 0.15 * (h - predicted)
        wanted = path_V - K_x @ (fed - path) - K_q @ q
        given = np.clip(np.clip(wanted, given - 2.0, given + 2.0), 0.0, 10.0)
        excess = wanted - given
        levels.append(h)
        commands.append(given)
        h = after_a_period(h, np.array(GAINS) * given)

    again = Plant()
    again.effectiveness = GAINS
    _, records = run(config, again, FROM_STEP + LENGTH)
    ours_V = np.array([record.command_V for record in records[-LENGTH:]])
    ours_cm = np.array([[v / SENSOR_V_CM for v in record.measured_V] for record in records[-LENGTH:]])
    assert np.abs(np.array(levels)[:, :2] - ours_cm[:, :2]).max() < 2e-3
    assert np.abs(np.array(commands) - ours_V).max() < 0.02
    assert np.abs(ours_V - ours_V[-1]).max() > 1.0, "the step moved the pumps"


def manual_between_10_and_20_s(drive_V: Pair) -> tuple[Floats, Floats, Floats]:
    """Run times (n,), commands (n, 2) and control errors (n, 2), V."""
    requests = ((10.0, Request(Action.MANUAL, drive_V)), (20.0, Request(Action.AUTO)))
    plant = Plant()
    plant.effectiveness = GAINS
    _, records = run(config_with_path(requests=requests), plant, 600)
    errors = [[r - y for r, y in zip(one.reference_V, one.measured_V[:2], strict=True)] for one in records]
    return np.array([one.t_s for one in records]), np.array([one.command_V for one in records]), np.array(errors)


def test_control_returns_from_manual_without_a_jump() -> None:
    """The operator keeps what the pumps had."""
    held_V = (3.0 / GAINS[0], 3.0 / GAINS[1])
    t_s, commands, errors = manual_between_10_and_20_s(held_V)
    assert np.abs(np.diff(commands[t_s > 19.0], axis=0)).max() < 0.3, "the path brings back what is left of an error"
    assert np.abs(errors[t_s > 10.0]).max() < 0.02


def test_a_path_leads_back_from_where_the_operator_has_moved_the_rig() -> None:
    """It begins with the operator's drives, and moves them no faster than a path does."""
    t_s, commands, errors = manual_between_10_and_20_s((4.2, 2.5))
    back = int(np.searchsorted(t_s, 20.0))
    assert np.abs(commands[back] - commands[back - 1]).max() < 1.81
    assert np.abs(errors[back]).min() > 0.15, "the operator moved the rig"
    assert np.abs(errors[t_s > 35.0]).max() < 0.01
    beyond = (-np.sign(errors[back]) * errors[t_s > 20.0]).max(axis=0)
    assert (beyond < 0.05 * np.abs(errors[back])).all()
