"""The bank: how well each jump, at each onset of the last minute, explains the innovations.

For a jump of size s at a known onset, the filter's innovations have mean s m(k): the signature m is what the jump
leaves in them, the filter's own reaction taken off: linear, so one recursion a candidate. Whitened, z(k), the
likelihood is best at s = sum(z e) / sum(z z); the log-likelihood ratio against no jump is then
sum(z e)^2 / (2 sum(z z)). Willsky and Jones (1976), sections III and IV.

Onsets: every step for 2 s, then ever fewer, five to an octave, back to 64 s at 10 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.core.diagnosis.glr.hypotheses import JUMPS, H
from hil.core.diagnosis.glr.process import BIAS, DRIFT, MOVING, Array, Ints, N, compiled

SLOTS = 48
FRESH = 20
"""Every onset of so many steps back has a slot."""

PER_OCTAVE = 5
OLDEST = 640


@dataclass(frozen=True, eq=False)
class Bank:
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
            np.full(SLOTS, -1, dtype=np.int64),
            np.zeros((N, H, SLOTS)),
            np.zeros((H, SLOTS)),
            np.zeros((H, SLOTS)),
            np.zeros(SLOTS),
        )

    def clear(self) -> None:
        """Forget all candidates."""
        self.onset[:] = -1
        self.effect[:] = 0.0
        self.energy[:] = 0.0
        self.match[:] = 0.0
        self.cross[:] = 0.0


STATES = np.array([jump.state for jump in JUMPS])


@compiled
def is_kept(onset: int, now: int) -> bool:
    """Whether the onset still has a slot at step `now`."""
    age = now - onset
    if age < FRESH:
        return True
    if age > OLDEST:
        return False
    spacing, end = FRESH // PER_OCTAVE, 2 * FRESH
    while age >= end:
        spacing, end = 2 * spacing, 2 * end
    return onset % spacing == 0


@compiled
def open_slot(now: int, states: Ints, onset: Ints, effect: Array, energy: Array, match: Array, cross: Array) -> int:
    """Give jumps that begin at step `now` a slot; its number."""
    slot = 0
    for s in range(SLOTS):
        if onset[s] < 0 or not is_kept(onset[s], now):
            slot = s
            break
    onset[slot] = now
    cross[slot] = 0.0
    for j in range(H):
        energy[j, slot] = 0.0
        match[j, slot] = 0.0
        for i in range(N):
            effect[i, j, slot] = 0.0
        effect[states[j], j, slot] = 1.0
    return slot


@compiled
def advance(
    gain: float,
    entry: Array,
    A: Array,
    K: Array,
    white: Array,
    innovation: Array,
    effect: Array,
    energy: Array,
    match: Array,
    cross: Array,
) -> None:
    """Take one step's innovations in; A, K, white, innovation as `process.step` wrote them."""
    dt, w = entry[10], entry[11]
    count = H * SLOTS
    flat = effect.reshape((N, count))
    energies, matches = energy.reshape(count), match.reshape(count)
    moved = np.zeros((MOVING, count))
    for i in range(MOVING):
        for m in range(N):
            value = A[i, m]
            if value != 0.0:
                for n in range(count):
                    moved[i, n] += value * flat[m, n]
    seen = np.empty((4, count))
    for i in range(4):
        on = 1.0 if np.isfinite(entry[2 + i]) else 0.0
        for n in range(count):
            seen[i, n] = on * (
                gain * ((1.0 - w) * flat[i, n] + w * moved[i, n]) + flat[BIAS + i, n] + w * dt * flat[DRIFT + i, n]
            )
            flat[BIAS + i, n] += dt * flat[DRIFT + i, n]
    for i in range(MOVING):
        for n in range(count):
            flat[i, n] = moved[i, n]
    for j in range(N):
        k0, k1, k2, k3 = K[j, 0], K[j, 1], K[j, 2], K[j, 3]
        if k0 != 0.0 or k1 != 0.0 or k2 != 0.0 or k3 != 0.0:
            for n in range(count):
                flat[j, n] -= k0 * seen[0, n] + k1 * seen[1, n] + k2 * seen[2, n] + k3 * seen[3, n]
    for i in range(4):
        e = 0.0
        for m in range(i + 1):
            e += white[i, m] * innovation[m]
        w0, w1, w2, w3 = white[i, 0], white[i, 1], white[i, 2], white[i, 3]
        for n in range(count):
            z = w0 * seen[0, n] + w1 * seen[1, n] + w2 * seen[2, n] + w3 * seen[3, n]
            energies[n] += z * z
            matches[n] += z * e
        for s in range(SLOTS):
            first = w0 * seen[0, s] + w1 * seen[1, s] + w2 * seen[2, s] + w3 * seen[3, s]
            t = SLOTS + s
            second = w0 * seen[0, t] + w1 * seen[1, t] + w2 * seen[2, t] + w3 * seen[3, t]
            cross[s] += first * second


@compiled
def best(
    least_rise: Array, least_fall: Array, onset: Ints, energy: Array, match: Array, cross: Array,
    ratio: Array, slot: Ints,
) -> float:  # fmt: skip
    """Greatest log-likelihood ratio of all; per hypothesis the greatest, ratio (H + 1,), and its slot (H + 1,).

    least_rise, least_fall : (H,) the smallest jump up, down that counts; inf where there can't be one.
    """
    greatest = 0.0
    ratio[:] = 0.0
    slot[:] = -1
    for j in range(H):
        for s in range(SLOTS):
            if onset[s] < 0 or energy[j, s] <= 1e-9:
                continue
            size = match[j, s] / energy[j, s]
            least = least_rise[j] if size > 0.0 else least_fall[j]
            value = 0.5 * match[j, s] * size
            if abs(size) >= least and value > ratio[j]:
                ratio[j] = value
                slot[j] = s
        greatest = max(greatest, ratio[j])
    for s in range(SLOTS):
        if onset[s] < 0:
            continue
        e1, e2, c = energy[0, s], energy[1, s], cross[s]
        det = e1 * e2 - c * c
        if det <= 1e-9 * e1 * e2:
            continue
        m1, m2 = match[0, s], match[1, s]
        s1, s2 = (e2 * m1 - c * m2) / det, (e1 * m2 - c * m1) / det
        least1 = least_rise[0] if s1 > 0.0 else least_fall[0]
        least2 = least_rise[1] if s2 > 0.0 else least_fall[1]
        value = 0.5 * (m1 * s1 + m2 * s2)
        if s1 * s2 > 0.0 and abs(s1) >= least1 and abs(s2) >= least2 and value > ratio[H]:
            ratio[H] = value
            slot[H] = s
    return float(max(greatest, ratio[H]))
