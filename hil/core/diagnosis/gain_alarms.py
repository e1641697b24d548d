"""From estimates of the pumps' gains to a diagnosis by fixed thresholds, as the simple detectors do it.

A pump is faulty when its estimated gain has stayed below ALARM_BELOW for CONFIRM_S, and healthy again when it has
stayed above RECOVERED_ABOVE for RECOVERY_S. In between its effectiveness is the estimate. Thresholds are fixed: they
must leave room for the differences between a rig and its file, some per cent, and for noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hil.core.types import Alarm, Diagnosis, Pair

ALARM_BELOW, RECOVERED_ABOVE = 0.8, 0.9
CONFIRM_S, RECOVERY_S = 0.4, 5.0
UPDATE_CHANGE = 0.05
"""Change of an estimate after which its alarm is updated."""

MAX_FAULTY = 0.999
"""Largest gain of a pump that counts as faulty; 1 is a healthy one."""


@dataclass(frozen=True, slots=True)
class GainAlarms:
    """since_s : (2,) since when each pump's estimate has been beyond its threshold; None if it is not.

    told : (2,) gains of the last alarms; 1 for a healthy pump.
    """

    since_s: tuple[float | None, float | None] = (None, None)
    told: Pair = (1.0, 1.0)


HEALTHY_PUMPS = GainAlarms()


def judge(before: GainAlarms, t_s: float, gain: Sequence[float], std: Sequence[float]) -> tuple[GainAlarms, Diagnosis]:
    """The diagnosis at run time t_s. gain, std : (2,) estimates over healthy gains, and their standard deviations."""
    since: list[float | None] = []
    told, effectiveness, alarms = [], [], []
    for pump in (0, 1):
        estimate, last = min(max(gain[pump], 0.0), 1.5), before.told[pump]
        is_faulty = last != 1.0
        is_beyond = estimate > RECOVERED_ABOVE if is_faulty else estimate < ALARM_BELOW
        begun = before.since_s[pump]
        begun = (t_s if begun is None else begun) if is_beyond else None
        is_due = begun is not None and t_s - begun >= (RECOVERY_S if is_faulty else CONFIRM_S) - 1e-6
        now = last
        if is_due:
            now, begun = (1.0 if is_faulty else estimate), None
        elif is_faulty and abs(min(estimate, MAX_FAULTY) - last) >= UPDATE_CHANGE:
            now = min(estimate, MAX_FAULTY)
        since.append(begun)
        told.append(now)
        effectiveness.append(1.0 if now == 1.0 else estimate)
        if now != last:
            alarms.append(_alarm(t_s, pump, now, std[pump]))
    memory = GainAlarms((since[0], since[1]), (told[0], told[1]))
    return memory, Diagnosis(effectiveness=(effectiveness[0], effectiveness[1]), new_alarms=tuple(alarms))


def _alarm(t_s: float, pump: int, gain: float, std: float) -> Alarm:
    return Alarm(
        detected_s=t_s,
        kind="pump_effectiveness",
        target=pump + 1,
        size=gain,
        size_std=std,
        onset_s=t_s - CONFIRM_S,
        isolated_s=t_s,
        candidates=(f"pump_effectiveness {pump + 1}",),
        number=pump + 1,
        is_recovery=gain == 1.0,
    )
