"""Lockstep: which of the two programs does what at which simulated time, and in which order."""

from __future__ import annotations

from typing import Any, cast

import can
import pytest

from firmware_sim.ports import BusPort as EmulatorPort
from hil import lockstep
from hil.core.types import Timing
from hil.edge.can.bus import BusPort
from hil.loop import ControlLoop, Outcome

MS = 1_000_000
DONE = Outcome("complete", "duration over", 0.0, 0, 0, 0)


class Script:
    """Loop, port and emulator in one; notes each call with its simulated time in ns. Ends after so many steps."""

    def __init__(self, steps: int, frames: dict[int, list[float]] | None = None) -> None:
        """frames : number of the step -> time stamps in s of the frames that wait then."""
        self.calls: list[tuple[str, int]] = []
        self.outcome: Outcome | None = None
        self._steps, self._frames, self._made = steps, frames or {}, 0

    def step(self, now_ns: int) -> None:
        self.calls.append(("emulator.step", now_ns))

    def waiting(self) -> list[can.Message]:
        return [can.Message(timestamp=stamp_s) for stamp_s in self._frames.get(self._made, [])]

    def receive(self, frame: can.Message, received_ns: int) -> None:
        del frame
        self.calls.append(("loop.receive", received_ns))

    def tick(self, now_ns: int, timing: Timing, stop_reason: str) -> None:
        assert stop_reason == ""
        assert timing == Timing(), "a simulated step is never late"
        self.calls.append(("loop.tick", now_ns))
        self._made += 1
        if self._made == self._steps:
            self.outcome = DONE

    def read(self, now_ns: int) -> None:
        self.calls.append(("emulator.read", now_ns))


def played(script: Script, period_s: float = 0.1, **options: Any) -> Outcome:
    return lockstep.run(
        cast(ControlLoop, script), cast(BusPort, script), cast(EmulatorPort, script), period_s, **options
    )


def test_each_step_sends_receives_steps_and_takes_effect_at_its_own_time() -> None:
    """The clock begins at 0: a run that began later would have all its frames and ages shifted, and nothing saw it."""
    script = Script(3, {0: [0.0], 2: [0.15, 0.2]})
    assert played(script) is DONE
    assert script.calls == [
        ("emulator.step", 0),
        ("loop.receive", 0),
        ("loop.tick", 0),
        ("emulator.read", 0),
        ("emulator.step", 100 * MS),
        ("loop.tick", 100 * MS),
        ("emulator.read", 100 * MS),
        ("emulator.step", 200 * MS),
        ("loop.receive", 150 * MS),
        ("loop.receive", 200 * MS),
        ("loop.tick", 200 * MS),
        ("emulator.read", 200 * MS),
    ]


@pytest.mark.parametrize("period_s", [0.001, 0.01, 0.3])
def test_the_clock_moves_by_exactly_one_period(period_s: float) -> None:
    script = Script(1000)
    played(script, period_s)
    ticks = [at_ns for name, at_ns in script.calls if name == "loop.tick"]
    assert ticks == [number * round(period_s * 1e9) for number in range(1000)]


@pytest.mark.parametrize(("steps", "told"), [(1, []), (99, []), (100, [100]), (199, [100]), (250, [100, 200])])
def test_progress_is_the_number_of_steps_made_every_hundred(steps: int, told: list[int]) -> None:
    progress: list[int] = []
    played(Script(steps), on_progress=progress.append)
    assert progress == told


def test_a_loop_that_is_over_makes_no_step() -> None:
    script = Script(1)
    script.outcome = DONE
    assert played(script) is DONE
    assert script.calls == []
