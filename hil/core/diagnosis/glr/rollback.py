"""Return to an earlier step, and filter the readings since then again with what is known now."""

from __future__ import annotations

from math import nan

from hil.core.diagnosis.glr import bank, kernels
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import PERIOD, READING, VARIANCE
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Declared
from hil.core.diagnosis.glr.refilter import RING

SAME_STEPS = 5
"""A fault whose onset is at most this many steps before the failure of its sensor may be caused by the sensor."""


def go_back(m: Memory, step: int) -> tuple[int, list[tuple[int, Declared]]]:
    """Set the filter to its state at a step or before; that step, and the faults that are no longer declared."""
    b, checkpoint = m.bank, m.checkpoint
    known = [s for s in range(bank.SLOTS) if b.onset[s] >= 0]
    old_enough = [s for s in known if b.onset[s] <= step]
    if not old_enough and checkpoint is not None and checkpoint.onset >= step - SAME_STEPS:
        m.x[:], m.P[:] = checkpoint.x, checkpoint.P
        withdrawn = [(j, fault) for j, fault in m.declared.items() if j not in checkpoint.declared]
        m.declared, m.checkpoint, m.stuck_checks = dict(checkpoint.declared), None, {}
        return checkpoint.step, withdrawn
    slot = max(old_enough, key=lambda s: int(b.onset[s])) if old_enough else min(known, key=lambda s: int(b.onset[s]))
    m.x[:], m.P[:] = m.history.x[slot], m.history.P[slot]
    return int(b.onset[slot]), []


def set_reading_variance(m: Memory, start: int, sensor: int, variance_V2: float | None) -> None:
    """Set the variance of a sensor's readings after a step, or remove the readings (None)."""
    for step in range(start + 1, m.now + 1):
        entry = m.history.entries[step % RING]
        if variance_V2 is None:
            entry[READING + sensor] = nan
        else:
            entry[VARIANCE + sensor] = variance_V2


def refilter(config: DetectorConfig, m: Memory, start: int, end: int) -> None:
    """Run filter and bank, whose state is that at step `start`, again up to `end`."""
    m.restart_bank(start)
    for step in range(start + 1, end + 1):
        entry = m.history.entries[step % RING]
        kernels.grow(m.x, m.P, m.growing, entry[PERIOD])
        m.history.no_jump[step % RING] = kernels.filter_step(config.model, m.x, m.P, entry, m.result)
        kernels.advance_bank(config.model.level_gain_V_cm, entry, m.result, m.bank)
        m.open_slot(step)
