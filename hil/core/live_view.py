"""What an operator sees of a control step, as plain numbers and text by name."""

from __future__ import annotations

from math import sqrt
from typing import Any

from hil.core import live_plan, supervisor
from hil.core.controller import ControllerConfig, ControllerState, Output
from hil.core.loop_state import LoopState
from hil.core.sensors import levels_shown
from hil.core.types import ALL_SENSORS, Diagnosis, Inputs, Mode, Quad

MAX_ALARMS = 100
"""Rows of the alarm list that are shown, the most urgent ones: the state has to fit into one message."""

UNKNOWN_PAIR, UNKNOWN_QUAD = (None, None), (None, None, None, None)


def view(
    config: ControllerConfig, state: ControllerState, inputs: Inputs, output: Output, now_ns: int
) -> dict[str, Any]:
    """The `state` of docs/reference/control-channel.md. config : with the scenario's references."""
    limits, supervision, loop, record = config.limits, state.supervision, state.loop, output.record
    k, mode = limits.level_gain_V_cm, supervision.mode
    is_waiting = mode in (Mode.DISARMED, Mode.READY)
    return {
        "t_s": None if loop is None else loop.t_s,
        "mode": mode.name,
        "held": state.operation.is_held,
        "starting": loop is not None and loop.is_starting,
        "measured_cm": [level_V / k for level_V in inputs.measurement.level_V],
        "estimated_cm": UNKNOWN_QUAD if loop is None else loop.estimate.level_cm,
        "trusted": ALL_SENSORS if loop is None else loop.diagnosis.trusted,
        "reference_cm": UNKNOWN_PAIR if record is None else [level_V / k for level_V in record.reference_V],
        "target_cm": UNKNOWN_PAIR if record is None else [level_V / k for level_V in record.target_V],
        "command_V": output.command.voltage_V,
        "applied_V": inputs.pumps.applied_V,
        **_water(config, inputs, loop),
        "interlock": str(supervision.cause or ""),
        "bypassed": {str(cause): (until_ns - now_ns) * 1e-9 for cause, until_ns in supervision.bypasses},
        "waits_for": supervisor.not_ready(limits, inputs) if is_waiting or mode is Mode.TRIPPED else "",
        "iae_Vs": UNKNOWN_PAIR if loop is None else loop.iae_Vs,
        "lateness_s": inputs.timing.lateness_s,
        "skipped": inputs.timing.skipped,
        "next": _next(config, state, loop),
        "alarms": state.alarms.rows(0.0 if loop is None else loop.t_s, MAX_ALARMS),
        "alarms_more": max(len(state.alarms.alarms) - MAX_ALARMS, 0),
    }


def _water(config: ControllerConfig, inputs: Inputs, loop: LoopState | None) -> dict[str, object]:
    """Flows and what they depend on, as diagnosed."""
    model = config.limits.model
    diagnosis = Diagnosis() if loop is None else loop.diagnosis
    shown_cm = levels_shown(inputs.measurement.level_V, config.limits.level_gain_V_cm)
    level_cm = shown_cm if loop is None else loop.estimate.level_cm
    ways = diagnosis.waterways
    split = diagnosis.valve_split or model.valve_split if ways is None else ways.split
    own = (1.0, 1.0, 1.0, 1.0) if ways is None else ways.outlet
    pump_gain = (1.0, 1.0) if ways is None else ways.gain
    drives = config.limits.pumps.drive(inputs.pumps.applied_V)
    flows = [
        k_pump * gain * theta * drive
        for k_pump, gain, theta, drive in zip(
            model.pump_gain_cm3_Vs, pump_gain, diagnosis.effectiveness, drives, strict=True
        )
    ]
    return {
        "effectiveness": diagnosis.effectiveness,
        "pump_flow_cm3_s": flows,
        "split": split,
        "outflow_cm3_s": _outflows(model.outlet_cm2, own, model.datum_cm, level_cm, model.gravity_cm_s2),
    }


def _outflows(outlet_cm2: Quad, own: Quad, datum_cm: Quad, level_cm: Quad, gravity: float) -> list[float]:
    """Through each outlet, leaks left out, cm^3/s."""
    return [
        a * share * sqrt(max(2.0 * gravity * (h + d), 0.0)) if h > 0.0 else 0.0
        for a, share, d, h in zip(outlet_cm2, own, datum_cm, level_cm, strict=True)
    ]


def _next(config: ControllerConfig, state: ControllerState, loop: LoopState | None) -> dict[str, object] | None:
    """What the scenario does next, and in how many seconds; None if nothing, or while its clock stands."""
    if loop is None or state.operation.is_held:
        return None
    t_s, plan = loop.t_s, state.operation.plan
    coming = [(at_s, "reference") for at_s, _ in config.loop.references] if plan is None else []
    if plan is not None:
        coming = [(at_s, "reference") for at_s, _ in plan.schedule]
    coming += [(state.operation.run_s(at_s), request.action.value) for at_s, request in config.requests]
    coming.append((state.operation.run_s(config.duration_s), "end"))
    at_s, what = min((one for one in coming if one[0] > t_s), default=(live_plan.NEVER_S, ""))
    return None if at_s == live_plan.NEVER_S else {"in_s": at_s - t_s, "what": what}
