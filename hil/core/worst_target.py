"""The outputs to aim at while it is open what has failed: those that the rig can hold whatever candidate is true.

A reference that only a healthy rig can hold would drive a pump to its limit, and fill an upper tank, if a candidate is
true that the law does not know yet. So each candidate's rig is asked for the outputs nearest to the reference that it
can hold. The one that holds the least, that is the outputs farthest from the reference, binds. A rig that needs less
than nothing of a pump binds nothing: the pump rests, and no limit is in danger.
"""

from __future__ import annotations

from collections.abc import Sequence

from hil.core.pumps import PumpPath
from hil.core.reachable import nearest_reachable
from hil.core.reconfiguration import FAILURES, UNSURE_V, found_tanks
from hil.core.tanks import TankModel, holding_voltages
from hil.core.types import Pair, PossibleRig

STEP_V = 0.02
"""The outputs are rounded to this: sizes that are not known yet change a little all the time."""


def worst_target(model: TankModel, pumps: PumpPath, reference_V: Pair, rigs: Sequence[PossibleRig]) -> tuple[Pair, str]:
    """Outputs (2,) in V that every rig can hold, or nearly so, and why these are not the reference; "" if they are."""
    k, worst, found_V, why = model.level_gain_V_cm, 0.0, reference_V, ""
    wanted_cm = (reference_V[0] / k, reference_V[1] / k)
    for rig in rigs:
        reached_cm = _reached_cm(model, pumps, wanted_cm, rig)
        off_cm = max(abs(reached_cm[0] - wanted_cm[0]), abs(reached_cm[1] - wanted_cm[1]))
        if off_cm > worst:
            worst, why = off_cm, f"it may be {' and '.join(rig.names)}"
            found_V = (STEP_V * round(k * reached_cm[0] / STEP_V), STEP_V * round(k * reached_cm[1] / STEP_V))
    return found_V, why


def _reached_cm(model: TankModel, pumps: PumpPath, wanted_cm: Pair, rig: PossibleRig) -> Pair:
    """What a rig can hold; what its drives miss by less than UNSURE_V, or what can't be computed, is not judged.

    Nor is a drive below 0. With a lower outlet blocked it is far below, and the outputs nearest to the reference are
    far from it: a sensor that drifts, which looks the same, would send the rig there.
    """
    (e1, e2), (most1, most2) = rig.effectiveness, pumps.max_drives
    limit_V = (e1 * most1, e2 * most2)
    tanks, _ = found_tanks(model, rig.valve_split, rig.waterways)
    try:
        held_V = holding_voltages(tanks, wanted_cm)
        if all(held <= most + UNSURE_V for held, most in zip(held_V, limit_V, strict=True)):
            return wanted_cm
        return nearest_reachable(tanks, wanted_cm, limit_V, pumps).lower_cm
    except FAILURES:
        return wanted_cm
