"""Pumps that steadily give more or less than the rig file says.

The filter learns such a pump without an alarm, see `first_day`. Once it is known well enough, it is reported as
`pump_effectiveness`, which may be above 1, and the control law uses it: the operating voltages are wrong by as much.
"""

from __future__ import annotations

from math import nan, sqrt

import numpy as np

from hil.core.diagnosis.glr import kernels
from hil.core.diagnosis.glr.filter import PERIOD, VOLTAGE
from hil.core.diagnosis.glr.hypotheses import PUMPS
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Strength
from hil.core.diagnosis.glr.model import BEND, GAIN, PUMP, SCALE, ZONE, Array
from hil.core.types import Alarm, Pair

MIN_DIFFERENCE, CHANGE = 0.1, 0.05
"""Of what a pump gives, over what its file says: what is reported, and the change of it that is reported again."""

MAX_STD, SURE_STDS = 0.02, 4.0
HOLD_S = 10.0
"""So well must it be known, and for so long."""

MAX_WIDE_STD = 0.04
"""And so well by the filter that leaves room for another rig, where the file is still believed."""

MIN_VOLTAGE_V = 1.0
"""At a smaller voltage the dead zone decides."""

REPORT_S = 300.0
"""A difference that shows later than this after the first reading is not the rig's own. A sensor that drifts slowly
moves what the filter knows of the pumps, and a name would hide it from the watch of the inflow."""

LOST_SHARE = 0.4
"""A smaller share of what was reported is a pump that has failed, whenever it shows: the filter has learned it as the
rig's own, as of one that fails while it stands still, and shows it when the voltage moves."""

MAX_FLOW_STD, MAX_FLOW_V = 0.05, 15.0
"""What a pump gives now counts if it is known so well, as a share, and up to this."""

MAX_STRENGTH = 2.0
"""The control law assumes no more."""


def step(m: Memory) -> list[Alarm]:
    """One step; the alarms of pumps that are known by now."""
    is_late = m.t_s - m.begun_s > REPORT_S
    alarms = []
    for pump in PUMPS:
        if is_late and not _is_lost(m, pump):
            m.steady_s[pump] = 0.0
            continue
        is_busy = m.suspicion is not None or pump in m.declared or float(m.entry[VOLTAGE + pump]) < MIN_VOLTAGE_V
        if is_busy or not _is_clear(m, pump):
            m.steady_s[pump] = 0.0
            continue
        m.steady_s[pump] += float(m.entry[PERIOD])
        if m.steady_s[pump] >= HOLD_S:
            m.steady_s[pump] = 0.0
            alarms.append(_report(m, pump, _share(m, pump), _std(m, pump)))
    return alarms


def effectiveness(m: Memory) -> Pair:
    """(2,) what each pump gives over what its file says, as reported; 1 if nothing was."""
    if not m.strength:
        return 1.0, 1.0
    first, second = (m.strength[pump].share if pump in m.strength else 1.0 for pump in PUMPS)
    return first, second


def flow_V(m: Memory) -> Pair:  # noqa: N802 - a unit
    """(2,) drives of pumps as their file has them that would give what these give now; 0 where that is not well known.

    Only on a rig that is proven not to be as its file says.
    """
    if not m.is_wide or m.unknown is not None:
        return 0.0, 0.0
    first, second = (_flow_V(m, pump) for pump in PUMPS)
    return first, second


def _flow_V(m: Memory, pump: int) -> float:  # noqa: N802 - a unit
    states = [SCALE + pump, GAIN + pump, PUMP + pump]
    scale, gain, lagged_V = m.x[states].tolist()
    slope = np.array([gain * lagged_V, scale * lagged_V, scale * gain])
    given_V = float(scale * gain * lagged_V)
    std_V = sqrt(max(float(slope @ m.P[np.ix_(states, states)] @ slope), 0.0))
    return min(given_V, MAX_FLOW_V) if std_V <= MAX_FLOW_STD * given_V else 0.0


def _report(m: Memory, pump: int, share: float, std: float) -> Alarm:
    told = m.strength.get(pump)
    if told is None:
        m.alarms += 1
        told = Strength(number=m.alarms, detected_s=m.t_s, share=1.0)
    is_recovery = abs(share - 1.0) < CHANGE
    if is_recovery:
        m.strength.pop(pump, None)
    else:
        m.strength[pump] = told._replace(share=min(share, MAX_STRENGTH))
    return Alarm(
        detected_s=m.t_s if is_recovery else told.detected_s,
        kind="pump_effectiveness",
        target=pump + 1,
        size=share,
        size_std=std,
        onset_s=nan,
        isolated_s=m.t_s,
        candidates=(f"pump_effectiveness {pump + 1}",),
        number=told.number,
        is_recovery=is_recovery,
    )


def _is_lost(m: Memory, pump: int) -> bool:
    """Whether a pump gives far less than was reported, on a rig that is proven not to be as its file says."""
    told = m.strength.get(pump)
    return m.is_wide and _share(m, pump) < LOST_SHARE * (told.share if told else 1.0)


def _is_clear(m: Memory, pump: int) -> bool:
    """Whether a pump certainly gives another share than its file says, or than was reported."""
    told = m.strength.get(pump)
    difference = abs(_share(m, pump) - (told.share if told else 1.0))
    if difference < (CHANGE if told else MIN_DIFFERENCE):
        return False
    std = _std(m, pump)
    return std <= MAX_STD and difference >= SURE_STDS * std and _is_agreed(m, pump)


def _is_agreed(m: Memory, pump: int) -> bool:
    """Whether the filter that leaves room for other outlets and curves says the same, and knows it.

    On the ramp of a start phase the other one, which believes the file's outlets, gave 0.89 for a pump with 0.78.
    """
    if m.is_wide or m.wide is None:
        return True
    difference = abs(_share_of(m.wide.x, m, pump) - _share(m, pump))
    return difference < CHANGE and _std_of(m.wide.x, m.wide.P, m, pump) <= MAX_WIDE_STD


def _share(m: Memory, pump: int) -> float:
    """What a pump gives at its present voltage, over what its file says."""
    return _share_of(m.x, m, pump)


def _share_of(x: Array, m: Memory, pump: int) -> float:
    """The same by the state of a filter."""
    voltage_V = max(float(m.entry[VOLTAGE + pump]), MIN_VOLTAGE_V)
    flow_V, _, _ = kernels.flow_voltage(x, pump, voltage_V, 0.0)
    return float(x[SCALE + pump]) * flow_V / voltage_V


def _std(m: Memory, pump: int) -> float:
    """Standard deviation of `_share`."""
    return _std_of(m.x, m.P, m, pump)


def _std_of(x: Array, P: Array, m: Memory, pump: int) -> float:
    """The same by the state of a filter."""
    voltage_V = max(float(m.entry[VOLTAGE + pump]), MIN_VOLTAGE_V)
    flow_V, by_zone, by_bend = kernels.flow_voltage(x, pump, voltage_V, 0.0)
    scale = float(x[SCALE + pump])
    states = [SCALE + pump, ZONE + pump, BEND + pump]
    slope = np.array([flow_V, scale * by_zone, scale * by_bend]) / voltage_V
    return sqrt(max(float(slope @ P[np.ix_(states, states)] @ slope), 0.0))
