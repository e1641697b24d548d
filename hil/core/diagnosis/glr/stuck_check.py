"""Stuck check: whether the flow of a pump whose gain has changed still follows its voltage.

A pump that is stuck at some flow looks like one with another gain until its voltage changes. So after each change of a
gain a filter in which that pump's flow stays as it was continues beside the main filter, which follows the voltage
with the gain that was found. The law moves the voltage by what the pump lost or gained, and that tells the two apart:
either the flow has followed, and the check ends, or it has not. A slow pump is given time: its flow may begin to
follow later than a single lag says. Another change of the gain meanwhile is credited to
the main filter, with the evidence that it was declared for.

A pump that goes on fading while its voltage rises gives a constant flow, too. So a third filter continues in which the
gain changes at a constant rate, and the constant flow must explain the readings better than this as well.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np

from hil.core.diagnosis.glr import declaration, kernels
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import DOUBT, VOLTAGE
from hil.core.diagnosis.glr.growth import BOTH_GAINS
from hil.core.diagnosis.glr.hypotheses import GROWTH_STD
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import StuckCheck
from hil.core.diagnosis.glr.model import GAIN, LAG, PUMP, RATE, Array
from hil.core.types import Alarm

STUCK_ON = "pump_stuck_on"

STUCK_MOVED = 0.15
"""A pump is called stuck only when its voltage has moved by this share and its flow has not."""

SLOW_S, STUCK_LAGS = 1.0, 2.0
"""A pump with a longer lag than this is called stuck only when its voltage has been there for so many lags. The lag is
that of before the movement: a flow that does not follow makes it longer."""

MIN_VOLTAGE_V = 0.1


def begin(config: DetectorConfig, m: Memory, pump: int, number: int, detected_s: float, onset_s: float) -> None:
    """Check a pump (0, 1) whose gain was just declared changed; a check that is under way continues for longer."""
    until_s = m.t_s + config.tuning.stuck_check_s
    under_way = m.stuck_checks.get(pump)
    if under_way is not None:
        m.stuck_checks[pump] = replace(
            under_way, number=number, detected_s=detected_s, onset_s=onset_s, until_s=until_s
        )
        return
    x = m.x.copy()
    voltage_V = max(float(m.entry[VOLTAGE + pump]), MIN_VOLTAGE_V)
    flow_V = max(kernels.flow_voltage(x, pump, voltage_V, 0.0)[0], MIN_VOLTAGE_V)
    x[GAIN + pump] *= float(x[PUMP + pump]) / flow_V
    x[PUMP + pump] = flow_V
    growing_x, growing_P = _growing(m)
    lag_s = float(config.model.lag_s[pump] * m.x[LAG + pump])
    m.stuck_checks[pump] = StuckCheck(
        pump=pump,
        number=number,
        detected_s=detected_s,
        onset_s=onset_s,
        until_s=until_s,
        voltage_V=voltage_V,
        patience_s=STUCK_LAGS * lag_s if lag_s > SLOW_S else 0.0,
        x=x,
        P=m.P.copy(),
        growing_x=growing_x,
        growing_P=growing_P,
    )


def step(config: DetectorConfig, m: Memory, log_likelihood: float) -> list[Alarm]:
    """One step of every check. log_likelihood : of this step's readings in the main filter."""
    alarms: list[Alarm] = []
    if not m.stuck_checks:
        return alarms
    for p in list(m.stuck_checks.values()):
        grows = BOTH_GAINS if m.growing == BOTH_GAINS else GAIN + p.pump
        growing_likelihood = config.filter_beside(p.growing_x, p.growing_P, m.entry, grows)
        p.growing_evidence += growing_likelihood - log_likelihood
        entry = m.entry.copy()
        entry[VOLTAGE + p.pump], entry[DOUBT + p.pump] = p.voltage_V, 0.0
        alarms += judge(config, m, p, log_likelihood, config.filter_beside(p.x, p.P, entry, m.growing))
    return alarms


def has_found(m: Memory) -> bool:
    """Whether a pump is stuck. The run trips; and the filter follows the voltage, so what it misses says nothing."""
    return any(fault.kind == STUCK_ON for fault in m.declared.values())


def judge(
    config: DetectorConfig, m: Memory, p: StuckCheck, log_likelihood: float, stuck_likelihood: float
) -> list[Alarm]:
    """The alarm that a pump is stuck; the check ends with it, when it is refuted, and when its time is over."""
    detect = config.tuning.detect
    p.evidence += stuck_likelihood - log_likelihood
    has_moved = abs(float(m.entry[VOLTAGE + p.pump]) - p.voltage_V) >= STUCK_MOVED * p.voltage_V
    p.moved_since_s = min(p.moved_since_s, m.t_s) if has_moved else inf
    is_refuted = p.evidence < -detect and has_moved
    if is_refuted or m.t_s > p.until_s or p.pump not in m.declared:
        del m.stuck_checks[p.pump]
        return []
    needed = max(detect + max(p.growing_evidence, 0.0), _best_rival(m))
    if p.evidence < needed or m.t_s - p.moved_since_s < p.patience_s:
        return []
    del m.stuck_checks[p.pump]
    alarm = _declare(config, m, p)
    return [alarm, *_end_suspicion(m, alarm)]


def _declare(config: DetectorConfig, m: Memory, p: StuckCheck) -> Alarm:
    fault = m.declared[p.pump]
    m.declared[p.pump] = replace(fault, kind=STUCK_ON)
    low_V, high_V = config.range_V[p.pump]
    flow_V = float(p.x[GAIN + p.pump] * p.x[PUMP + p.pump]) / fault.healthy
    return Alarm(
        detected_s=p.detected_s,
        kind=STUCK_ON,
        target=p.pump + 1,
        size=min(max(flow_V, low_V), high_V),
        onset_s=p.onset_s,
        isolated_s=m.t_s,
        candidates=(f"{STUCK_ON} {p.pump + 1}",),
        number=p.number,
    )


def _end_suspicion(m: Memory, alarm: Alarm) -> list[Alarm]:
    """The end of an alarm that is open: the stuck pump explains the readings as well as anything else does.

    A lag of the same pump had a name in the same step, in 12 of 29 runs.
    """
    suspicion, m.suspicion = m.suspicion, None
    m.restart_bank()
    return [] if suspicion is None else declaration.close(m, suspicion, [alarm])


def credit(m: Memory, evidence: float) -> None:
    """The main filter has been replaced by one that explains the readings better by this log-likelihood ratio."""
    for check in m.stuck_checks.values():
        check.evidence -= evidence
        check.growing_evidence -= evidence


def _growing(m: Memory) -> tuple[Array, Array]:
    """State and covariance of a filter in which a gain changes at an unknown rate from now on."""
    x, P = m.x.copy(), m.P.copy()
    x[RATE] = 0.0
    P[RATE, :] = P[:, RATE] = 0.0
    P[RATE, RATE] = GROWTH_STD**2
    return x, P


def _best_rival(m: Memory) -> float:
    """Log-likelihood ratio, against the main filter, of the likeliest new fault while an alarm is open; 0 if none is.

    A pump that recovers or fails otherwise during the check is not stuck, although the main filter does not expect it.
    """
    if m.suspicion is None:
        return 0.0
    return float(np.max(np.where(m.replays.dropped == 1, -np.inf, m.replays.evidence)))
