"""References that an operator changes while a run goes on, and the scenario's clock: what the schedule becomes."""

from __future__ import annotations

import pytest

from hil.core import live_plan
from hil.core.live_plan import LivePlan
from hil.core.reference_path import ReferenceMove, RunReferences
from hil.core.types import Pair

SCHEDULE = ((0.0, (6.0, 6.0)), (50.0, (7.0, 6.0)), (100.0, (6.0, 7.0)))
RAMP = ((1, ReferenceMove((50.0, 70.0), ((6.0, 6.0), (7.0, 6.0)))),)


def plan(moves: tuple[tuple[int, ReferenceMove], ...] = ()) -> LivePlan:
    return live_plan.planned(RunReferences(SCHEDULE, None, moves))


def requested(of: LivePlan, t_s: float) -> Pair:
    return RunReferences(of.schedule, None, of.moves).requested(t_s)


def test_a_plan_that_nobody_has_changed_is_the_scenarios() -> None:
    untouched = plan(RAMP)
    assert (untouched.schedule, untouched.moves) == (SCHEDULE, RAMP)


def test_a_reference_of_the_operator_holds_until_the_scenarios_next() -> None:
    changed = live_plan.with_reference(plan(), 20.0, (6.5, None), 0.0)
    assert [requested(changed, t_s) for t_s in (19.0, 20.0, 49.0, 50.0, 100.0)] == [
        (6.0, 6.0),
        (6.5, 6.0),
        (6.5, 6.0),
        (7.0, 6.0),
        (6.0, 7.0),
    ]


def test_a_ramp_leads_from_the_reference_in_force_to_the_new_one() -> None:
    changed = live_plan.with_reference(plan(), 20.0, (8.0, 5.0), 10.0)
    assert requested(changed, 25.0) == pytest.approx((7.0, 5.5))
    assert requested(changed, 35.0) == (8.0, 5.0)
    rates = RunReferences(changed.schedule, None, changed.moves)
    assert rates.rate(25.0) == pytest.approx((0.2, -0.1))


def test_an_output_that_is_kept_stays_on_its_ramp() -> None:
    changed = live_plan.with_reference(plan(RAMP), 60.0, (None, 5.0), 0.0)
    assert [requested(changed, t_s) for t_s in (60.0, 65.0, 75.0)] == [(6.5, 5.0), (6.75, 5.0), (7.0, 5.0)]


def test_a_held_clock_stops_a_ramp_and_all_that_comes_until_it_goes_on() -> None:
    held = live_plan.hold(plan(RAMP), 60.0)
    assert (requested(held, 90.0), requested(held, 1000.0)) == ((6.5, 6.0), (6.5, 6.0))
    assert (held.is_held, held.scenario_s(90.0)) == (True, 60.0)
    on = live_plan.resume(held, 90.0)
    assert [requested(on, t_s) for t_s in (90.0, 95.0, 100.0, 129.0, 130.0)] == [
        (6.5, 6.0),
        (6.75, 6.0),
        (7.0, 6.0),
        (7.0, 6.0),
        (6.0, 7.0),
    ]
    assert (on.is_held, on.scenario_s(150.0)) == (False, 120.0)


def test_a_reference_during_a_hold_ends_the_ramp_that_stands_but_not_what_comes() -> None:
    held = live_plan.with_reference(live_plan.hold(plan(RAMP), 60.0), 70.0, (5.0, 5.0), 0.0)
    on = live_plan.resume(held, 90.0)
    assert [requested(on, t_s) for t_s in (70.0, 95.0, 129.0, 130.0)] == [
        (5.0, 5.0),
        (5.0, 5.0),
        (5.0, 5.0),
        (6.0, 7.0),
    ]


def test_an_output_that_a_reference_during_a_hold_keeps_goes_on_with_its_ramp() -> None:
    """A reference of one output, given while the clock stood, used to end the ramp of the other one, too."""
    both = ((1, ReferenceMove((50.0, 70.0), ((6.0, 6.0), (7.0, 8.0)))),)
    held = live_plan.with_reference(live_plan.hold(plan(both), 60.0), 70.0, (5.0, None), 0.0)
    assert requested(held, 80.0) == (5.0, 7.0), "while the clock stands, it stands"
    on = live_plan.resume(held, 90.0)
    assert [requested(on, t_s) for t_s in (90.0, 95.0, 100.0, 129.0, 130.0)] == [
        pytest.approx((5.0, 7.0)),
        pytest.approx((5.0, 7.5)),
        (5.0, 8.0),
        (5.0, 8.0),
        (6.0, 7.0),
    ]


def test_a_ramp_given_during_a_hold_goes_on_beside_the_one_that_stood() -> None:
    both = ((1, ReferenceMove((50.0, 70.0), ((6.0, 6.0), (7.0, 8.0)))),)
    held = live_plan.with_reference(live_plan.hold(plan(both), 60.0), 70.0, (4.5, None), 40.0)
    on = live_plan.resume(held, 90.0)
    assert [requested(on, t_s) for t_s in (90.0, 95.0, 105.0, 110.0, 129.0)] == [
        pytest.approx((5.5, 7.0)),
        pytest.approx((5.25, 7.5)),
        pytest.approx((4.75, 8.0)),
        (4.5, 8.0),
        (4.5, 8.0),
    ]


def test_many_changes_do_not_fill_memory() -> None:
    changed = plan()
    for number in range(1000):
        value = 6.0 + 0.001 * number
        target = (value, None) if number % 2 else (None, value)
        changed = live_plan.with_reference(changed, 0.01 * number, target, 500.0)
    assert len(changed.entries) <= 5
    assert all(len(move.times_s) <= 3 for _, move in changed.moves)
