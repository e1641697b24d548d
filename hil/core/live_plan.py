"""The references of a run as its operator changes them, and the clock of the scenario, which the operator can hold.

    run time        0 ------ 60 (hold) ------ 90 (resume) ------ 150
    scenario time   0 ------ 60 ------------- 60 --------------- 120

While the clock stands, no reference and no request of the scenario comes, its end does not come, and a reference on its
way stays where it is; control goes on. Afterwards all of this comes later by the time held. A reference of the operator
replaces the one in force: a scenario's reference that comes later still comes.

The record's time, the windows of the key figures and the fault times of the emulator are run time: they do not stand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, isfinite

from hil.core.reference_path import TIME_TOLERANCE_S, ReferenceMove, RunReferences
from hil.core.types import Pair

NEVER_S = inf
RATE_TOLERANCE_V_S = 1e-9

Schedule = tuple[tuple[float, Pair], ...]
Moves = tuple[tuple[int, ReferenceMove], ...]


@dataclass(frozen=True, slots=True)
class PlannedReference:
    """References (2,) in V from at_s on, run time; move : how they get there, None by a step."""

    at_s: float
    levels_V: Pair
    move: ReferenceMove | None = None

    def value(self, t_s: float) -> Pair:
        """(2,) at run time t_s."""
        return self.levels_V if self.move is None else self.move.at(t_s)

    def is_moving(self, t_s: float) -> bool:
        """Whether the references are on their way at run time t_s."""
        return self.move is not None and t_s < self.move.end_s - TIME_TOLERANCE_S

    def later(self, by_s: float) -> PlannedReference:
        """The same, later."""
        move = self.move
        if move is not None:
            move = ReferenceMove(tuple(t_s + by_s for t_s in move.times_s), move.values_V)
        return PlannedReference(self.at_s + by_s, self.levels_V, move)


@dataclass(frozen=True, slots=True)
class LivePlan:
    """What the operator has changed. entries : the references in force and to come, ascending in run time.

    held_at_s : run time since when the scenario's clock stands, None while it goes. held_s : for how long it has stood
    before that. waiting : references of the scenario that come when it goes on, with their times as if it had gone on;
    the first may be the rest of a way that stands. replaced : (2,) outputs whose way the operator has replaced since.
    """

    entries: tuple[PlannedReference, ...]
    held_at_s: float | None = None
    held_s: float = 0.0
    waiting: tuple[PlannedReference, ...] = ()
    replaced: tuple[bool, bool] = (False, False)

    @property
    def is_held(self) -> bool:
        """Whether the scenario's clock stands."""
        return self.held_at_s is not None

    @property
    def schedule(self) -> Schedule:
        """As `RunReferences` has it."""
        return tuple((entry.at_s, entry.levels_V) for entry in self.entries)

    @property
    def moves(self) -> Moves:
        """As `RunReferences` has it."""
        return tuple((number, entry.move) for number, entry in enumerate(self.entries) if entry.move is not None)

    def scenario_s(self, t_s: float) -> float:
        """The scenario's time at run time t_s."""
        return (t_s if self.held_at_s is None else self.held_at_s) - self.held_s

    def in_force(self, t_s: float) -> PlannedReference:
        """The entry in force at run time t_s."""
        return next(
            (entry for entry in reversed(self.entries) if entry.at_s <= t_s + TIME_TOLERANCE_S), self.entries[0]
        )


def planned(references: RunReferences) -> LivePlan:
    """The plan that follows these references."""
    return LivePlan(
        tuple(
            PlannedReference(at_s, levels_V, references.move(number))
            for number, (at_s, levels_V) in enumerate(references.schedule)
        )
    )


def with_reference(plan: LivePlan, t_s: float, target: tuple[float | None, float | None], ramp_s: float) -> LivePlan:
    """The plan with a reference of the operator from run time t_s on.

    target : (2,) in V; None leaves an output on the way that it is on. ramp_s : time of the way there.
    """
    before = plan.in_force(t_s)
    times_s = {t_s, t_s + ramp_s} if ramp_s > 0.0 else {t_s}
    if before.move is not None and before.is_moving(t_s):
        kept = [index for index in (0, 1) if target[index] is None]
        times_s |= {at_s for index in kept for at_s in _bends(before.move, index) if at_s > t_s + TIME_TOLERANCE_S}
    ordered = tuple(sorted(times_s))
    first, second = (_way(before, index, target[index], ordered, ramp_s) for index in (0, 1))
    values = tuple(zip(first, second, strict=True))
    move = ReferenceMove(ordered, values) if len(ordered) > 1 else None
    new = PlannedReference(t_s, values[-1], move)
    past, coming = _split(plan, t_s)
    if not plan.is_held:
        return replace(plan, entries=(*past, new, *coming))
    first_is, second_is = (was or to is not None for was, to in zip(plan.replaced, target, strict=True))
    return replace(plan, entries=(*past, new, *coming), replaced=(first_is, second_is))


def hold(plan: LivePlan, t_s: float) -> LivePlan:
    """The plan whose clock stands from run time t_s on."""
    past, coming = _split(plan, t_s)
    now = plan.in_force(t_s)
    if now.is_moving(t_s) and now.move is not None:
        rest = [(at_s, value) for at_s, value in zip(now.move.times_s, now.move.values_V, strict=True) if at_s > t_s]
        times_s, values_V = zip(*((t_s, now.value(t_s)), *rest), strict=True)
        coming = (PlannedReference(t_s, now.levels_V, ReferenceMove(times_s, values_V)), *coming)
        past = (*past, PlannedReference(t_s, now.value(t_s)))
    return replace(plan, entries=past, held_at_s=t_s, waiting=coming)


def resume(plan: LivePlan, t_s: float) -> LivePlan:
    """The plan whose clock goes on from run time t_s on."""
    held_s = t_s - _held_at(plan, t_s)
    past, _ = _split(plan, t_s)
    coming = [entry.later(held_s) for entry in plan.waiting]
    if coming and any(plan.replaced) and coming[0].at_s <= t_s + TIME_TOLERANCE_S:
        coming[0] = _joined(plan.in_force(t_s), coming[0], plan.replaced, t_s)
    return LivePlan((*past, *coming), None, plan.held_s + held_s)


def _joined(now: PlannedReference, rest: PlannedReference, replaced: tuple[bool, bool], t_s: float) -> PlannedReference:
    """From run time t_s on: replaced outputs as now, the others on the rest of their way."""
    ways = [now if is_replaced else rest for is_replaced in replaced]
    bends = {at_s for index, way in enumerate(ways) if way.move is not None for at_s in _bends(way.move, index)}
    times_s = (t_s, *sorted(at_s for at_s in bends if at_s > t_s + TIME_TOLERANCE_S))
    values = tuple((ways[0].value(at_s)[0], ways[1].value(at_s)[1]) for at_s in times_s)
    return PlannedReference(t_s, values[-1], ReferenceMove(times_s, values) if len(times_s) > 1 else None)


def _held_at(plan: LivePlan, t_s: float) -> float:
    return t_s if plan.held_at_s is None else plan.held_at_s


def _split(plan: LivePlan, t_s: float) -> tuple[tuple[PlannedReference, ...], tuple[PlannedReference, ...]]:
    """The first entry and the one in force; those to come. Others have no effect any more."""
    coming = tuple(entry for entry in plan.entries if entry.at_s > t_s + TIME_TOLERANCE_S)
    first, now = plan.entries[0], plan.in_force(t_s)
    return (first,) if now is first else (first, now), coming


def _bends(move: ReferenceMove, index: int) -> list[float]:
    """Run times at which one output changes its rate. So the points of the other one are not kept, however many."""
    times_s, values = move.times_s, [value[index] for value in move.values_V]
    pieces = zip(pairwise(times_s), pairwise(values), strict=True)
    rates = [(b - a) / (end_s - begin_s) for (begin_s, end_s), (a, b) in pieces]
    changes = zip(times_s[1:], pairwise([*rates, 0.0]), strict=True)
    return [at_s for at_s, (before, after) in changes if abs(after - before) > RATE_TOLERANCE_V_S]


def _way(
    before: PlannedReference, index: int, target_V: float | None, times_s: tuple[float, ...], ramp_s: float
) -> tuple[float, ...]:
    """The reference of one output at these run times."""
    if target_V is None:
        return tuple(before.value(at_s)[index] for at_s in times_s)
    if not (ramp_s > 0.0 and isfinite(ramp_s)):
        return (target_V,) * len(times_s)
    start_V = before.value(times_s[0])[index]
    return tuple(start_V + min((at_s - times_s[0]) / ramp_s, 1.0) * (target_V - start_V) for at_s in times_s)
