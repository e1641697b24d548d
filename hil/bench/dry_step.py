"""Settings are tried out before anything moves: the law at every reference, then control steps on a healthy rig.

A range check of each key can't see what several keys do together. What is accepted here runs its first steps: a design
that does not stabilise the rig, a model that overflows, a detector that raises are refused with the reason. Why
it is so: docs/decisions/0021-settings-are-tried-out.md.
"""

from __future__ import annotations

from math import isfinite

import numpy as np

from hil.core import controller
from hil.core.controller import ControllerConfig, ControllerState
from hil.core.gain_design import closed_loop_poles, gain_matrix
from hil.core.tanks import equilibrium, linearise, nearest_reachable
from hil.core.types import BusHealth, Inputs, Measurement, NodeHealth, NodeState, Pair, PumpFeedback

STEPS = 4
"""From disarmed to ready, to the first step in control, and two more: the filters' first prediction is among them."""

READINGS = 5
MIN_LEVEL_CM = 0.2
"""Levels below it are linearised here; see `hil.core.reconfiguration`."""

FAILURES = (ArithmeticError, ValueError, np.linalg.LinAlgError)


class DryStepError(ValueError):
    """The settings can't be run; the message says what fails and why."""


def try_out(config: ControllerConfig) -> None:
    """The law at every reference, and the first control steps. Raises DryStepError."""
    with np.errstate(all="ignore"):  # values that are not finite are refused below
        for at_s, reference_V in config.loop.references:
            _check_law(config, at_s, reference_V)
        _check_steps(config)


def _check_law(config: ControllerConfig, at_s: float, reference_V: Pair) -> None:
    """There is a control law for the reference, and it stabilises the rig with healthy pumps."""
    where = f"at the reference of {at_s:g} s ({reference_V[0]:.4g}, {reference_V[1]:.4g} V)"
    reconfiguration = config.loop.reconfiguration
    model, k = reconfiguration.model, reconfiguration.model.level_gain_V_cm
    try:
        law = reconfiguration.law(reference_V, (1.0, 1.0))
        reached = nearest_reachable(model, (reference_V[0] / k, reference_V[1] / k), reconfiguration.limit_V)
        v1, v2 = (max(voltage, 0.0) for voltage in reached.holding_V)
        h1, h2, h3, h4 = (max(level_cm, MIN_LEVEL_CM) for level_cm in equilibrium(model, (v1, v2)))
        slowest = closed_loop_poles(linearise(model, (h1, h2, h3, h4)), gain_matrix(law.gains))[0]
    except FAILURES as error:
        raise DryStepError(f"no control law {where}: {error}") from None
    except Exception as error:  # noqa: BLE001 - a design of a user's own may raise anything
        raise DryStepError(f"the design fails {where}: {type(error).__name__}: {error}") from None
    if not slowest.real < 0.0:
        raise DryStepError(
            f"the design's gain does not stabilise this rig {where}: "
            f"its slowest closed-loop pole lies at {slowest.real:+.4g} 1/s, it must be negative"
        )


def _check_steps(config: ControllerConfig) -> None:
    """The controller from disarmed into control, on readings of a healthy rig at its operating point."""
    state = ControllerState()
    inputs = _healthy_inputs(config)
    for number in range(STEPS):
        try:
            state, output = controller.step(config, state, inputs, round(number * config.loop.period_s * 1e9))
        except Exception as error:  # noqa: BLE001 - a design or detector of a user's own may raise anything
            raise DryStepError(f"a control step fails: {type(error).__name__}: {error}") from None
        record = output.record
        if record is not None and not all(map(isfinite, (*record.raw_V, *record.estimated_V, *record.integral_Vs))):
            raise DryStepError("a control step gives a value that is not finite; look at tanks, pumps and sensors")


def _healthy_inputs(config: ControllerConfig) -> Inputs:
    limits = config.limits
    k = limits.level_gain_V_cm
    h1, h2, h3, h4 = equilibrium(limits.model, config.loop.reconfiguration.operating_point_V)
    return Inputs(
        measurement=Measurement((k * h1, k * h2, k * h3, k * h4), (True, True, True, True), 0.0, READINGS),
        pumps=PumpFeedback((0.0, 0.0), (0.0, 0.0), NodeState.READY, 0, 0.0, 0.0),
        nodes=NodeHealth(0.0, rebooted=False, contract_matches=True),
        bus=BusHealth(accepted=1, rejected=0, send_failures=0, foreign_commands=0, is_up=True),
    )
