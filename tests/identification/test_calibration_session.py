"""Points taken over CAN from the emulator in lockstep: what is typed, what is taken, and that nothing is sent."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import pytest

from hil.bench.calibration_session import PumpsMoveError, Session
from hil.cli.calibrate_command import sensor_facts
from hil.core.identification.calibration import LevelPoint, fit_line
from hil.edge.config.points_file import KnownLevel
from tests.doctor.doctor_bench import RIG, LockstepBench

FALLING = {"sensors": {"gain_V_cm": -0.1348, "offset_V": 5.851}}


class Person:
    """Fills tanks and types. acts : what to do before each line is typed, and the line."""

    def __init__(self, acts: Sequence[tuple[Callable[[], None], str]]) -> None:
        self.acts, self.said, self.shown = list(acts), list[str](), list[str]()

    def say(self, text: str) -> None:
        self.said.append(text)

    def show(self, text: str) -> None:
        self.shown.append(text)

    def typed(self) -> str | None:
        if not self.acts:
            raise EOFError
        act, line = self.acts[0]
        if "filled" not in act.__dict__:
            act()
            act.__dict__["filled"] = len(self.shown)
            return None
        if len(self.shown) < act.__dict__["filled"] + 20:  # 4 s: the readings from before are out of the window
            return None
        self.acts.pop(0)
        return line


def filled(bench: LockstepBench, *levels: float) -> Callable[[], None]:
    def fill() -> None:
        cast(Any, bench.rig)._tanks.levels_cm = levels

    return fill


def session_of(
    bench: LockstepBench, person: Person, tanks: Sequence[int] = (0,), wanted: Sequence[KnownLevel] = ()
) -> list[LevelPoint]:
    try:
        with bench.probe() as probe:
            return Session(probe, sensor_facts(RIG), person).run(tanks, wanted)
    finally:
        bench.close()


@pytest.mark.parametrize(("overlay", "gain", "offset"), [({}, 0.5, 0.0), (FALLING, -0.1348, 5.851)])
def test_two_levels_of_a_tank_give_its_sensor_and_nothing_is_sent(
    overlay: dict[str, dict[str, Any]], gain: float, offset: float
) -> None:
    bench = LockstepBench(overlay=overlay)
    person = Person([(filled(bench, 3.0, 9.0, 1.0, 1.0), "3"), (filled(bench, 18.0, 9.0, 1.0, 1.0), "18,0 cm")])
    line = fit_line(session_of(bench, person))
    assert line.gain_V_cm == pytest.approx(gain, rel=2e-3)
    assert line.offset_V == pytest.approx(offset, abs=5e-3)
    assert bench.sent == []
    assert bench.highest_voltage == 0.0
    assert any("noise" in shown and "settled" in shown for shown in person.shown)


def test_a_level_of_another_tank_is_not_taken() -> None:
    bench = LockstepBench()
    acts = [(filled(bench, 3.0, 3.0, 1.0, 1.0), "3"), (filled(bench, 3.0, 18.0, 1.0, 1.0), "18")]
    person = Person(acts)
    assert len(session_of(bench, person)) == 1
    assert "was tank 2 filled?" in person.said[-1]


def test_levels_and_words_that_make_no_sense_are_refused_and_asked_for_again() -> None:
    bench = LockstepBench()
    fill = filled(bench, 3.0, 3.0, 1.0, 1.0)
    person = Person([(fill, "25"), (fill, "three"), (fill, "3"), (fill, "next")])
    assert [point.level_cm for point in session_of(bench, person)] == [3.0]
    refused = [line for line in person.said if line.startswith("Not taken")]
    assert "level 25 cm is outside 0..20 cm" in refused[0]
    assert "'three' is not a level" in refused[1]


def test_a_level_that_falls_is_not_taken() -> None:
    bench = LockstepBench(overlay={"tanks": {"hold_until_run": False}})
    person = Person([(filled(bench, 15.0, 9.0, 1.0, 1.0), "15")])
    assert session_of(bench, person) == []
    assert "the reading has not settled: the level falls by 0.3" in person.said[-1]


def test_wanted_levels_are_taken_with_enter() -> None:
    bench = LockstepBench()
    wanted = [KnownLevel(tank=2, level_cm=4.0), KnownLevel(tank=2, level_cm=16.0)]
    person = Person([(filled(bench, 3.0, 4.0, 1.0, 1.0), ""), (filled(bench, 3.0, 16.0, 1.0, 1.0), "")])
    points = session_of(bench, person, (1,), wanted)
    assert [(point.tank, point.level_cm) for point in points] == [(1, 4.0), (1, 16.0)]
    assert [point.reading_V for point in points] == pytest.approx([2.0, 8.0], abs=3e-3)


def test_running_pumps_end_the_session() -> None:
    bench = LockstepBench()
    with bench.probe() as other:
        other.listen(0.2)
        other.drive(lambda _: (1.0, 1.0), 0.5)
        with pytest.raises(PumpsMoveError, match=r"applies 1\.00\d V"):
            Session(bench.probe(), sensor_facts(RIG), Person([])).run((0,))
    bench.close()
