"""What every law of this package knows of the rig, and the steady state that it steers to.

*Effective* drives are those that a healthy pump would need: a pump with effectiveness theta_j gets 1/theta_j times as
much.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Protocol

from hil.core.following import HEALTHY, Followed
from hil.core.pumps import STRAIGHT, PumpPath
from hil.core.reachable import nearest_reachable
from hil.core.reconfiguration import MIN_EFFECTIVENESS
from hil.core.tanks import TankModel, equilibrium
from hil.core.types import Event, Pair, Quad, Severity

TAKEOVER_S = 2.0
"""Time constant with which laws without integrals to set let the difference to an operator's drives fade."""


@dataclass(frozen=True, slots=True)
class LawPlant:
    """The rig of a law: tanks, largest drives (2,) in V, lag (2,) of each pump, control period, operating drives (2,).

    pumps : to say drives as voltages. rate_V_s : largest rate of change of a command.
    """

    model: TankModel
    limit_V: Pair
    lag_s: Pair
    period_s: float
    operating_V: Pair
    rate_V_s: float = inf
    pumps: PumpPath = STRAIGHT


@dataclass(frozen=True, slots=True)
class SteadyAim:
    """The steady state that a law steers to.

    target_V : (2,) outputs. level_cm : (4,) levels. effective_V : (2,) effective drives that hold them. effectiveness :
    (2,) that the drives are divided by, never below that of a dead pump. standby_V : (2,) drive of a dead pump; None
    for a pump that works. reason : why the outputs are not the references, "" if they are.
    """

    target_V: Pair
    level_cm: Quad
    effective_V: Pair
    effectiveness: Pair
    standby_V: tuple[float | None, float | None]
    reason: str


def steady_aim(plant: LawPlant, reference_V: Pair, effectiveness: Pair) -> SteadyAim:
    """The references, or the nearest outputs that pumps of this effectiveness (2,) can hold."""
    k = plant.model.level_gain_V_cm
    wanted_cm = (max(reference_V[0] / k, 0.0), max(reference_V[1] / k, 0.0))
    limit_V = (effectiveness[0] * plant.limit_V[0], effectiveness[1] * plant.limit_V[1])
    reachable = nearest_reachable(plant.model, wanted_cm, limit_V, plant.pumps)
    h1, h2 = reachable.lower_cm
    effective_V = (max(reachable.holding_V[0], 0.0), max(reachable.holding_V[1], 0.0))
    standby: tuple[float | None, float | None] = (None, None)
    if min(effectiveness) < MIN_EFFECTIVENESS:
        held = nearest_reachable(plant.model, wanted_cm, plant.limit_V).holding_V
        standby = (
            held[0] if effectiveness[0] < MIN_EFFECTIVENESS else None,
            held[1] if effectiveness[1] < MIN_EFFECTIVENESS else None,
        )
    return SteadyAim(
        target_V=(k * h1, k * h2) if reachable.reason else reference_V,
        level_cm=(h1, h2, *equilibrium(plant.model, effective_V)[2:]),
        effective_V=effective_V,
        effectiveness=(max(effectiveness[0], MIN_EFFECTIVENESS), max(effectiveness[1], MIN_EFFECTIVENESS)),
        standby_V=standby,
        reason=reachable.reason,
    )


class Aims(Protocol):
    """What there is to say about a change: a `SteadyAim` or a `StateFeedback`."""

    @property
    def target_V(self) -> Pair:  # noqa: N802 - the name of a field
        """(2,) outputs in force."""
        ...

    @property
    def effectiveness(self) -> Pair:
        """(2,) that drives are divided by."""
        ...

    @property
    def reason(self) -> str:
        """Why the target is not the reference."""
        ...


def change_events(old: Aims, new: Aims) -> tuple[Event, ...]:
    """Events for the record: other pumps, or a target that is not the reference."""
    events = []
    if new.effectiveness != old.effectiveness:
        e1, e2 = new.effectiveness
        text = f"drives divided by effectiveness {e1:.3f}, {e2:.3f}"
        events.append(Event(Severity.INFO, "reconfigured", text, {"effectiveness": [e1, e2]}))
    if new.reason and new.reason != old.reason:
        r1, r2 = new.target_V
        text = f"reference can't be reached ({new.reason}): aiming at {r1:.4f}, {r2:.4f} V"
        events.append(Event(Severity.WARNING, "target", text, {"target_V": [r1, r2], "reason": new.reason}))
    return tuple(events)


def known_effectiveness(followed: Followed, use_diagnosis: bool) -> Pair:
    """(2,) the effectiveness that a law divides by: of the diagnosis, or that of healthy pumps."""
    return followed.effectiveness if use_diagnosis else HEALTHY


def pump_drives(aim: SteadyAim, effective_V: Pair) -> Pair:
    """(2,) drives for effective drives; a dead pump gets its stand-by drive."""
    (s1, s2), (t1, t2) = aim.standby_V, aim.effectiveness
    return effective_V[0] / t1 if s1 is None else s1, effective_V[1] / t2 if s2 is None else s2
