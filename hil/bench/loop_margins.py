"""Robustness of a linear state feedback with integral action: margins at each pump, lost gain, spread of the rig.

The loop is that of the control period: tanks and pump lags held from step to step, whole periods of transport delay,
and integrals as the law counts them. Each margin is that of one pump's loop with the other one closed: of the gain by
the closed loop's eigenvalues, of the delay by the loop's frequency response (python-control).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from hil.bench.design_figures import LOSSES
from hil.core.tanks import Array, LinearModel
from hil.core.types import Pair

SPREADS = (0.03, 0.05, 0.1, 0.15, 0.2, 0.3)
MAX_GAIN, GAIN_STEPS = 1000.0, 120
TAYLOR_ORDER = 12
DRAWS = 64
"""Rigs drawn for each spread, besides those with every parameter at its end."""


@dataclass(frozen=True)
class LoopMargins:
    """How far the loop is from instability, with gains that stay as they are.

    gain_up, gain_down : factors of one pump's gain up and down to which the loop is stable; inf and 0 without a limit.
    delay_s : that one pump's path may have besides the rig file's. distance : least singular value of I + L over
    frequency, 1 at the most for a loop that rolls off. losses : name -> whether the loop is stable after it.
    spread : the largest of `SPREADS` within which all drawn rigs are stable; 0 if none is.
    """

    gain_up: float
    gain_down: float
    delay_s: float
    distance: float
    losses: Mapping[str, bool]
    spread: float


def loop_margins(linear: LinearModel, K: Array, lags_s: Pair, delays_s: Pair, period_s: float) -> LoopMargins:
    """Margins of u = -K [x; q], K (2, 6), on a linear rig."""
    A, B = sampled(linear.A, linear.B, linear.C, lags_s, delays_s, period_s)
    F = _feedback(K, len(A))
    ups, downs, delays = zip(*(_of_pump(A, B, F, pump, period_s) for pump in (0, 1)), strict=True)
    return LoopMargins(
        gain_up=min(ups),
        gain_down=max(downs),
        delay_s=min(delays),
        distance=_distance(A, B, F, period_s),
        losses={name: is_stable(A - B @ np.diag(left) @ F) for name, left in LOSSES.items()},
        spread=_spread(linear, F, lags_s, delays_s, period_s),
    )


def sampled(A: Array, B: Array, C: Array, lags_s: Pair, delays_s: Pair, period_s: float) -> tuple[Array, Array]:
    """The plant from one control step to the next: levels (4), integrals (2), pumps behind their lags, delays.

    A (..., 4, 4), B (..., 4, 2): one rig, or many.
    """
    lagged = [pump for pump in (0, 1) if lags_s[pump] > 0.0]
    n, many = 4 + len(lagged), A.shape[:-2]
    held = np.zeros((*many, n + 2, n + 2))  # levels, lags, and the commands, which stay as they are
    held[..., :4, :4] = A
    for pump in (0, 1):
        if pump in lagged:
            place = 4 + lagged.index(pump)
            held[..., :4, place] = B[..., pump]
            held[..., place, place], held[..., place, n + pump] = -1.0 / lags_s[pump], 1.0 / lags_s[pump]
        else:
            held[..., :4, n + pump] = B[..., pump]
    held = _exponential(held * period_s)
    steps = [math.ceil(delay_s / period_s - 1e-9) for delay_s in delays_s]
    size = n + 2 + sum(steps)
    Ad, Bd = np.zeros((*many, size, size)), np.zeros((*many, size, 2))
    order = np.array([0, 1, 2, 3, *range(6, 6 + len(lagged))])  # the integrals stand behind the levels, as in K
    Ad[..., order[:, None], order] = held[..., :n, :n]
    Ad[..., 4:6, :4], Ad[..., 4:6, 4:6] = -period_s * C, np.eye(2)  # q' = r - y
    place = 6 + len(lagged)
    for pump in (0, 1):
        if steps[pump] == 0:
            Bd[..., order, pump] = held[..., :n, n + pump]
            continue
        Bd[..., place, pump] = 1.0
        for step in range(1, steps[pump]):
            Ad[..., place + step, place + step - 1] = 1.0
        Ad[..., order, place + steps[pump] - 1] = held[..., :n, n + pump]
        place += steps[pump]
    return Ad, Bd


def is_stable(A: Array) -> bool:
    """Whether all eigenvalues lie within the unit circle; of many matrices: of all of them."""
    return bool(np.abs(np.linalg.eigvals(A)).max() < 1.0)


def _exponential(M: Array) -> Array:
    """exp(M) of one matrix or many at once: Taylor series of M / 2^s, squared s times."""
    norm = float(np.abs(M).sum(axis=-1).max())
    halvings = max(math.ceil(math.log2(norm)) + 1, 0) if norm > 0.0 else 0
    scaled, unit = M / 2.0**halvings, np.broadcast_to(np.eye(M.shape[-1]), M.shape)
    total, term = unit.copy(), unit
    for order in range(1, TAYLOR_ORDER + 1):
        term = term @ scaled / order
        total = total + term
    for _ in range(halvings):
        total = total @ total
    exponential: Array = total
    return exponential


def _feedback(K: Array, size: int) -> Array:
    return np.hstack([K, np.zeros((2, size - 6))])


def _of_pump(A: Array, B: Array, F: Array, pump: int, period_s: float) -> tuple[float, float, float]:
    """Gain margins up and down, and the delay margin in s, with the other pump's loop closed."""
    import control  # a second that only `hil design` has to wait for

    other = 1 - pump
    opened = A - np.outer(B[:, other], F[other])
    part = np.outer(B[:, pump], F[pump])
    response = control.frequency_response(
        control.ss(opened, B[:, [pump]], F[[pump]], np.zeros((1, 1)), period_s),
        np.logspace(-4, math.log10(0.999 * math.pi / period_s), 2000),
    )
    _, phases, _, _, at_rad_s, _ = control.stability_margins(response, returnall=True)
    delays_s = [
        math.radians(float(phase) % 360.0) / float(at) for phase, at in zip(phases, at_rad_s, strict=True) if at > 0.0
    ]
    return _limit(opened, part, MAX_GAIN), _limit(opened, part, 1.0 / MAX_GAIN), min(delays_s, default=math.inf)


def _limit(opened: Array, part: Array, end: float) -> float:
    """The gain factor between 1 and `end` at which the loop is no longer stable; inf or 0 if it is there, too."""
    steps = np.geomspace(1.0, end, GAIN_STEPS)
    unstable = next((place for place, gain in enumerate(steps) if not is_stable(opened - gain * part)), None)
    if unstable is None:
        return math.inf if end > 1.0 else 0.0
    if unstable == 0:
        return 1.0
    stable, lost = float(steps[unstable - 1]), float(steps[unstable])
    for _ in range(20):
        middle = math.sqrt(stable * lost)
        stable, lost = (middle, lost) if is_stable(opened - middle * part) else (stable, middle)
    return stable


def _distance(A: Array, B: Array, F: Array, period_s: float) -> float:
    z = np.exp(1j * np.logspace(-4, math.log10(math.pi / period_s), 400) * period_s)
    L = F @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(z), *B.shape)))
    return float(np.linalg.svd(np.eye(2) + L, compute_uv=False)[:, -1].min())


def _spread(linear: LinearModel, F: Array, lags_s: Pair, delays_s: Pair, period_s: float) -> float:
    """Columns of B (pump gains) and the tanks' outflows are off, each by its own share."""
    rng = np.random.default_rng(0)
    corners = np.array(list(product((-1.0, 1.0), repeat=6)))
    drawn = np.vstack([corners, rng.uniform(-1.0, 1.0, (DRAWS, 6))])
    reached = 0.0
    for spread in SPREADS:
        shares = 1.0 + spread * drawn
        A = linear.A * shares[:, None, :4]  # column of a tank: what flows out of it, and into the one below
        B = linear.B * shares[:, None, 4:]
        Ad, Bd = sampled(A, B, linear.C, lags_s, delays_s, period_s)
        if not is_stable(Ad - Bd @ F):
            return reached
        reached = spread
    return reached
