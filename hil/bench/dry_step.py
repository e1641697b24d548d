"""Settings are tried out before anything moves: the law at every reference, then control steps on a healthy rig.

A range check of each key can't see what several keys do together. What is accepted here runs its first steps: a design
that does not stabilise the rig, a model that overflows, a detector that raises are refused with the reason. Why
it is so: docs/decisions/0021-settings-are-tried-out.md.
"""

from __future__ import annotations

from math import isfinite

import numpy as np

from hil.core import controller
from hil.core.control_law import ChecksReferences
from hil.core.controller import ControllerConfig, ControllerState
from hil.core.tanks import equilibrium, holding_voltages
from hil.core.types import BusHealth, Inputs, Measurement, NodeHealth, NodeState, Pair, PumpFeedback

STEPS = 4
"""From disarmed to ready, to the first step in control, and two more: the filters' first prediction is among them."""

READINGS = 5

FAILURES = (ArithmeticError, ValueError, np.linalg.LinAlgError)


class DryStepError(ValueError):
    """The settings can't be run; the message says what fails and why."""


def try_out(config: ControllerConfig) -> tuple[str, ...]:
    """The law at every reference, and the first control steps; the names of what the law shows. Raises DryStepError."""
    with np.errstate(all="ignore"):  # values that are not finite are refused below
        for at_s, reference_V in config.loop.references:
            _check_law(config, at_s, reference_V)
        return _check_steps(config)


def _check_law(config: ControllerConfig, at_s: float, reference_V: Pair) -> None:
    """The law says that it can hold the reference, if it can say so."""
    law = config.loop.law
    if not isinstance(law, ChecksReferences):
        return
    where = f"at the reference of {at_s:g} s ({reference_V[0]:.4g}, {reference_V[1]:.4g} V)"
    try:
        law.check(reference_V)
    except FAILURES as error:
        raise DryStepError(f"no control law {where}: {error}") from None
    except Exception as error:  # noqa: BLE001 - a law of a user's own may raise anything
        raise DryStepError(f"the law's check fails {where}: {type(error).__name__}: {error}") from None


def _check_steps(config: ControllerConfig) -> tuple[str, ...]:
    """The controller from disarmed into control, on readings of a healthy rig at its first reference."""
    state = ControllerState()
    inputs = _healthy_inputs(config)
    for number in range(STEPS):
        try:
            state, output = controller.step(config, state, inputs, round(number * config.loop.period_s * 1e9))
        except Exception as error:  # noqa: BLE001 - a design or detector of a user's own may raise anything
            raise DryStepError(f"a control step fails: {type(error).__name__}: {error}") from None
        record = output.record
        if record is None:
            continue
        shown = state.loop.request.feedback if state.loop is not None else None
        integrals = shown.integral_Vs if shown is not None else ()
        if not all(map(isfinite, (*record.raw_V, *record.estimated_V, *record.target_V, *integrals))):
            raise DryStepError("a control step gives a value that is not finite; look at tanks, pumps and sensors")
    return () if state.loop is None else tuple(state.loop.request.shown)


def _healthy_inputs(config: ControllerConfig) -> Inputs:
    limits = config.limits
    k = limits.level_gain_V_cm
    (y1, y2), most = config.loop.references[0][1], config.loop.pumps.max_drives
    v1, v2 = holding_voltages(limits.model, (y1 / k, y2 / k))
    h1, h2, h3, h4 = equilibrium(limits.model, (min(max(v1, 0.0), most[0]), min(max(v2, 0.0), most[1])))
    return Inputs(
        measurement=Measurement((k * h1, k * h2, k * h3, k * h4), (True, True, True, True), 0.0, READINGS),
        pumps=PumpFeedback((0.0, 0.0), (0.0, 0.0), NodeState.READY, 0, 0.0, 0.0),
        nodes=NodeHealth(0.0, rebooted=False, contract_matches=True),
        bus=BusHealth(accepted=1, rejected=0, send_failures=0, foreign_commands=0, is_up=True),
    )
