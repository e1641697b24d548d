"""The fault hypotheses: each is a jump of one state of the filter.

A row of `JUMPS` is one state that may jump. What a jump is called depends on its sign. A pump whose flow does not
follow its voltage is a jump of its gain at first, see `stuck_check`.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.diagnosis.glr.model import BIAS, DRIFT, GAIN, LAG, LEAK, OUTLET, SPLIT


@dataclass(frozen=True, slots=True)
class Jump:
    """One state that may jump.

    state : its index. target : pump, tank or sensor, from 1. rises, falls : kind of fault that a jump up or down means,
    "" where that is impossible. prior : standard deviation of a jump before anything is known of it.
    rise, fall : the smallest and the largest jump up and down that is accepted.
    """

    state: int
    target: int
    rises: str
    falls: str
    prior: float
    rise: tuple[float, float]
    fall: tuple[float, float]


BIAS_PRIOR_V, BIASES_V = 0.5, (0.005, 11.0)

JUMPS: tuple[Jump, ...] = (
    *(
        Jump(GAIN + j, j + 1, "pump_effectiveness", "pump_effectiveness", 0.5, (0.05, 20.0), (0.01, 1.5))
        for j in range(2)
    ),
    *(Jump(SPLIT + j, j + 1, "valve_split", "valve_split", 0.2, (0.01, 1.0), (0.01, 1.0)) for j in range(2)),
    *(Jump(LAG + j, j + 1, "pump_lag", "", 4.0, (0.5, 75.0), (0.5, 1.0)) for j in range(2)),
    *(Jump(OUTLET + i, i + 1, "leak", "outlet_block", 0.4, (0.01, 5.0), (0.01, 1.2)) for i in range(2)),
    *(Jump(OUTLET + i, i + 1, "", "outlet_block", 0.4, (0.01, 1.0), (0.01, 1.2)) for i in range(2, 4)),
    *(Jump(LEAK + i, i + 3, "leak", "", 0.4, (0.01, 5.0), (0.01, 1.0)) for i in range(2)),
    *(Jump(BIAS + i, i + 1, "sensor_bias", "sensor_bias", BIAS_PRIOR_V, BIASES_V, BIASES_V) for i in range(4)),
    *(Jump(DRIFT + i, i + 1, "sensor_drift", "sensor_drift", 0.05, (0.001, 5.0), (0.001, 5.0)) for i in range(4)),
)
H = len(JUMPS)
PUMPS, SPLITS, LAGS = (0, 1), (2, 3), (4, 5)
"""Places of the two pumps, and of the valves and the lags behind them, in JUMPS."""

BOTH = H
"""Number of the hypothesis that both pumps jumped at once."""


def _places(state: int) -> tuple[int, int]:
    """Places in JUMPS of a state and of the next one."""
    first, second = (next(n for n, jump in enumerate(JUMPS) if jump.state == state + i) for i in range(2))
    return first, second


PAIRS: tuple[tuple[int, int], ...] = (PUMPS, SPLITS, _places(OUTLET), _places(OUTLET + 2), _places(LEAK))
"""The two jumps of each hypothesis from BOTH on, of one sign: pumps; valves; outlets of the lower tanks; outlets of the
upper tanks; leaks of the upper tanks."""

ALL = H + len(PAIRS)
"""The number of hypotheses: single jumps, then pairs."""

PAIR_ODDS = -6.0
"""Log-likelihood ratio, before any reading, of the pairs that are not the pumps: they are rare."""


def jumps_of(number: int) -> tuple[int, ...]:
    """The places in JUMPS that a hypothesis is about."""
    return PAIRS[number - H] if number >= H else (number,)


def drift_of(tank: int) -> int:
    """Place in JUMPS of the drift of a tank's sensor."""
    return next(number for number, jump in enumerate(JUMPS) if jump.state == DRIFT + tank - 1)


def outlet_of(tank: int) -> int:
    """Place in JUMPS of a tank's outlet."""
    return next(number for number, jump in enumerate(JUMPS) if jump.state == OUTLET + tank - 1)


@dataclass(frozen=True, slots=True)
class Variant:
    """Another way in which the fault of a hypothesis may begin; the better one counts.

    number : of the hypothesis. shift, prior : mean and standard deviation of the jump. rate : standard deviation of the
    rate at which the state then grows, 1/s; 0 for a jump alone. odds : its log-likelihood ratio before any reading.
    onset_of : the hypothesis whose onset it begins at; None: its own.
    """

    number: int
    shift: float
    prior: float
    rate: float
    odds: float = 0.0
    onset_of: int | None = None


GROWTH_STD, GROWTH_JUMP = 0.006, 0.02
"""Of the rate of a fault that grows, 1/s; and of its size at the onset, which is not known exactly."""

LONG_LAG_ODDS = -8.0
"""A lag of many times the rig file's is rare, and while a voltage moves slowly it looks like a gain that fades."""

PLAIN = -1
"""In place of a variant: the jump itself."""

VARIANTS: tuple[Variant, ...] = (
    # a filter that begins at the rig file's lag does not find a long one: its effect is far from linear in the lag
    *(
        Variant(number, shift, prior, 0.0, LONG_LAG_ODDS)
        for number in LAGS
        for shift, prior in ((9.0, 6.0), (35.0, 18.0))
    ),
    *(
        Variant(number, 0.0, GROWTH_JUMP, GROWTH_STD)
        for number, jump in enumerate(JUMPS)
        if jump.state < BIAS and number not in LAGS
    ),
    Variant(BOTH, 0.0, GROWTH_JUMP, GROWTH_STD),
    # what looks like a drift of a lower tank's sensor may be its outlet, which then has changed for as long
    *(
        Variant(number, 0.0, GROWTH_JUMP, GROWTH_STD, onset_of=drift_of(jump.target))
        for number, jump in enumerate(JUMPS)
        if OUTLET <= jump.state < OUTLET + 2
    ),
)
ROWS = ALL + len(VARIANTS)
"""Replays: one for each hypothesis, then the variants."""
