"""Known levels and the readings at them, over CAN: the pumps stay at 0 V, and no frame is sent.

The user fills a tank to a level that a ruler shows and types it. Meanwhile the reading is shown with its noise, its
drift and whether it has settled. A level is taken only when the reading has settled, lies in the sensor's range, and
the sensor of that tank is the one whose reading has changed.

Why: `docs/decisions/0033-is-the-file-still-right.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from hil.core.errors import HilError
from hil.core.identification.calibration import CalibrationError, LevelPoint, check_point
from hil.core.identification.steady_reading import NO_READING, WAIT, SteadyReading, judge
from hil.core.types import Pair, Quad
from hil.edge.config.points_file import KnownLevel
from hil.probe.bus_probe import Probe
from hil.probe.observation import COMMAND, LEVEL_FRAMES, STATUS, Listener, Observation
from hil.wire.receiver import CHANNEL_OK

WINDOW_S = 3.0
"""Readings of so many seconds are judged."""
SHOW_S = 0.2
FRAME_OF = {tank - 1: name for name, tanks in LEVEL_FRAMES.items() for tank in tanks}
LOST_S = 1.0
NEXT, QUIT = "next", "quit"
MIN_CHANGE_CM = 2.0
"""A level must have changed by so much to tell whose reading follows."""
STANDS_STILL, FOLLOWS = 0.3, 0.6
"""Changes of a reading below and above these shares of the expected one."""


class PumpsMoveError(HilError):
    """A pump runs, or another program commands the pump node."""


class CalibrationDialogue(Protocol):
    """The user."""

    def say(self, text: str) -> None:
        """Show a line that stays."""
        ...

    def show(self, text: str) -> None:
        """Show the reading in the place of the one before."""
        ...

    def typed(self) -> str | None:
        """The next line that was typed, without waiting; None if there is none. Raises EOFError at the end."""
        ...


@dataclass(frozen=True, slots=True)
class SensorFacts:
    """What the rig file says of the sensors. gain_V_cm, noise_V, height_cm : (4,). range_V : of valid readings."""

    gain_V_cm: Quad
    noise_V: Quad
    range_V: Pair
    height_cm: Quad


@dataclass
class Session:
    """Takes the points of the tanks in turn. on_point : called with all points after each new one."""

    probe: Probe
    facts: SensorFacts
    dialogue: CalibrationDialogue
    on_point: Callable[[Sequence[LevelPoint]], None] = lambda _: None
    points: list[LevelPoint] = field(default_factory=list)
    _means_at: dict[int, tuple[float, Quad]] = field(default_factory=dict)
    _is_over: bool = False

    def run(self, tanks: Sequence[int], wanted: Sequence[KnownLevel] = ()) -> list[LevelPoint]:
        """All points, in their order. tanks : 0..3. wanted : levels that are known beforehand.

        Raises PumpsMoveError, and what the probe raises.
        """
        for tank in tanks:
            self._take(tank, [one for one in wanted if one.tank - 1 == tank and one.point is None])
            if self._is_over:
                break
        return self.points

    def _take(self, tank: int, wanted: Sequence[KnownLevel]) -> None:
        """The points of one tank: the wanted ones; without any, as many as the user types."""
        self.probe.listener = Listener(self.probe.contract)  # it keeps what it has heard; of one tank is enough
        if not wanted:
            self.dialogue.say(
                f"Tank {tank + 1}: close its outlet, fill it to a known level and type the level in cm; "
                f"two levels or more, far apart. '{NEXT}' for the next tank, '{QUIT}' to end."
            )
            while self._point(tank, None):
                pass
        for one in wanted:
            self.dialogue.say(
                f"Tank {tank + 1}: fill it to {one.level_cm:g} cm, then press Enter. '{NEXT}' leaves it out."
            )
            self._point(tank, one)
            if self._is_over:
                return

    def _point(self, tank: int, wanted: KnownLevel | None) -> bool:
        """Wait until a level is taken, or for 'next' and 'quit'; whether more points of this tank may follow."""
        while True:
            state, means = self._look(tank)
            line = self._typed(state)
            if line is None:
                continue
            word = line.strip().lower()
            if word in (NEXT, QUIT):
                self._is_over = word == QUIT
                return False
            try:
                known = wanted if wanted is not None and not word else _known(tank, word)
                self._accept(tank, known, state, means)
                return True
            except CalibrationError as error:
                self.dialogue.say(f"Not taken: {error}")

    def _typed(self, state: SteadyReading) -> str | None:
        """The line that was typed, None if there is none, or while there are not enough readings to judge."""
        if state.lacks == WAIT:
            return None
        try:
            return self.dialogue.typed()
        except EOFError:
            return QUIT

    def _look(self, tank: int) -> tuple[SteadyReading, Quad]:
        """Listen for a moment and show the reading. Returns it, and the means of all four."""
        self.probe.listen(SHOW_S)
        now_ns = self.probe.now_ns
        seen = self.probe.listener.observed(now_ns - round(WINDOW_S * 1e9), now_ns)
        _refuse_moving(seen)
        states = [self._state(seen, one, now_ns) for one in range(4)]
        self.dialogue.show(describe(tank, states[tank]))
        m1, m2, m3, m4 = (state.mean_V for state in states)
        return states[tank], (m1, m2, m3, m4)

    def _state(self, seen: Observation, tank: int, now_ns: int) -> SteadyReading:
        heard = [one for one in seen.of(FRAME_OF[tank]) if int(one.values[f"Status{tank + 1}"]) == CHANNEL_OK]
        if not heard or (now_ns - heard[-1].t_ns) * 1e-9 > LOST_S:
            return NO_READING
        time_s = np.array([(one.t_ns - seen.begin_ns) * 1e-9 for one in heard])
        reading_V = np.array([float(one.values[f"Level{tank + 1}"]) for one in heard])
        return judge(time_s, reading_V, self.facts.gain_V_cm[tank])

    def _accept(self, tank: int, known: KnownLevel, state: SteadyReading, means: Quad) -> None:
        """Keep the point. Raises CalibrationError."""
        facts = self.facts
        if not state.is_settled:
            raise CalibrationError(f"tank {tank + 1}: the reading has not settled: {state.lacks}")
        point = known.with_reading(state.mean_V, state.mean_sd_V)
        check_point(point, facts.height_cm[tank], facts.range_V, facts.noise_V[tank])
        self._refuse_other_tank(tank, known.level_cm, means)
        self.points.append(point)
        self._means_at[tank] = (known.level_cm, means)
        self.on_point(self.points)
        self.dialogue.say(
            f"Taken: tank {tank + 1}, {known.level_cm:g} cm, {state.mean_V:.4f} V, noise {state.noise_V * 1e3:.2f} mV"
        )

    def _refuse_other_tank(self, tank: int, level_cm: float, means: Quad) -> None:
        """Whether the level of this tank has changed since its last point, but only another sensor has followed."""
        before = self._means_at.get(tank)
        if before is None or abs(level_cm - before[0]) < MIN_CHANGE_CM:
            return
        change_cm = abs(level_cm - before[0])
        shares = [
            abs(now - then) / (abs(gain) * change_cm)
            for now, then, gain in zip(means, before[1], self.facts.gain_V_cm, strict=True)
        ]
        other = max((one for one in range(4) if one != tank), key=lambda one: shares[one] if shares[one] >= 0 else 0.0)
        if shares[tank] < STANDS_STILL and shares[other] > FOLLOWS:
            raise CalibrationError(
                f"tank {tank + 1}: its reading has changed by {abs(means[tank] - before[1][tank]):.3f} V only, that of "
                f"tank {other + 1} by {abs(means[other] - before[1][other]):.3f} V: was tank {other + 1} filled?"
            )


def describe(tank: int, state: SteadyReading) -> str:
    """The line that shows the reading."""
    if not state.count:
        return f"tank {tank + 1}: no reading"
    verdict = "settled" if state.is_settled else f"not settled: {state.lacks}"
    return (
        f"tank {tank + 1}: {state.mean_V:7.4f} V, noise {state.noise_V * 1e3:.2f} mV, "
        f"drift {state.drift_V_s * 1e3:+.2f} mV/s, {verdict}"
    )


def _known(tank: int, word: str) -> KnownLevel:
    """The level that was typed. Raises CalibrationError."""
    try:
        level_cm = float(word.removesuffix("cm").replace(",", "."))
        return KnownLevel(tank=tank + 1, level_cm=level_cm)
    except ValueError:
        raise CalibrationError(
            f"tank {tank + 1}: {word!r} is not a level: type a number of cm, '{NEXT}' or '{QUIT}'"
        ) from None


def _refuse_moving(seen: Observation) -> None:
    """Raise PumpsMoveError when a pump runs, or another program commands it."""
    if seen.of(COMMAND):
        raise PumpsMoveError("another program commands the pump node: stop it before hil calibrate")
    for status in seen.of(STATUS):
        applied_V = max(status.values["Applied1"], status.values["Applied2"])
        if applied_V > 0.0:
            raise PumpsMoveError(f"the pump node applies {applied_V:.4g} V: levels are read with both pumps at 0 V")
