"""The least time in which any detector can find a scenario's faults, from `detection_bound`."""

from __future__ import annotations

from functools import lru_cache
from math import ceil

from hil.bench.assembly import Bench, reference_schedule
from hil.core.tanks import holding_voltages
from hil.core.types import Pair
from hil.edge.config.rig_file import Rig

STEP_TOLERANCE = 1e-9


def information_bound(bench: Bench, reading_s: float) -> float | None:
    """Seconds that any detector needs for the scenario's faults; None unless they are lasting jumps of one onset.

    The pumps are taken to hold the reference that is in force when the fault begins. What is known between two control
    steps counts from the next one: no detector says anything before.
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
        jumps |= jumps_of_fault(fault.kind, fault.target, fault.value, model)
    if len(jumps) != len(faults):
        return None
    onset_s = onsets.pop()
    levels_V = [at for at in reference_schedule(bench.scenario, bench.rig, "") if at[0] <= onset_s][-1][1]
    k = model.level_gain_V_cm
    holding_V = holding_voltages(model, (levels_V[0] / k, levels_V[1] / k))
    bound_s = _bound(bench.rig, reading_s, tuple(sorted(jumps.items())), holding_V)
    if bound_s is None:
        return None
    period_s = bench.rig.control.period_s
    return ceil((onset_s + bound_s) / period_s - STEP_TOLERANCE) * period_s - onset_s


@lru_cache(maxsize=256)
def _bound(rig: Rig, reading_s: float, jumps: tuple[tuple[int, float], ...], holding_V: Pair) -> float | None:
    from hil.core.diagnosis.glr.detection_bound import detection_bound_s

    period_s, noise_V = rig.control.period_s, rig.sensors.noise_V
    return detection_bound_s(rig.tank_model, rig.pumps.lag_s, noise_V, dict(jumps), holding_V, period_s, reading_s)
