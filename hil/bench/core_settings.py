"""Settings of a rig and a scenario in the records of `hil.core`: limits, start phase, probe, operator requests."""

from __future__ import annotations

from hil.core.active_isolation import ProbeConfig
from hil.core.interlocks import Limits
from hil.core.start_phase import StartConfig
from hil.core.types import Action, Request, TripCause
from hil.edge.config.rig_file import Rig
from hil.edge.config.scenario_file import DiagnosisChoice, OperatorRequest


def safety_limits(rig: Rig) -> Limits:
    """The supervisor's limits for a rig."""
    safety, path, model, (lag1, lag2) = rig.safety, rig.pump_path, rig.tank_model, rig.lags_s
    return Limits(
        range_V=rig.pumps.range_V,
        rate_V_s=rig.pumps.rate_V_s,
        stop_ramp_V_s=safety.stop_ramp_V_s,
        model=model,
        lag_s=(lag1 + path.delay_s[0], lag2 + path.delay_s[1]),
        level_gain_V_cm=model.level_gain_V_cm,
        level_max_cm=safety.level_max_cm,
        rim_margin_cm=safety.rim_margin_cm,
        levels_age_max_s=safety.levels_age_max_s,
        status_age_max_s=safety.status_age_max_s,
        heartbeat_age_max_s=safety.heartbeat_age_max_s,
        echo_age_max_s=safety.echo_age_max_s,
        echo_tolerance_V=safety.echo_tolerance_V,
        echo_mismatch_s=safety.echo_mismatch_s,
        invalid_run_max=safety.invalid_run_max,
        refused_run_max=safety.refused_run_max,
        errors_per_s_max=safety.errors_per_s_max,
        dead_below=safety.dead_below,
        dry_run_V=safety.dry_run_V,
        stops_on_dead_pump=safety.dead_pump == "stop",
        stops_on_lost_lower_level=safety.lost_lower_level == "stop",
        bypass_max_s=safety.bypass_max_s,
        pumps=path,
        unknown_fault_max_s=safety.unknown_fault_max_s,
        unattended_s=safety.unattended_s,
    )


def start_config(rig: Rig) -> StartConfig:
    """The start phase of a rig's runs."""
    return StartConfig(
        when=rig.start.when,
        rate_cm_s=rig.start.rate_cm_s,
        settle_s=rig.start.settle_s,
        tolerance_cm=rig.start.tolerance_cm,
        level_max_cm=rig.safety.level_max_cm,
        max_drives=rig.pump_path.max_drives,
        max_V=rig.pumps.range_V[1],
    )


def probe_config(choice: DiagnosisChoice) -> ProbeConfig:
    """When and how the controller probes, from a scenario's [diagnosis]."""
    return ProbeConfig(
        is_allowed=choice.probe,
        voltage_V=choice.probe_V,
        move_s=choice.probe_s,
        hold_s=choice.probe_hold_s,
        after_s=choice.probe_after_s,
        again_s=choice.probe_again_s,
    )


def operator_request(request: OperatorRequest) -> Request:
    """One of a scenario's [[request]] tables."""
    interlock = None if request.interlock is None else TripCause(request.interlock)
    return Request(Action(request.action), request.voltage_V, interlock, request.for_s or 0.0)
