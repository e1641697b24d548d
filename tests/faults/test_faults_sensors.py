"""Cases 31 to 37: level sensors that lie, drift, break or fall silent. The rig is 3 % off its file."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from math import inf, nan
from typing import Any

import pytest

from hil.core.diagnosis.detector import FaultDetector
from hil.core.types import Diagnosis, Mode
from tests.faults.faults_bench import (
    OFF,
    T_S,
    TIME_TOLERANCE_S,
    Run,
    assert_no_trip,
    assert_tripped,
    fault,
    first,
    play,
    scenario_data,
    watched,
)
from tests.narrowing import not_none

AT_S = 25.0
SENSORS = (1, 2, 3, 4)
GAIN_V_CM, LEVEL_MAX_CM = 0.5, 19.0
SAMPLE_S = 0.02


def assert_substituted(run: Run, sensor: int, from_s: float | None) -> None:
    """From then on the outputs follow their references all the same, by truth."""
    assert from_s is not None
    ends = [
        t for t in zip(run.ticks, run.keeper.truths, strict=True) if t[0].t_s > from_s and t[0].mode is Mode.DEGRADED
    ]
    assert ends, "nothing was accommodated"
    worst_cm = max(abs(tick.estimated_V[sensor - 1] / GAIN_V_CM - truth.levels_cm[sensor - 1]) for tick, truth in ends)
    assert worst_cm < 2.0, "the model is in the sensor's place"


@pytest.mark.parametrize("sensor", SENSORS)
def test_case_31_sensor_stuck(sensor: int) -> None:
    """A reading that stands still is isolated within 5 s; the model takes its place."""
    run = play(watched(fault("sensor_stuck", AT_S, sensor)))
    assert_no_trip(run)
    found = run.finding(f"sensor_stuck {sensor}")
    assert found.isolated_s is not None
    assert AT_S <= found.isolated_s <= AT_S + 5.0
    assert run.names == [f"sensor_stuck {sensor}"]
    assert_substituted(run, sensor, found.isolated_s)


EARLY = [(1575, 1.457646, 2), (1, 1.37, 2), (5, 2.85, 2)]


@pytest.mark.parametrize(("seed", "at_s", "sensor"), EARLY)
def test_case_31_sensor_stuck_while_levels_still_move(seed: int, at_s: float, sensor: int) -> None:
    """In the first seconds, while the levels run: the same, and whatever was suspected before is taken back."""
    run = play(watched(fault("sensor_stuck", at_s, sensor)), seed=seed)
    assert_no_trip(run)
    assert not_none(run.finding(f"sensor_stuck {sensor}").isolated_s) <= at_s + 5.0
    assert_substituted(run, sensor, at_s + 5.0)


@pytest.mark.parametrize("rate_V_s", first(1, 0.05, -0.1, 0.01, -0.02, 0.02, -0.05, 0.1))
@pytest.mark.parametrize("sensor", SENSORS)
def test_case_32_sensor_drifts(sensor: int, rate_V_s: float) -> None:
    """A drift is found before what is believed of the level is 2 cm off.

    A lower sensor that comes to read a full tank trips the run, since a clogged outlet would read the same; not if a
    movement of the pumps has proven that it drifts. A slow drift of a lower sensor is named after a movement.
    """
    duration_s = 60.0 if abs(rate_V_s) > 0.02 else 130.0
    run = play(watched(fault("sensor_drift", AT_S, sensor, rate_V_s), duration_s=duration_s))
    reads_cm = [
        truth.levels_cm[sensor - 1] + rate_V_s * max(tick.t_s - AT_S, 0.0) / GAIN_V_CM
        for tick, truth in zip(run.ticks, run.keeper.truths, strict=True)
    ]
    if max(reads_cm) < LEVEL_MAX_CM - 0.2:
        assert_no_trip(run)
    elif run.trips:
        assert [cause for _, cause in run.trips] == ["high_level"], run.told
        assert f"sensor {sensor}, which diagnosis does not trust, may be right" in run.told[-1]
        assert reads_cm[-1] > LEVEL_MAX_CM - 0.2, "not before"
    assert max(max(truth.levels_cm) for truth in run.keeper.truths) < LEVEL_MAX_CM - 1.0
    found = run.finding(f"sensor_drift {sensor}", f"sensor_bias {sensor}")
    assert found.isolated_s is not None
    assert abs(rate_V_s) * (found.isolated_s - AT_S) / GAIN_V_CM < 2.0, run.told
    off_cm = [
        abs(tick.estimated_V[sensor - 1] / GAIN_V_CM - truth.levels_cm[sensor - 1])
        for tick, truth in zip(run.ticks, run.keeper.truths, strict=True)
    ]
    assert max(off_cm) < 2.0


@pytest.mark.long
def test_case_32_a_drift_too_slow_for_the_diagnosis_stops_before_the_rim() -> None:
    """At rest, -0.7 mV/s was taken for a slow change of the rig: the tank filled up to 18.5 cm without an alarm."""
    drift = fault("sensor_drift", 40.0, 1, -0.0007)
    run = play(scenario_data(drift, duration_s=5500.0, method="glr", emulator={"parameter_spread": 0.03}), seed=6)
    assert (run.outcome.status, run.outcome.reason) == ("stopped", "high_level"), run.told


@lru_cache(maxsize=1)
def healthy() -> Run:
    return play(watched())


@pytest.mark.parametrize("bias_V", first(1, -0.3, 0.1, 0.5))
@pytest.mark.parametrize("sensor", SENSORS)
def test_case_33_sensor_bias_steps(sensor: int, bias_V: float) -> None:
    """A step of the bias is isolated within 3 s, and the gains go on without a jump."""
    run = play(watched(fault("sensor_bias", AT_S, sensor, bias_V)))
    assert_no_trip(run)
    found = run.finding(f"sensor_bias {sensor}")
    assert found.isolated_s is not None
    assert AT_S <= found.isolated_s <= AT_S + 3.0
    settled = [
        abs(tick.estimated_V[sensor - 1] / GAIN_V_CM - truth.levels_cm[sensor - 1])
        for tick, truth in zip(run.ticks, run.keeper.truths, strict=True)
        if AT_S + 3.0 <= tick.t_s < AT_S + 6.0
    ]
    assert max(settled) < 0.2, "the bias is known"
    plain = healthy()
    moved = [
        abs(a - b)
        for one, other in zip(run.keeper.truths, plain.keeper.truths, strict=False)
        for a, b in zip(one.levels_cm[:2], other.levels_cm[:2], strict=True)
    ]
    assert max(moved) < 0.3, "the outputs hardly notice: bumpless"


@pytest.mark.parametrize("kind", first(1, "open", "short"))
@pytest.mark.parametrize("sensor", SENSORS)
def test_case_34_sensor_open_or_short(sensor: int, kind: str) -> None:
    """A broken wire or a short: invalid by the third sample; the model takes its place."""
    given_fault = fault("sensor_open", AT_S, sensor) if kind == "open" else fault("sensor_bias", AT_S, sensor, -10.24)
    run = play(watched(given_fault))
    assert_no_trip(run)
    found = run.finding(f"sensor_open {sensor}")
    assert found.isolated_s is not None
    assert found.isolated_s <= AT_S + 3 * SAMPLE_S + T_S
    assert_substituted(run, sensor, found.isolated_s)


@pytest.mark.parametrize("sensor", SENSORS)
def test_case_34_without_a_diagnosis(sensor: int) -> None:
    """With nobody to take the sensor's place: trip on the third sample."""
    run = play(scenario_data(fault("sensor_open", 5.0, sensor)))
    assert_tripped(run, 5.0, 3 * SAMPLE_S + T_S, "invalid_levels")


class Nonsense:
    """The scenario's own detector, with something in its verdict that is no number from a time on."""

    def __init__(self, detector: FaultDetector, damage: Callable[[Diagnosis], Diagnosis]) -> None:
        self._detector, self._damage = detector, damage

    def start(self) -> Any:
        return self._detector.start()

    def step(self, memory: Any, t_s: float, *arguments: Any) -> tuple[Any, Diagnosis]:
        memory, diagnosis = self._detector.step(memory, t_s, *arguments)
        return memory, self._damage(diagnosis) if t_s >= 5.0 - TIME_TOLERANCE_S else diagnosis


NONSENSE: dict[str, Callable[[Diagnosis, float], Diagnosis]] = {
    "effectiveness": lambda d, x: replace(d, effectiveness=(x, 1.0)),
    "levels": lambda d, x: replace(d, trusted=(False, True, True, True), level_V=(x, 6.0, 0.8, 0.7)),
    "all levels": lambda d, x: replace(d, level_V=(x,) * 4),
}


@pytest.mark.parametrize("number", [nan, inf, -inf])
@pytest.mark.parametrize("where", NONSENSE)
def test_case_35_what_is_no_number(where: str, number: float) -> None:
    """NaN or infinity in a verdict: 0 V in the same tick; every command sent is a voltage within range."""

    def damaged(diagnosis: Diagnosis) -> Diagnosis:
        return NONSENSE[where](diagnosis, number)

    run = play(scenario_data(), detector=lambda own: Nonsense(own, damaged))
    if where == "all levels":  # trusted sensors go by their readings; the estimate is only looked at
        assert all(0.0 <= v <= 10.0 for tick in run.ticks for v in tick.command_V)
        return
    assert_tripped(run, 5.0 - T_S, T_S, "controller_failed", "invalid_levels")  # a failed step has no time of its own
    assert all(tick.command_V == OFF for tick in run.from_s(5.0))


@pytest.mark.parametrize("sensor", SENSORS)
def test_case_36_sensor_garbage(sensor: int) -> None:
    """Codes from the whole range, each with a good status: invalid by the third sample."""
    run = play(watched(fault("sensor_garbage", AT_S, sensor)))
    assert_no_trip(run)
    found = run.finding(f"sensor_garbage {sensor}")
    assert found.isolated_s is not None
    assert found.isolated_s <= AT_S + 3 * SAMPLE_S + T_S, run.told
    assert_substituted(run, sensor, found.isolated_s)


@pytest.mark.parametrize(("first", "second"), [(1, 2), (1, 3), (4, 2), (3, 4)])
def test_case_37_two_sensors_fail(first: int, second: int) -> None:
    """With the second sensor gone the rig is safe, one tick after it has been isolated."""
    run = play(watched(fault("sensor_stuck", AT_S, first), fault("sensor_open", AT_S + 5.0, second)))
    isolated_s = run.finding(f"sensor_open {second}").isolated_s
    assert isolated_s is not None
    assert_tripped(run, AT_S + 5.0, isolated_s + T_S - AT_S - 5.0, "sensors_lost", "invalid_levels")


@pytest.mark.parametrize(("sensor", "pump"), [(1, 1), (2, 2)])
def test_case_37_a_tank_without_sensor_whose_pump_then_runs_on(sensor: int, pump: int) -> None:
    """Without its sensor, a pump that runs on and a valve that has moved look the same: safe, before the tank fills."""
    faults = fault("sensor_stuck", AT_S, sensor), fault("pump_stuck_on", AT_S + 3.0, pump, 9.5)
    run = play(watched(*faults))
    assert_tripped(run, AT_S + 3.0, 5.0, "sensors_lost", "pump_stuck_on", "high_level")


@pytest.mark.parametrize(
    ("sensor", "seed", "after_s"), [(1, 8, 0.575), (2, 3, 0.585), (3, 3, 0.585), (4, 3, 0.585)]
)  # a noise that begins with a large reading
def test_noise_takes_back_what_its_first_readings_led_to(sensor: int, seed: int, after_s: float) -> None:
    """One noisy reading at the end of a period looks like a bias; once the noise is plain nothing else is left."""
    run = play(watched(fault("sensor_noise", AT_S + after_s, sensor, 0.1)), seed=seed)
    assert_no_trip(run)
    (found,) = run.findings
    assert (found.kind, found.target, found.flips) == ("sensor_noise", sensor, 1), run.told
    assert found.size == pytest.approx(0.1, rel=0.5)
    assert run.at(44.0).mode is Mode.RUNNING, "the sensor is used on, for what it is worth"
