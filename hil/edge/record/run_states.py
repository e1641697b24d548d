"""States of a run in its recording: their names, labels and colours."""

from __future__ import annotations

from hil.core.types import Mode

NO_STATE = "none"
HEALTHY_FROM, STRONG_ABOVE, DEAD_BELOW = 0.995, 1.005, 0.05  # effectiveness

# Backgrounds of the states, under white text.
CALM, WARM, ALERT, DIM = 0x2F6B46FF, 0x8A6D1FFF, 0x97302AFF, 0x48698AFF
QUIET, LEAVING, BY_HAND = 0x3A424BFF, 0x5D4A80FF, 0x2F7F86FF

_PUMP = (
    ("nominal", "stronger", "reduced", "dead"),
    ("nominal", "stronger", "reduced", "dead"),
    (CALM, WARM, WARM, ALERT),
)
STATES: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[int, ...]]] = {
    "states/mode": (
        tuple(mode.name for mode in Mode),
        tuple(mode.name.lower() for mode in Mode),
        (QUIET, DIM, CALM, WARM, LEAVING, ALERT, BY_HAND),
    ),
    "states/pump1": _PUMP,
    "states/pump2": _PUMP,
    "states/alarm": ((NO_STATE,), ("no alarm",), (QUIET,)),
    "diagnosis/candidates": ((NO_STATE,), ("nothing open",), (QUIET,)),
    "states/trip": ((NO_STATE,), ("no trip",), (QUIET,)),
}


def pump_state(effectiveness: float) -> str:
    """The state of a pump with this effectiveness."""
    if effectiveness > STRONG_ABOVE:
        return "stronger"
    if effectiveness >= HEALTHY_FROM:
        return "nominal"
    return "dead" if effectiveness < DEAD_BELOW else "reduced"
