"""The monitors: what the interlocks need to know of the levels, beside the fault detector's diagnosis.

Each monitor has a module of its own. This one steps them together, and makes the `Belief` of the supervisor from
their results and the state of the loop.
"""

from __future__ import annotations

from math import isfinite, isnan
from typing import NamedTuple

from hil.core import start_phase
from hil.core.dry_watch import DryWatch, watch_dry
from hil.core.filling_watch import FillingWatch, watch_filling
from hil.core.inflow_watch import NOT_RISEN, InflowWatch, watch_inflow
from hil.core.interlocks import Belief, Limits
from hil.core.live_levels import NONE, LiveLevels, live_levels_cm, watch_readings
from hil.core.loop_state import LoopState
from hil.core.overshoot import Outlets, rebase, watch
from hil.core.start_phase import Doubts
from hil.core.types import Diagnosis, Measurement, Pair, Quad


class Monitors(NamedTuple):
    """States of the monitors that the interlocks use.

    outlets : by the levels of the loop. live_outlets : by those of the live sensors that are not trusted. filling :
    from the start phase on. doubts : alarms that are not resolved. effectiveness : (2,) of the pumps at the last step.
    """

    outlets: Outlets = Outlets()
    live_outlets: Outlets = Outlets()
    live: LiveLevels = LiveLevels()
    inflow: InflowWatch = InflowWatch()
    dry: DryWatch = DryWatch()
    filling: FillingWatch = FillingWatch()
    doubts: Doubts = ()
    effectiveness: Pair = (1.0, 1.0)


def step_monitors(
    limits: Limits, monitors: Monitors, loop: LoopState, measurement: Measurement, now_ns: int, *, accommodates: bool
) -> tuple[Monitors, Belief]:
    """One step of the monitors, and what the supervisor may assume from them and from the loop.

    accommodates : whether the law follows the diagnosis.
    """
    model, diagnosis, estimate = limits.model, loop.diagnosis, loop.estimate
    live = watch_readings(model, limits.max_drives, monitors.live, measurement, diagnosis.trusted, now_ns)
    live_cm = live_levels_cm(model, live, measurement, diagnosis)
    effective_V = _effective(diagnosis, estimate.pump_V)
    flowing_V = _larger(effective_V, diagnosis.flow_V)  # a pump that gives or lags more seemed to be a shut outlet
    outlets = monitors.outlets
    if diagnosis.new_alarms:
        learned_V = _learned(monitors.effectiveness, diagnosis, estimate.pump_V)
        outlets = rebase(model, outlets, estimate.level_cm, learned_V)
    outlets = live_outlets = watch(model, outlets, estimate.level_cm, flowing_V, now_ns)
    if live_cm != NONE:
        levels_cm = _with_live(estimate.level_cm, live_cm)
        live_outlets = watch(model, monitors.live_outlets, levels_cm, effective_V, now_ns)
    dry = watch_dry(model, monitors.dry, estimate.level_cm, estimate.pump_V, diagnosis.trusted, now_ns)
    filling = monitors.filling
    if loop.start is not None and loop.t_s <= start_phase.DOUBTED_UNTIL_S:
        filling = watch_filling(model, filling, estimate.level_cm, effective_V, diagnosis.trusted, now_ns)
    inflow = InflowWatch()
    if not loop.is_starting:
        risen = filling.rises() if loop.t_s <= 2.0 * start_phase.DOUBTED_UNTIL_S else NOT_RISEN
        inflow = watch_inflow(model, monitors.inflow, estimate.level_cm, effective_V, diagnosis, now_ns, risen)
    open_share = outlets.open_share
    if live_outlets is not outlets:
        open_share = _smaller(open_share, live_outlets.open_share)
    belief = Belief(
        diagnosis=diagnosis,
        level_cm=estimate.level_cm,
        pump_V=_larger(estimate.pump_V, loop.under_way.largest()),
        accommodates=accommodates,
        open_share=open_share,
        live_cm=live_cm,
        law_problem=loop.problem,
        possible_cm=inflow.possible_cm(model, estimate.level_cm, diagnosis),
        is_dry=dry.is_dry,
    )
    doubts = start_phase.open_doubts(monitors.doubts, diagnosis.new_alarms, loop.t_s)
    monitors = Monitors(
        outlets=outlets,
        live_outlets=live_outlets,
        live=live,
        inflow=inflow,
        dry=dry,
        filling=filling,
        doubts=doubts,
        effectiveness=diagnosis.effectiveness,
    )
    return monitors, belief


def _effective(diagnosis: Diagnosis, pump_V: Pair) -> Pair:
    (theta1, theta2), (v1, v2) = diagnosis.effectiveness, pump_V
    return theta1 * v1, theta2 * v2


def _learned(before: Pair, diagnosis: Diagnosis, pump_V: Pair) -> Pair:
    """(2,) by how much the drive of a pump is now believed to differ from what it was, where it has done so all along.

    That is what a report of a pump without an onset says: the rig is not as its file.
    """
    reports = [alarm for alarm in diagnosis.new_alarms if alarm.kind == "pump_effectiveness" and isnan(alarm.onset_s)]
    learned = {alarm.target for alarm in reports}
    first, second = (
        (now - then) * voltage_V if pump in learned else 0.0
        for pump, now, then, voltage_V in zip((1, 2), diagnosis.effectiveness, before, pump_V, strict=True)
    )
    return first, second


def _with_live(level_cm: Quad, live_cm: Quad) -> Quad:
    """The levels, with those that sensors without trust still show."""
    h1, h2, h3, h4 = (live if isfinite(live) else level for level, live in zip(level_cm, live_cm, strict=True))
    return h1, h2, h3, h4


def _larger(first: Pair, second: Pair) -> Pair:
    return max(first[0], second[0]), max(first[1], second[1])


def _smaller(first: Pair, second: Pair) -> Pair:
    return min(first[0], second[0]), min(first[1], second[1])
