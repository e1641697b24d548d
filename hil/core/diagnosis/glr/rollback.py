"""Back to an earlier step, and through the readings since once more, knowing better."""

from __future__ import annotations

from math import nan

from hil.core.diagnosis.glr import bank, process
from hil.core.diagnosis.glr.memory import Declared, Memory, Setup
from hil.core.diagnosis.glr.replay import RING

SAME_STEPS = 5
"""A fault that is said to have begun so few steps before its sensor failed, or later, may be the sensor's doing."""


def go_back(m: Memory, step: int) -> tuple[int, list[tuple[int, Declared]]]:
    """Put the filter to where it was at a step or before; where that is, and what is no longer declared, by place."""
    b, checkpoint = m.bank, m.checkpoint
    known = [s for s in range(bank.SLOTS) if b.onset[s] >= 0]
    old_enough = [s for s in known if b.onset[s] <= step]
    if not old_enough and checkpoint is not None and checkpoint.onset >= step - SAME_STEPS:
        m.x[:], m.P[:] = checkpoint.x, checkpoint.P
        withdrawn = [(j, fault) for j, fault in m.declared.items() if j not in checkpoint.declared]
        m.declared, m.checkpoint, m.probation = dict(checkpoint.declared), None, None
        return checkpoint.step, withdrawn
    slot = max(old_enough, key=lambda s: int(b.onset[s])) if old_enough else min(known, key=lambda s: int(b.onset[s]))
    m.x[:], m.P[:] = m.history.x[slot], m.history.P[slot]
    return int(b.onset[slot]), []


def revalue(m: Memory, start: int, sensor: int, variance_V2: float | None) -> None:
    """Give the readings of a sensor after a step this variance, or take them out (None)."""
    for step in range(start + 1, m.now + 1):
        entry = m.history.entries[step % RING]
        if variance_V2 is None:
            entry[2 + sensor] = nan
        else:
            entry[6 + sensor] = variance_V2


def relive(setup: Setup, m: Memory, start: int, end: int) -> None:
    """Filter and bank, which stand at step `start`, once more up to `end`."""
    b = m.bank
    m.restart_bank(start)
    for step in range(start + 1, end + 1):
        entry = m.history.entries[step % RING]
        m.history.none[step % RING] = process.step(
            setup.c, setup.walk, m.x, m.P, entry, m.A, m.K, m.white, m.innovation
        )
        bank.advance(setup.c[13], entry, m.A, m.K, m.white, m.innovation, b.effect, b.energy, b.match, b.cross)
        m.open_slot(step)
