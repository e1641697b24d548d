"""No control law gets past the supervisor, whatever it returns, raises or does to its inputs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core import closed_loop, controller, start_goal
from hil.core.control_law import FeedbackRecord, LawInputs, LawRequest
from hil.core.controller import ControllerState
from hil.core.following import Followed
from hil.core.reachable import nearest_reachable
from hil.core.start_phase import StartConfig, When
from hil.core.types import Event, Mode, NodeState, Pair, Severity, TripCause
from tests.core.core_bench import BENCH, LIMITS, PERIOD_S, SECOND, Plant, bench_loop, controller_config, inputs, volts
from tests.safety.safety_bench import LoopBench, config

REST = Plant().level_cm
TARGET = (6.1, 6.4)


@dataclass(frozen=True)
class Answers:
    """A law that answers as it is told, step by step; the last answer stays. An exception is raised."""

    answers: Sequence[Any]

    def start(self, inputs: LawInputs) -> object:
        del inputs
        return 0

    def step(self, memory: Any, inputs: LawInputs) -> Any:
        answer = self.answers[min(memory, len(self.answers) - 1)]
        if isinstance(answer, BaseException):
            raise answer
        if callable(answer):
            answer = answer(inputs)
        return memory + 1, answer


def mutates(inputs: LawInputs) -> LawRequest:
    """Overwrites what it can reach of its inputs, frozen or not; an empty rig, as far as anybody can see."""
    object.__setattr__(inputs.estimate, "level_cm", (0.0, 0.0, 0.0, 0.0))
    object.__setattr__(inputs.diagnosis, "trusted", (False, False, False, False))
    for name in ("level_cm", "reference_V", "given_V", "t_s", "references", "authority"):
        object.__setattr__(inputs, name, None)
    return LawRequest((3.0, 3.0), TARGET)


ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)
SCALARS = st.one_of(ANY_FLOAT, st.integers(-(10**400), 10**400), st.text(max_size=5), st.none(), st.booleans())
PAIRS = st.one_of(
    st.tuples(ANY_FLOAT, ANY_FLOAT),
    st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)),
    st.lists(SCALARS),
    SCALARS,
)
TEXTS = st.one_of(st.just(""), st.text(st.characters(codec=None), max_size=400), SCALARS)
EVENTS = st.one_of(
    st.just(()),
    st.builds(
        lambda code, text, data: (Event(Severity.ERROR, code, text, data),),
        st.one_of(st.sampled_from(["law", "trip", "target"]), SCALARS),
        TEXTS,
        st.dictionaries(st.text(max_size=3), SCALARS, max_size=2),
    ),
    SCALARS,
)
REQUESTS = st.builds(
    LawRequest,
    drive_V=PAIRS,
    target_V=PAIRS,
    reason=TEXTS,
    problem=TEXTS,
    shown=st.one_of(st.dictionaries(SCALARS, SCALARS, max_size=3), SCALARS),
    events=EVENTS,
    feedback=st.one_of(st.none(), SCALARS, st.builds(FeedbackRecord, PAIRS, PAIRS, st.lists(SCALARS, max_size=13))),
)
PLAIN = st.builds(
    LawRequest, st.tuples(st.floats(-1e300, 1e300), st.floats(-1e300, 1e300)), st.tuples(ANY_FLOAT, ANY_FLOAT)
)
ANSWERS = st.one_of(PLAIN, REQUESTS, SCALARS, st.just(mutates), st.builds(ValueError), st.builds(RecursionError))


def sent(answers: Sequence[Any], levels_cm: Callable[[int], Sequence[float]], steps: int) -> list[tuple[Pair, Mode]]:
    """What was sent at each step, and the mode; a step that raises is answered as the loop does it."""
    setup = controller_config(bench_loop(law=Answers(answers)))
    state, applied, log = ControllerState(), (0.0, 0.0), []
    for number in range(steps):
        node = NodeState.RUN if applied != (0.0, 0.0) else NodeState.READY
        seen = inputs(volts(levels_cm(number)), applied, node)
        try:
            state, output = controller.step(setup, state, seen, round(number * PERIOD_S * SECOND))
        except Exception as error:  # noqa: BLE001 - as `ControlLoop.tick` does
            state, output = controller.fail(state, TripCause.CONTROLLER_FAILED, f"{type(error).__name__}: {error}")
        applied = output.command.voltage_V
        assert output.command.enable or applied == (0.0, 0.0)
        log.append((applied, state.supervision.mode))
    return log


@settings(max_examples=60, deadline=None)
@given(st.lists(ANSWERS, min_size=1, max_size=6))
def test_whatever_a_law_answers_commands_stay_within_range_and_rate_and_a_trip_stays(answers: list[Any]) -> None:
    low, high = LIMITS.range_V
    last, has_tripped = (0.0, 0.0), False
    for applied, mode in sent(answers, lambda _: REST, 10):
        is_off = applied == (0.0, 0.0)
        for before, now in zip(last, applied, strict=True):
            assert low <= now <= high
            assert is_off or abs(now - before) <= LIMITS.rate_V_s * PERIOD_S + 1e-9
        has_tripped = has_tripped or mode is Mode.TRIPPED
        assert not has_tripped or (is_off and mode is Mode.TRIPPED)
        last = applied


@settings(max_examples=30, deadline=None)
@given(st.lists(ANSWERS, min_size=1, max_size=6))
def test_whatever_a_law_answers_a_high_level_trips(answers: list[Any]) -> None:
    log = sent(answers, lambda number: REST if number < 6 else (LIMITS.level_max_cm + 0.1, *REST[1:]), 10)
    assert all(applied == (0.0, 0.0) and mode is Mode.TRIPPED for applied, mode in log[7:])


@pytest.mark.parametrize(
    "answer",
    [
        ValueError("no"),
        None,
        (3.0, 3.0),
        LawRequest((math.nan, 3.0), TARGET),
        LawRequest((3.0, math.inf), TARGET),
        LawRequest((3.0,), TARGET),  # type: ignore[arg-type]
        LawRequest(("3.0", "3.0"), TARGET),  # type: ignore[arg-type]
        LawRequest((True, 3.0), TARGET),
        LawRequest((3.0, 3.0), TARGET, events=(Event(Severity.INFO, "trip", "", {}),)),
    ],
    ids=repr,
)
def test_a_law_that_fails_trips_at_0_volts_in_the_same_step(answer: Any) -> None:
    good = LawRequest((3.0, 3.0), TARGET)
    bench = LoopBench(config(law=Answers([good] * 6 + [answer])))
    bench.step(6)
    assert bench.last.enable
    steps = 0
    while bench.last.enable and steps < 8:
        bench.step()
        steps += 1
    assert bench.last.voltage_V == (0.0, 0.0)
    assert not bench.last.enable
    assert bench.is_in(Mode.TRIPPED)
    assert bench.cause is TripCause.CONTROLLER_FAILED


def test_a_law_that_hides_a_start_phase_that_has_failed_does_not_get_away_with_it() -> None:
    """A law could declare any level the target: the run went on with tanks that were never filled."""
    start = StartConfig(
        when=When.ALWAYS, rate_cm_s=20.0, settle_s=0.2, level_max_cm=19.0, max_drives=(10.0, 10.0), max_V=10.0
    )
    ends = []
    for lies in (True, False):

        def answer(inputs: LawInputs, lies: bool = lies) -> LawRequest:
            h1, h2, _, _ = inputs.level_cm
            return LawRequest((1.0, 1.0), (0.5 * h1, 0.5 * h2) if lies else inputs.reference_V)

        law = Answers([answer])
        setup = controller_config(bench_loop(law=law, start=start))
        state = ControllerState()
        low = tuple(0.8 * h for h in REST)
        for number in range(120):
            node = NodeState.RUN if state.loop is not None else NodeState.READY
            seen = inputs(volts(low), state.supervision.command_V, node)
            state, _ = controller.step(setup, state, seen, round(number * PERIOD_S * SECOND))
        assert state.loop is not None
        assert state.loop.t_s > 0.0
        ends.append(state.supervision.stopped_by)
    assert ends == ["start_failed", "start_failed"]


def test_a_target_that_weak_pumps_can_hold_is_taken_at_the_end_of_a_start_phase() -> None:
    loop = bench_loop()
    weak = (0.4, 0.4)
    state = closed_loop.begin(loop, inputs(volts(REST)), 0)
    wanted = (0.5 * 18.0, 0.5 * 18.0)
    reached = nearest_reachable(BENCH, (18.0, 18.0), (4.0, 4.0)).lower_cm
    told = replace(state.inputs, requested_V=wanted)
    state = state._replace(inputs=told, followed=Followed(effectiveness=weak))
    for said_cm, expected in ((reached, reached), ((18.0, 18.0), (18.0, 18.0)), ((5.0, 5.0), (18.0, 18.0))):
        request = LawRequest((3.0, 3.0), (0.5 * said_cm[0], 0.5 * said_cm[1]))
        goal = start_goal.goal_cm(BENCH, loop, state._replace(request=request))
        assert goal == pytest.approx(expected)
