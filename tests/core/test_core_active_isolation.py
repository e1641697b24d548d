"""The probe: it excites in spite of the integral action, is bounded and announced, and gives way to everything."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np
import pytest

from hil.core import active_isolation
from hil.core.active_isolation import IDLE, Occasion, ProbeConfig, ProbeState, rise_cm
from hil.core.controller import ControllerConfig
from hil.core.estimator import Estimate
from hil.core.interlocks import Belief
from hil.core.tanks import TankModel, equilibrium
from hil.core.types import (
    Action,
    Diagnosis,
    Event,
    Inputs,
    Measurement,
    Mode,
    OpenQuestion,
    Pair,
    Request,
    TickRecord,
)
from tests.core.core_bench import BENCH, LIMITS, Plant, bench_loop, controller_config, inputs, run, volts
from tests.narrowing import quad

REST = equilibrium(BENCH, (3.0, 3.0))
REST_V = volts(REST)[:2]
ALLOWED = ProbeConfig(is_allowed=True, voltage_V=0.3, move_s=30.0, hold_s=0.0, after_s=10.0, again_s=300.0)
QUESTION = OpenQuestion(alarm=4, tank=1, apart_cm=0.5)


@dataclass(frozen=True)
class Asks:
    """A detector with an open question between two times, about nothing that has happened."""

    from_s: float = 20.0
    until_s: float = inf

    def start(self) -> Any:
        return None

    def step(
        self,
        memory: Any,
        t_s: float,
        measurement: Measurement,  # noqa: ARG002
        estimate: Estimate,  # noqa: ARG002
        applied_V: Pair,  # noqa: ARG002
    ) -> tuple[Any, Diagnosis]:
        if t_s < self.from_s:
            return memory, Diagnosis()
        return memory, Diagnosis(open_question=QUESTION) if t_s < self.until_s else Diagnosis()


def config(detector: Asks | None = None, probe: ProbeConfig = ALLOWED, **loop: Any) -> ControllerConfig:
    return replace(controller_config(bench_loop(detector=detector or Asks(), **loop)), probe=probe)


def probe_events(records: list[TickRecord]) -> list[tuple[float, str, str]]:
    """(run time, state, reason) of the announcements."""
    return [
        (round(record.t_s, 1), str(event.data["state"]), str(event.data.get("reason", "")))
        for record in records
        for event in record.events
        if event.code == "probe"
    ]


def wrong_model() -> TankModel:
    """Tanks that differ from the controller's model by 5 %, in mixed directions."""
    return replace(
        BENCH,
        outlet_cm2=quad(a * f for a, f in zip(BENCH.outlet_cm2, (1.05, 0.95, 0.95, 1.05), strict=True)),
        pump_gain_cm3_Vs=(3.33 * 0.95, 3.35 * 1.05),
    )


@pytest.mark.parametrize(("model", "tolerance_V"), [(BENCH, 0.01), (wrong_model(), 0.05)])
def test_the_pumps_make_the_movement_although_the_loop_has_integral_action(
    model: TankModel, tolerance_V: float
) -> None:
    """An offset on the command alone would be cancelled by the loop within some seconds."""
    plant = Plant(model)
    _, records = run(config(Asks(from_s=120.0)), plant, 1900)
    t_s = np.array([record.t_s for record in records])
    applied_V = np.array([record.applied_V for record in records])
    before_V = applied_V[(t_s > 115.0) & (t_s < 129.0)].mean(axis=0)
    assert probe_events(records) == [(130.0, "begin", ""), (190.0, "end", "complete")][: len(probe_events(records))]
    for from_s, sign in ((131.0, 1.0), (161.0, -1.0)):
        moved_V = applied_V[(t_s > from_s) & (t_s < from_s + 28.0)] - before_V
        assert np.abs(moved_V - sign * 0.3).max() < tolerance_V


def test_the_levels_are_held_between_the_two_movements() -> None:
    """Most of what tells the explanations apart comes from the time in which the levels are away from their places."""
    _, records = run(config(probe=replace(ALLOWED, hold_s=60.0)), Plant(), 2000)
    assert probe_events(records) == [(30.0, "begin", ""), (150.0, "end", "complete")]
    t_s = np.array([record.t_s for record in records])
    moved_cm = (np.array([record.measured_V[:2] for record in records]) - REST_V) / BENCH.level_gain_V_cm
    held_cm = moved_cm[(t_s > 61.0) & (t_s < 119.0)]
    assert (np.ptp(held_cm, axis=0) < 0.05).all()
    assert (held_cm > 0.4).all()
    assert (np.abs(moved_cm).max(axis=0) < rise_cm(LIMITS, ALLOWED)[:2]).all()


def test_the_outputs_come_back_to_their_references_without_a_bump() -> None:
    _, records = run(config(probe=replace(ALLOWED, again_s=1e6)), Plant(), 3500)
    assert [state for _, state, _ in probe_events(records)] == ["begin", "end"]
    levels_V = np.array([record.measured_V[:2] for record in records])
    commands_V = np.array([record.command_V for record in records])
    moved_cm = np.abs(levels_V - REST_V) / BENCH.level_gain_V_cm
    assert 0.5 < moved_cm.max() < 0.9  # 0.76 cm by eq. (1)
    assert (moved_cm.max(axis=0) < rise_cm(LIMITS, ALLOWED)[:2]).all()
    assert moved_cm[-1].max() < 0.02
    steps_V = np.abs(np.diff(commands_V[20:], axis=0))
    assert steps_V.max() < 0.6 + 0.02  # the reversal from +0.3 V to -0.3 V is the largest
    ended = next(n for n, record in enumerate(records) if record.t_s > 90.5)
    assert np.abs(np.diff(commands_V[ended:], axis=0)).max() < 0.005


def test_the_loop_goes_on_controlling_while_the_pumps_move() -> None:
    """Only the expected movement of the levels is not acted on: a disturbance is."""
    plant = Plant()

    def on_step(number: int, seen: Inputs) -> Inputs:
        if number == 350:  # 5 s after the beginning, someone takes water from tank 1
            plant.level_cm = quad(h - (1.0 if tank == 0 else 0.0) for tank, h in enumerate(plant.level_cm))
        return seen

    _, records = run(config(), plant, 800, on_step=on_step)
    commands_V = {round(record.t_s, 1): record.command_V[0] for record in records}
    assert commands_V[36.0] > 3.3 + 0.5


@pytest.mark.parametrize("number", [0, 1])
def test_probe_voltages_are_recorded_as_part_of_what_the_law_asks_for(number: int) -> None:
    _, records = run(config(), Plant(), 1000)
    moved = {round(record.t_s, 1): record.probe_V[number] for record in records}
    assert (moved[29.9], moved[31.0], moved[59.0], moved[61.0], moved[89.0], moved[91.0]) == (
        0,
        0.3,
        0.3,
        -0.3,
        -0.3,
        0,
    )


def test_the_movement_ends_when_the_question_is_answered() -> None:
    _, records = run(config(Asks(until_s=40.0)), Plant(), 800)
    (begun_s, _, _), (ended_s, state, reason) = probe_events(records)
    assert (begun_s, state, reason) == (30.0, "end", "the question is answered")
    assert 40.0 <= ended_s <= 44.0
    assert all(record.probe_V == (0.0, 0.0) for record in records if record.t_s > ended_s + 0.05)


def test_nothing_moves_for_a_question_that_is_answered_in_time() -> None:
    _, records = run(config(Asks(until_s=29.0)), Plant(), 600)
    assert not probe_events(records)
    assert all(record.probe_V == (0.0, 0.0) for record in records)


def test_nothing_moves_where_the_probe_is_not_allowed() -> None:
    _, records = run(config(probe=ProbeConfig()), Plant(), 600)
    assert not probe_events(records)


def test_a_reference_step_serves_as_a_probe() -> None:
    """It excites as well, so the probe waits for one that comes, and ends for one that has come."""
    r1, r2 = REST_V
    soon = ((0.0, (r1, r2)), (60.0, (r1 + 0.1, r2 + 0.1)))
    _, records = run(config(references=soon), Plant(), 1000)
    assert probe_events(records) == [
        (30.0, "wait", "the reference changes soon, or the run ends"),
        (70.0, "begin", ""),
    ]


def test_one_alarm_is_probed_again_only_after_a_longer_time() -> None:
    brief = replace(ALLOWED, move_s=5.0, again_s=60.0)
    _, records = run(config(probe=brief), Plant(), 1200)
    assert [(t_s, state) for t_s, state, _ in probe_events(records)] == [
        (30.0, "begin"),
        (40.0, "end"),
        (100.0, "begin"),
        (110.0, "end"),
    ]


def test_by_hand_the_pumps_do_not_move_by_themselves() -> None:
    def on_step(number: int, seen: Inputs) -> Inputs:
        return replace(seen, requests=(Request(Action.MANUAL, (3.0, 3.0)),)) if number == 400 else seen

    _, records = run(config(), Plant(), 1200, on_step=on_step)
    assert [state for _, state, _ in probe_events(records)] == ["begin", "end"]
    assert all(record.command_V == (3.0, 3.0) for record in records if record.t_s > 41.0)


def test_a_stop_and_a_trip_end_the_movement_in_the_same_step() -> None:
    """The ramp of a stop, and the 0 V of a trip, hold no part of the movement."""

    def stop(number: int, seen: Inputs) -> Inputs:
        return replace(seen, stop_requested=number >= 400)

    def trip(number: int, seen: Inputs) -> Inputs:
        return replace(seen, bus=replace(seen.bus, is_up=number < 400))

    for on_step, mode in ((stop, Mode.STOPPING), (trip, Mode.TRIPPED)):
        _, records = run(config(), Plant(), 500, on_step=on_step)
        at = next(record for record in records if record.mode is mode)
        assert probe_events(records)[-1] == (round(at.t_s, 1), "end", "the loop no longer controls")
        assert at.command_V[0] < 3.3 - 1.9 if mode is Mode.STOPPING else at.command_V == (0.0, 0.0)
        assert records[-1].command_V == (0.0, 0.0)


def occasion(level_cm: tuple[float, ...] = REST, raw_V: Pair = (3.0, 3.0), **belief: Any) -> Occasion:
    levels = quad(level_cm)
    seen = inputs(volts(levels), raw_V)
    known = Belief(diagnosis=belief.pop("diagnosis", Diagnosis(open_question=QUESTION)), level_cm=levels, **belief)
    return Occasion(mode=Mode.RUNNING, inputs=seen, belief=known, raw_V=raw_V)


HIGH = (17.5, 12.8, 1.6, 1.4)


@pytest.mark.parametrize(
    ("at", "reason"),
    [
        (occasion(HIGH), "a level is too high"),
        (occasion(diagnosis=Diagnosis(hidden_cm=(17.5, -inf))), "a level is too high"),
        (occasion(diagnosis=Diagnosis(hidden_cm=(-inf, 18.0))), "a level is too high"),
        (occasion(diagnosis=Diagnosis(hidden_cm=(16.0, 16.0))), ""),
        (occasion((12.4, 12.8, 0.3, 1.4)), "a level is too low"),
        (occasion(raw_V=(9.6, 3.0)), "a pump is near the limit of its range"),
        (occasion(raw_V=(3.0, 0.4)), "a pump is near the limit of its range"),
        (occasion(possible_cm=(-inf, 15.0)), "a lower tank may be fuller than its sensor shows"),
        (occasion(diagnosis=Diagnosis(unproven=(False, True))), "a pump or a sensor is in doubt"),
        (occasion(diagnosis=Diagnosis(effectiveness=(1.0, 0.2))), "a pump or a sensor is in doubt"),
        (occasion(diagnosis=Diagnosis(trusted=(True, False, True, True))), "a pump or a sensor is in doubt"),
        (occasion(diagnosis=Diagnosis(trusted=(False, True, True, True), level_V=volts(REST))), ""),
        (replace(occasion(), end_s=29.0), "the reference changes soon, or the run ends"),
        (replace(occasion(), next_reference_s=59.0), "the reference changes soon, or the run ends"),
        (replace(occasion(), end_s=31.0, next_reference_s=61.0), ""),
        (occasion(), ""),
    ],
)
def test_it_waits_while_a_movement_is_not_safe_or_of_no_use(at: Occasion, reason: str) -> None:
    assert active_isolation.reason_to_wait(ALLOWED, LIMITS, QUESTION, at, 0.0) == reason


def test_a_level_that_a_sensor_without_trust_shows_counts() -> None:
    """After a drift was declared the model's level is not the only one that may be true."""
    blind = Diagnosis(trusted=(False, True, True, True), level_V=volts(REST))
    at = occasion(diagnosis=blind, live_cm=(17.5, -inf, -inf, -inf))
    assert active_isolation.reason_to_wait(ALLOWED, LIMITS, QUESTION, at, 0.0) == "a level is too high"


def begun() -> ProbeState:
    probe, _ = active_isolation.step(ALLOWED, LIMITS, IDLE, occasion(), 0.0, 0.1)
    probe, _ = active_isolation.step(ALLOWED, LIMITS, probe, occasion(), 10.0, 0.1)
    assert probe.is_moving
    return probe


@pytest.mark.parametrize(
    ("at", "reason"),
    [
        (occasion((18.9, 12.8, 1.6, 1.4)), "a level is near the level that trips"),
        (occasion((12.4, 12.8, 0.1, 1.4)), "a level is too low"),
        (occasion((13.7, 12.8, 1.6, 1.4)), "a level moves too far"),
        (occasion(raw_V=(10.1, 3.0)), "a pump is at the limit of its range"),
        (
            occasion(diagnosis=Diagnosis(stuck_on=(True, False), open_question=QUESTION)),
            "a pump or a sensor is in doubt",
        ),
        (replace(occasion(), reference_s=11.0), "the reference changes"),
    ],
)
def test_the_movement_ends_near_a_limit(at: Occasion, reason: str) -> None:
    probe, events = active_isolation.step(ALLOWED, LIMITS, begun(), at, 12.0, 0.1)
    assert not probe.is_moving
    assert probe.offset_V == (0.0, 0.0)
    assert [event.data["reason"] for event in events] == [reason]


def test_what_makes_it_wait_is_reported_once() -> None:
    probe, events = IDLE, list[Event]()
    for step in range(400):
        probe, new = active_isolation.step(ALLOWED, LIMITS, probe, occasion(HIGH), 0.1 * step, 0.1)
        events += new
    assert [event.data["reason"] for event in events] == ["a level is too high"]


@pytest.mark.parametrize("outlets", [BENCH.outlet_cm2, (1e-3, 1e-3, 0.071, 0.057), (0.071, 0.057, 1e-3, 1e-3)])
def test_no_level_moves_further_than_the_bound(outlets: tuple[float, float, float, float]) -> None:
    """Not even with outlets that are almost shut: the same tanks with and without the movement."""
    moved, still = (Plant(replace(BENCH, outlet_cm2=outlets)) for _ in range(2))
    still.level_cm = moved.level_cm = (5.0, 5.0, 2.0, 2.0)
    bound = rise_cm(LIMITS, ALLOWED)
    for _ in range(300):
        still.advance((3.0, 3.0), 0.1)
        moved.advance((3.3, 3.3), 0.1)
    gained = [a - b for a, b in zip(moved.level_cm, still.level_cm, strict=True)]
    assert all(0.0 < gain <= most + 1e-9 for gain, most in zip(gained, bound, strict=True))
