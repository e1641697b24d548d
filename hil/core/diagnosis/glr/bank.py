"""The bank: how well each jump, at each onset of the last minute, explains the innovations.

For a jump of size s at a known onset, the filter's innovations have mean s m(k): the signature m is what the jump
leaves in them, the filter's own reaction taken off: linear, so one recursion a candidate. Whitened, z(k), the
likelihood is best at s = sum(z e) / sum(z z); the log-likelihood ratio against no jump is then
sum(z e)^2 / (2 sum(z z)). Willsky and Jones (1976), sections III and IV.

Why this method: `docs/decisions/0009-diagnosis-by-likelihood-ratios.md`.

Onsets: every step for 2 s, then ever fewer, five to an octave, back to 64 s at 10 Hz.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.core.diagnosis.glr.compiled import compiled
from hil.core.diagnosis.glr.filter import PERIOD, READING, WEIGHT, StepResult, whitened
from hil.core.diagnosis.glr.hypotheses import JUMPS, PUMPS, H
from hil.core.diagnosis.glr.model import BIAS, DRIFT, MOVING, Array, Ints, N

SLOTS = 48
FRESH = 20
"""Every onset of so many steps back has a slot."""

PER_OCTAVE = 5
MAX_AGE = 640
"""Steps; older onsets have no slot."""

MIN_ENERGY = 1e-9
"""A jump with less, or a pair of pumps whose signatures are parallel but for this share, can't be sized."""

JUMP_STATES = tuple(jump.state for jump in JUMPS)


class Bank(NamedTuple):
    """The candidates; all arrays change in place.

    onset : (SLOTS,) step at which each slot's jumps begin; -1 for a free slot. effect : (N, H, SLOTS) what a unit jump
    has made of state minus estimate. energy, match : (H, SLOTS) sum(z z), sum(z e). cross : (SLOTS,) sum(z1 z2) of the
    two pumps.
    """

    onset: Ints
    effect: Array
    energy: Array
    match: Array
    cross: Array

    @classmethod
    def empty(cls) -> Bank:
        """No candidates."""
        return cls(
            onset=np.full(SLOTS, -1, dtype=np.int64),
            effect=np.zeros((N, H, SLOTS)),
            energy=np.zeros((H, SLOTS)),
            match=np.zeros((H, SLOTS)),
            cross=np.zeros(SLOTS),
        )

    def clear(self) -> None:
        """Forget all candidates."""
        self.onset[:] = -1
        self.effect[:] = 0.0
        self.energy[:] = 0.0
        self.match[:] = 0.0
        self.cross[:] = 0.0


class Best(NamedTuple):
    """The bank's answer, by hypothesis, that of both pumps last: the greatest ratio and its slot (-1: none).

    ratio, slot : (H + 1,).
    """

    ratio: Array
    slot: Ints

    @classmethod
    def empty(cls) -> Best:
        """No answer yet."""
        return cls(ratio=np.zeros(H + 1), slot=np.zeros(H + 1, dtype=np.int64))


class MinJumps(NamedTuple):
    """The smallest jumps up and down that count, by hypothesis, (H,) each; inf where there can't be one."""

    rise: Array
    fall: Array


@compiled
def update(
    level_gain: float, now: int, entry: Array, result: StepResult, bank: Bank, min_jumps: MinJumps, best: Best
) -> tuple[int, float]:
    """One step of the bank at step `now`: the slot of the onset that is new, and the greatest ratio of all."""
    advance(level_gain, entry, result, bank)
    slot = open_slot(now, bank)
    return slot, find_best(bank, min_jumps, best)


@compiled
def is_kept(onset: int, now: int) -> bool:
    """Whether the onset still has a slot at step `now`."""
    age = now - onset
    if age < FRESH:
        return True
    if age > MAX_AGE:
        return False
    spacing, end = FRESH // PER_OCTAVE, 2 * FRESH
    while age >= end:
        spacing, end = 2 * spacing, 2 * end
    return onset % spacing == 0


@compiled
def open_slot(now: int, bank: Bank) -> int:
    """Give jumps that begin at step `now` a slot; its number."""
    slot = 0
    for s in range(SLOTS):
        if bank.onset[s] < 0 or not is_kept(bank.onset[s], now):
            slot = s
            break
    bank.onset[slot] = now
    bank.cross[slot] = 0.0
    for j in range(H):
        bank.energy[j, slot] = 0.0
        bank.match[j, slot] = 0.0
        for i in range(N):
            bank.effect[i, j, slot] = 0.0
        bank.effect[JUMP_STATES[j], j, slot] = 1.0
    return slot


@compiled
def advance(level_gain: float, entry: Array, result: StepResult, bank: Bank) -> None:
    """Take in one step's innovations, `result` as `filter_step` wrote it."""
    effect = bank.effect.reshape((N, H * SLOTS))
    signature = _propagate(level_gain, entry, result.A, effect)
    _subtract_reaction(result.K, signature, effect)
    energy, match = bank.energy.reshape(H * SLOTS), bank.match.reshape(H * SLOTS)
    _accumulate(result.whitener, result.innovation, signature, energy, match, bank.cross)


@compiled
def _propagate(level_gain: float, entry: Array, A: Array, effect: Array) -> Array:
    """Move the effects (N, H SLOTS) on by one period; what they leave in the readings, (4, H SLOTS) V."""
    dt, weight = entry[PERIOD], entry[WEIGHT]
    count = effect.shape[1]
    moved = np.zeros((MOVING, count))
    for i in range(MOVING):
        for m in range(N):
            value = A[i, m]
            if value != 0.0:
                for n in range(count):
                    moved[i, n] += value * effect[m, n]
    signature = np.empty((4, count))
    for i in range(4):
        is_read = 1.0 if np.isfinite(entry[READING + i]) else 0.0
        for n in range(count):
            signature[i, n] = is_read * (
                level_gain * ((1.0 - weight) * effect[i, n] + weight * moved[i, n])
                + effect[BIAS + i, n]
                + weight * dt * effect[DRIFT + i, n]
            )
            effect[BIAS + i, n] += dt * effect[DRIFT + i, n]
    for i in range(MOVING):
        for n in range(count):
            effect[i, n] = moved[i, n]
    return signature


@compiled
def _subtract_reaction(K: Array, signature: Array, effect: Array) -> None:
    """The filter takes the signatures (4, H SLOTS) for a change of its states: effect <- effect - K signature."""
    count = effect.shape[1]
    for j in range(N):
        k0, k1, k2, k3 = K[j, 0], K[j, 1], K[j, 2], K[j, 3]
        if k0 != 0.0 or k1 != 0.0 or k2 != 0.0 or k3 != 0.0:
            for n in range(count):
                effect[j, n] -= (
                    k0 * signature[0, n] + k1 * signature[1, n] + k2 * signature[2, n] + k3 * signature[3, n]
                )


@compiled
def _accumulate(
    whitener: Array, innovation: Array, signature: Array, energy: Array, match: Array, cross: Array
) -> None:
    """Add the whitened signatures' energy and match (H SLOTS,), and the pumps' cross energy (SLOTS,)."""
    first_pump, second_pump = PUMPS[0] * SLOTS, PUMPS[1] * SLOTS
    for i in range(4):
        e = whitened(whitener, innovation, i)
        w0, w1, w2, w3 = whitener[i, 0], whitener[i, 1], whitener[i, 2], whitener[i, 3]
        for n in range(energy.shape[0]):
            z = w0 * signature[0, n] + w1 * signature[1, n] + w2 * signature[2, n] + w3 * signature[3, n]
            energy[n] += z * z
            match[n] += z * e
        for s in range(SLOTS):
            n = first_pump + s
            z1 = w0 * signature[0, n] + w1 * signature[1, n] + w2 * signature[2, n] + w3 * signature[3, n]
            n = second_pump + s
            z2 = w0 * signature[0, n] + w1 * signature[1, n] + w2 * signature[2, n] + w3 * signature[3, n]
            cross[s] += z1 * z2


@compiled
def find_best(bank: Bank, min_jumps: MinJumps, best: Best) -> float:
    """Greatest log-likelihood ratio of all; writes `best`."""
    best.ratio[:] = 0.0
    best.slot[:] = -1
    greatest = _find_best_single(bank, min_jumps, best)
    _find_best_pair(bank, min_jumps, best)
    return float(max(greatest, best.ratio[H]))


@compiled
def _find_best_single(bank: Bank, min_jumps: MinJumps, best: Best) -> float:
    """One jump: size = match/energy, ratio = match^2/(2 energy)."""
    greatest = 0.0
    for j in range(H):
        for s in range(SLOTS):
            if bank.onset[s] < 0 or bank.energy[j, s] <= MIN_ENERGY:
                continue
            size = bank.match[j, s] / bank.energy[j, s]
            smallest = min_jumps.rise[j] if size > 0.0 else min_jumps.fall[j]
            value = 0.5 * bank.match[j, s] * size
            if abs(size) >= smallest and value > best.ratio[j]:
                best.ratio[j] = value
                best.slot[j] = s
        greatest = max(greatest, best.ratio[j])
    return greatest


@compiled
def _find_best_pair(bank: Bank, min_jumps: MinJumps, best: Best) -> None:
    """Both pumps at once, the same way: two normal equations for two sizes."""
    first, second = PUMPS
    for s in range(SLOTS):
        if bank.onset[s] < 0:
            continue
        e1, e2, c = bank.energy[first, s], bank.energy[second, s], bank.cross[s]
        det = e1 * e2 - c * c
        if det <= MIN_ENERGY * e1 * e2:
            continue
        m1, m2 = bank.match[first, s], bank.match[second, s]
        s1, s2 = (e2 * m1 - c * m2) / det, (e1 * m2 - c * m1) / det
        smallest1 = min_jumps.rise[first] if s1 > 0.0 else min_jumps.fall[first]
        smallest2 = min_jumps.rise[second] if s2 > 0.0 else min_jumps.fall[second]
        value = 0.5 * (m1 * s1 + m2 * s2)
        is_allowed = s1 * s2 > 0.0 and abs(s1) >= smallest1 and abs(s2) >= smallest2
        if is_allowed and value > best.ratio[H]:
            best.ratio[H] = value
            best.slot[H] = s
