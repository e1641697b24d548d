"""Faults that grow: one rate, a state of the filter, moves the parameter that is said to change.

The rate is constant but for a small random walk in proportion to itself, so that the growth may become faster or slower
or end. It is 0 with zero variance, and so has no effect, until a hypothesis of growth gives it a variance. Both pumps
together grow at one rate.
"""

from __future__ import annotations

from hil.core.diagnosis.glr.compiled import compiled
from hil.core.diagnosis.glr.hypotheses import JUMPS, PUMPS
from hil.core.diagnosis.glr.model import GAIN, RATE, Array, N

NO_GROWTH = -1
BOTH_GAINS = N
"""Instead of the index of a state: none, and the gains of both pumps."""

RATE_WALK = 0.1
"""Random walk of the rate in a second, over the rate."""


def covers(target: int, j: int) -> bool:
    """Whether the state of place j of JUMPS grows."""
    return target in (JUMPS[j].state, BOTH_GAINS) if j in PUMPS else target == JUMPS[j].state


@compiled
def grow(x: Array, P: Array, target: int, dt: float) -> None:
    """Move the state `target` on by one period of dt seconds at the filter's rate, in place. x : (N,). P : (N, N)."""
    if target == NO_GROWTH or P[RATE, RATE] <= 0.0:
        return
    first = GAIN if target == BOTH_GAINS else target
    last = GAIN + 1 if target == BOTH_GAINS else target
    for state in range(first, last + 1):
        x[state] += dt * x[RATE]
        for j in range(N):
            P[state, j] += dt * P[RATE, j]
        for j in range(N):
            P[j, state] += dt * P[j, RATE]
    P[RATE, RATE] += (RATE_WALK * x[RATE]) ** 2 * dt
