"""The feedforward path: feasible, as fast as the pumps, without overshoot, at rest in the end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.core.feedforward import FeedforwardPath, PathLimits, advance, at_rest, target_of
from hil.core.tanks import TankModel, equilibrium, holding_voltages, level_rates
from hil.core.types import Pair, Quad

MODEL = TankModel()
PLUS = TankModel(valve_split=(0.43, 0.34))
LIMITS = PathLimits(((0.0, 10.0), (0.0, 10.0)), (20.0, 20.0), (0.2, 0.2), 19.0, 0.1)
START_V = (3.0, 3.0)


@dataclass(frozen=True, eq=False)
class Trace:
    """(n, 4) levels in cm and (n, 2) effective drives."""

    level_cm: NDArray[np.float64]
    drive_V: NDArray[np.float64]


def trace(model: TankModel, limits: PathLimits, change_cm: Pair, length_s: float = 60.0) -> tuple[Trace, Quad]:
    """A path from rest at START_V to a change of the lower levels, and the levels wanted."""
    (h1, h2, _, _), (d1, d2) = equilibrium(model, START_V), change_cm
    path, target = (
        at_rest(target_of(model, START_V), limits),
        target_of(model, holding_voltages(model, (h1 + d1, h2 + d2))),
    )
    steps = [path]
    for _ in range(round(length_s / limits.period_s)):
        steps.append(advance(model, limits, steps[-1], target, None))
    return Trace(np.array([p.level_cm for p in steps]), np.array([p.drive_V for p in steps])), target.level_cm


@pytest.mark.parametrize("effectiveness", [(1.0, 1.0), (0.4, 0.4), (0.4, 1.0)])
@pytest.mark.parametrize("change_cm", [(0.63, 0.63), (1.4, -2.0), (-2.0, 1.2), (-2.0, -2.0)])
def test_outputs_arrive_without_overshoot_within_the_pumps(effectiveness: Pair, change_cm: Pair) -> None:
    limits = LIMITS.with_effectiveness(effectiveness)
    path, wanted = trace(MODEL, limits, change_cm)
    over = (path.level_cm[:, :2] - wanted[:2]) * np.sign(change_cm)
    assert over.max() < 0.005
    assert np.abs(path.level_cm[-1, :2] - wanted[:2]).max() < 0.005
    for pump in (0, 1):
        low, high = limits.drives_V[pump]
        assert low <= path.drive_V[:, pump].min() <= path.drive_V[:, pump].max() <= high
        assert np.abs(np.diff(path.drive_V[:, pump])).max() <= limits.rate_V_s[pump] * limits.period_s


def test_a_large_step_is_nearly_as_fast_as_the_pumps_can_be() -> None:
    """Bound: the time that the whole drive from hold to limit takes for the water of the step, and lag and rate."""
    path, wanted = trace(MODEL, LIMITS, (2.0, 2.0))
    for output in (0, 1):
        spare = 10.0 - START_V[output]
        effect = MODEL.valve_split[output] * MODEL.pump_gain_cm3_Vs[output] / MODEL.area_cm2[output]
        bound_s = 2.0 / (effect * spare) + LIMITS.lag_s[output] + 0.5 * spare / LIMITS.rate_V_s[output]
        arrived_s = 0.1 * np.argmax(path.level_cm[:, output] > wanted[output] - 0.1)
        assert arrived_s < bound_s + 2.0


@pytest.mark.parametrize("model", [MODEL, PLUS])
def test_the_path_ends_at_rest(model: TankModel) -> None:
    path, wanted = trace(model, LIMITS, (0.6, 0.4), 900.0)
    assert path.level_cm[-1] == pytest.approx(wanted, abs=2e-3)
    assert path.drive_V[-1] == pytest.approx(path.drive_V[-10], abs=1e-3)


def test_a_path_at_rest_stays_there() -> None:
    target = target_of(MODEL, START_V)
    path = at_rest(target, LIMITS)
    for _ in range(50):
        path = advance(MODEL, LIMITS, path, target, None)
    assert path.level_cm == pytest.approx(target.level_cm, abs=1e-9)
    assert path.drive_V == pytest.approx(START_V, abs=1e-9)


def test_a_delay_causes_no_overshoot() -> None:
    slow = replace(LIMITS, lag_s=(0.5, 0.5), delay_s=(1.0, 0.6))
    path, wanted = trace(MODEL, slow, (2.0, 2.0))
    assert (path.level_cm[:, :2] - wanted[:2]).max() < 0.005


def test_the_path_is_a_motion_of_the_model() -> None:
    """Levels, flows and drives belong together: the same as a fine integration of eq. (1) behind the lag."""
    path, _ = trace(MODEL, LIMITS, (2.0, -1.0), 20.0)
    level, flow = path.level_cm[0], np.array(START_V)
    for k, drive in enumerate(path.drive_V[:-1]):
        for _ in range(100):
            flow = flow + 0.001 * (drive - flow) / 0.2
            h1, h2, h3, h4 = level.tolist()
            level = level + 0.001 * np.array(level_rates(MODEL, (h1, h2, h3, h4), (flow[0], flow[1])))
        assert level == pytest.approx(path.level_cm[k + 1], abs=0.01)


def test_a_path_follows_the_true_output_but_not_a_stuck_sensor() -> None:
    """A rig with 10 % more gain arrives earlier; a sensor that is stuck makes the movement a quarter longer at most."""
    target = target_of(MODEL, holding_voltages(MODEL, (14.26, 14.78)))
    start: FeedforwardPath = at_rest(target_of(MODEL, START_V), LIMITS)

    def duration(estimate_cm: Quad | None, gain: float = 1.0) -> int:
        path, true_cm = start, start.level_cm
        for step in range(600):
            if abs(target.level_cm[0] - path.level_cm[0]) < 0.1:
                return step
            drive = (gain * path.flow_V[0], gain * path.flow_V[1])
            rates = level_rates(MODEL, true_cm, drive)
            true_cm = tuple(h + 0.1 * rate for h, rate in zip(true_cm, rates, strict=True))  # type: ignore[assignment]
            path = advance(MODEL, LIMITS, path, target, true_cm if estimate_cm is None else estimate_cm)
        return 600

    assert duration(None, 1.1) < duration(None, 1.0)
    assert duration(start.level_cm) <= 1.35 * duration(None, 1.0)


def test_a_dead_pump_does_not_drive_the_other_output_beyond_its_target() -> None:
    """Pump 1 used to fill the tank above the dead pump's output at full voltage: output 1 rose until it tripped."""
    limits = replace(LIMITS, drives_V=((0.0, 10.0), (0.0, 0.0)))
    target = target_of(MODEL, (3.6, 0.0))
    path, highest_cm = at_rest(target_of(MODEL, START_V), limits), 0.0
    for _ in range(1200):
        path = advance(MODEL, limits, path, target, None)
        highest_cm = max(highest_cm, path.level_cm[0])
    assert highest_cm < max(target.level_cm[0], equilibrium(MODEL, START_V)[0]) + 0.05
