"""How soon at the least half of all runs can have an alarm of a scenario's faults, from `detection_bound`."""

from __future__ import annotations

from functools import lru_cache
from math import ceil, floor

from hil.bench.assembly import Bench
from hil.bench.reference_plan import reference_plan
from hil.core.fault_kinds import FaultKind
from hil.core.tanks import holding_voltages
from hil.core.types import Pair
from hil.edge.config.rig_file import Rig
from hil.edge.config.scenario_file import Fault

STEP_TOLERANCE = 1e-9
LEARNING_S = 60.0
"""The time before the fault is rounded up to a multiple of this, so that runs share a bound. More time teaches more."""


def detection_bound(bench: Bench, reading_s: float) -> float | None:
    """Seconds until a detector can have found the scenario's faults in half of all runs, in the best case.

    None unless the faults are lasting jumps of one onset. The pumps are taken to hold each reference from its
    beginning. What is known between two control steps counts from the next one: no detector says anything before.
    """
    faults = bench.scenario.fault
    onsets = {fault.at_s for fault in faults}
    if bench.scenario.diagnosis.method != "glr" or len(onsets) != 1:
        return None
    if any(fault.ramp_s > 0.0 or fault.period_s is not None for fault in faults):
        return None
    from hil.core.diagnosis.glr.detection_bound import jumps_of_fault

    model = bench.rig.tank_model
    jumps: dict[int, float] = {}
    for fault in faults:
        if not isinstance(fault.target, int):
            return None
        jumps |= jumps_of_fault(fault.kind, fault.target, _signal_value(bench.rig, fault), model)
    if len(jumps) != len(faults):
        return None
    onset_s = onsets.pop()
    bound_s = _bound(bench.rig, reading_s, tuple(sorted(jumps.items())), _held(bench, onset_s))
    if bound_s is None:
        return None
    bound_s += min(_way_s(bench.rig, fault) for fault in faults)
    return delay_of_step(onset_s, bound_s, reading_s, bench.rig.control.period_s)


def _signal_value(rig: Rig, fault: Fault) -> float | None:
    """The value of a fault; that of a sensor's bias or drift as one of the level signal."""
    is_of_sensor = fault.kind in (FaultKind.SENSOR_BIAS, FaultKind.SENSOR_DRIFT)
    if fault.value is None or not is_of_sensor or fault.target not in (1, 2, 3, 4):
        return fault.value
    return fault.value * rig.level_sensors.factor[int(fault.target) - 1]


def _way_s(rig: Rig, fault: Fault) -> float:
    """How much later than at the pump a fault arrives at the tanks."""
    is_at_pump = fault.kind in (FaultKind.PUMP_EFFECTIVENESS, FaultKind.PUMP_DEAD)
    return rig.pump_path.delay_s[int(fault.target) - 1] if is_at_pump else 0.0


def delay_of_step(onset_s: float, bound_s: float, reading_s: float, period_s: float) -> float:
    """Seconds from the onset to the first control step at which the readings suffice.

    bound_s : from an onset just after a reading. A later onset shows less in each reading, so it is found no sooner.
    """
    read_s = floor(onset_s / reading_s + STEP_TOLERANCE) * reading_s
    return ceil((read_s + bound_s) / period_s - STEP_TOLERANCE) * period_s - onset_s


def _held(bench: Bench, onset_s: float) -> tuple[tuple[float, Pair], ...]:
    """How long the pumps hold each reference up to the onset, s, and at which voltages."""
    model = bench.rig.tank_model
    k = model.level_gain_V_cm
    schedule = [at for at in reference_plan(bench.scenario, bench.rig, str(bench.scenario_path))[0] if at[0] <= onset_s]
    held = []
    for (from_s, (y1, y2)), until_s in zip(schedule, [*(at for at, _ in schedule[1:]), onset_s], strict=True):
        is_last = until_s == onset_s
        time_s = ceil((until_s - from_s) / LEARNING_S) * LEARNING_S if is_last else until_s - from_s
        held.append((time_s, holding_voltages(model, (y1 / k, y2 / k))))
    return tuple(held)


@lru_cache(maxsize=256)
def _bound(
    rig: Rig, reading_s: float, jumps: tuple[tuple[int, float], ...], held: tuple[tuple[float, Pair], ...]
) -> float | None:
    from hil.core.diagnosis.glr.detection_bound import detection_bound_s

    model, period_s = rig.tank_model, rig.control.period_s
    return detection_bound_s(model, rig.lags_s, rig.signal_noise, dict(jumps), held, period_s, reading_s)
