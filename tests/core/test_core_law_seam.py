"""What a control law is told by the loop, and what becomes of its answer."""

from __future__ import annotations

import math
import pickle
from dataclasses import dataclass, field, replace

import pytest

from hil.core import controller
from hil.core.control_law import Authority, FeedbackRecord, LawInputs, LawRequest
from hil.core.controller import ControllerState
from hil.core.law_check import checked
from hil.core.law_copies import copied, inputs_of_law
from hil.core.pumps import PumpPath
from hil.core.reference_path import RunReferences
from hil.core.start_phase import StartConfig, StartPhase, When
from hil.core.types import Action, Event, Mode, NodeState, Pair, Request, Severity, TickRecord
from tests.core.core_bench import PERIOD_S, SECOND, Plant, bench_loop, controller_config, inputs, run, volts

REST = Plant().level_cm
REST_V = volts(REST)[:2]


@dataclass(frozen=True)
class Listens:
    """A law that keeps what it is told, and asks for the same drives at every step."""

    drive_V: Pair = (3.0, 3.0)
    changes: dict[str, object] = field(default_factory=dict)
    started: list[LawInputs] = field(default_factory=list)
    told: list[LawInputs] = field(default_factory=list)

    def start(self, inputs: LawInputs) -> str:
        self.started.append(inputs)
        return "begun"

    def step(self, memory: str, inputs: LawInputs) -> tuple[str, LawRequest]:
        assert memory in ("begun", "going")
        self.told.append(inputs)
        return "going", replace(LawRequest(self.drive_V, inputs.reference_V), **self.changes)  # type: ignore[arg-type]


def test_a_law_is_told_what_the_pumps_were_given_and_who_decided() -> None:
    """In MANUAL the operator decides; in a stop nobody does."""
    law = Listens(drive_V=(12.0, 3.0))
    requests = ((1.0, Request(Action.MANUAL, (4.0, 2.0))), (2.0, Request(Action.AUTO)))
    config = replace(controller_config(bench_loop(law=law), duration_s=3.0), requests=requests)
    run(config, Plant(), 45)
    at = {round(told.t_s, 1): told for told in law.told}
    assert at[0.0].authority is Authority.NOBODY
    assert at[0.9].authority is Authority.LAW
    assert at[0.9].wanted_V == (12.0, 3.0)
    assert at[0.9].given_V == pytest.approx((10.0, 3.0))
    assert at[0.9].excess_V == pytest.approx((2.0, 0.0))
    assert at[1.5].authority is Authority.OPERATOR
    assert at[1.5].given_V == pytest.approx((4.0, 2.0))
    assert at[1.5].excess_V == (0.0, 0.0)
    assert at[3.5].authority is Authority.NOBODY
    assert [told.period_s for told in law.told[:2]] == [0.0, pytest.approx(PERIOD_S)]
    assert len(law.started) == 1


def test_a_law_works_with_drives_and_the_loop_with_voltages() -> None:
    law, pumps = Listens(), PumpPath(dead_zone_V=(0.5, 0.3), curve_1_V=(0.03, -0.02))
    _, records = run(controller_config(bench_loop(law=law, pumps=pumps)), Plant(), 20)
    assert records[-1].raw_V == pytest.approx(pumps.voltage((3.0, 3.0)))
    assert law.told[-1].given_V == pytest.approx((3.0, 3.0))


def test_a_law_sees_the_path_of_the_start_phase_and_where_it_leads() -> None:
    start = StartConfig(When.ALWAYS, 1.0, 2.0, 0.5, 19.0, (10.0, 10.0), 10.0)
    law = Listens(drive_V=(0.0, 0.0))
    stepped = ((0.0, REST_V), (5.0, (REST_V[0] + 0.3, REST_V[1])))
    run(controller_config(bench_loop(law=law, references=stepped, start=start)), Plant(start_V=(0.0, 0.0)), 20)
    first, later = law.told[0], law.told[10]
    assert first.t_s < -2.0
    assert first.reference_V == pytest.approx((0.0, 0.0))
    assert 0.0 < later.reference_V[0] < REST_V[0]
    assert {told.requested_V for told in law.told} == {REST_V}
    assert later.references.at(later.t_s) == later.reference_V
    assert later.references.at(-1.0) == later.references.at(4.9) == REST_V
    assert later.references.at(5.0) == stepped[1][1]
    assert later.references.start is not None


def test_after_a_trip_a_law_starts_again_at_rest() -> None:
    law, state, applied = Listens(), ControllerState(), (0.0, 0.0)
    config = controller_config(bench_loop(law=law))
    modes: list[Mode] = []
    for number in range(30):
        high = (9.6, *volts(REST)[1:]) if number == 15 else volts(REST)
        seen = inputs(high, applied, NodeState.RUN if applied != (0.0, 0.0) else NodeState.READY)
        asked = (Request(Action.CLEAR),) if number == 18 else ()
        state, output = controller.step(config, state, replace(seen, requests=asked), number * SECOND // 10)
        applied = output.command.voltage_V
        modes.append(state.supervision.mode)
    assert Mode.TRIPPED in modes
    assert modes[-1] is Mode.RUNNING
    assert len(law.started) == 1 + sum(mode in (Mode.DISARMED, Mode.READY) for mode in modes[15:])
    assert law.started[-1].given_V == (0.0, 0.0)
    assert law.started[-1].authority is Authority.NOBODY


def last_record(**changes: object) -> TickRecord:
    _, records = run(controller_config(bench_loop(law=Listens(changes=changes))), Plant(), 6)
    return records[-1]


def test_what_a_law_shows_is_recorded_and_the_columns_of_a_state_feedback_are_empty() -> None:
    record = last_record(shown={"cost": 2})
    assert record.shown == {"cost": 2.0}
    assert all(map(math.isnan, (*record.integral_Vs, *record.gain, *record.operating_V)))
    assert pickle.dumps(record), "a live run hands it to another process"
    feedback = FeedbackRecord((3.0, 3.1), (0.5, 0.6), tuple(map(float, range(12))))
    filled = last_record(feedback=feedback)
    assert (filled.operating_V, filled.integral_Vs, filled.gain) == ((3.0, 3.1), (0.5, 0.6), feedback.gain)
    assert pickle.dumps(filled), "a read-only view of an empty table could not be handed on"


def test_a_law_says_why_it_is_not_at_the_reference_and_the_run_has_the_event_once() -> None:
    law = Listens(changes={"target_V": (5.0, 5.0), "reason": "too far\x1b[31m"})
    _, records = run(controller_config(bench_loop(law=law)), Plant(), 20)
    events = [event for record in records for event in record.events if event.code == "target"]
    assert [event.data for event in events] == [{"target_V": [5.0, 5.0], "reason": "too far?[31m"}]


def test_a_law_that_can_not_hold_the_outputs_ends_the_run_after_five_seconds() -> None:
    law = Listens(changes={"problem": "no solution"})
    state, records = run(controller_config(bench_loop(law=law)), Plant(), 80)
    assert state.supervision.stopped_by == "no_stable_law"
    assert next(r.t_s for r in records if r.mode is Mode.STOPPING) == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"shown": {"a b": 1.0}}, "'a b'"),
        ({"shown": {"a": "1"}}, "'1'"),
        ({"shown": dict.fromkeys(map("x{}".format, range(65)), 1.0)}, "65"),
        ({"reason": 3}, "reason"),
        ({"target_V": None}, "target_V"),
        ({"feedback": FeedbackRecord((1.0, 1.0), (1.0, 1.0), (1.0,))}, "12 numbers"),
        ({"events": [Event(Severity.INFO, "law", "", {})]}, "events"),
    ],
)
def test_an_answer_that_is_wrong_is_refused_with_what_is_wrong(changes: dict[str, object], what: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"control law.*{what}"):
        checked(replace(LawRequest((3.0, 3.0), REST_V), **changes))  # type: ignore[arg-type]


def test_an_event_of_a_law_is_no_more_than_a_warning_and_its_text_is_printable() -> None:
    event = Event(Severity.ERROR, "law", "a\nb\ud800" + 400 * "c", {"x": (1, 2.0)})
    (kept,) = checked(LawRequest((3.0, 3.0), REST_V, events=(event,))).events
    assert (kept.severity, kept.code, kept.data) == (Severity.WARNING, "law", {"x": [1.0, 2.0]})
    assert kept.text.startswith("a?b?c")
    assert len(kept.text) == 300


def test_a_law_gets_copies_of_the_records_that_the_interlocks_use() -> None:
    law = Listens()
    run(controller_config(bench_loop(law=law)), Plant(), 4)
    known = law.told[-1]
    phase = StartPhase((1.0, 1.0), 5.0, 6.0, 0.1)
    handed = inputs_of_law(known, RunReferences(((0.0, REST_V),), phase))
    for name in ("diagnosis", "followed"):
        assert getattr(handed, name) is not getattr(known, name)
        assert getattr(handed, name) == getattr(known, name)
    assert handed.references.start == phase
    assert handed.references.start is not phase
    with pytest.raises(AttributeError):
        object.__setattr__(handed.estimate, "level_cm", (0.0,) * 4)  # a tuple needs no copy
    assert copied(known) == known
