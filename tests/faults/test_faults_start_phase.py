"""Runs from empty tanks, as on every real rig: through the wire, with the diagnosis at work."""

from typing import Any

import pytest

from tests.faults.faults_bench import Run, fault, play, play_with_early_fault, scenario_data

EMPTY = {"tanks": {"start_V": [0.0, 0.0]}}
QUICK = {"start": {"rate_cm_s": 0.3, "settle_s": 25.0}}


def from_empty(*faults: dict[str, Any], method: str = "glr", **emulator: Any) -> dict[str, Any]:
    truth = {"tanks": EMPTY["tanks"], **emulator}
    return scenario_data(*faults, duration_s=8.0, method=method, emulator=truth, rig=QUICK)


def begun_s(run: Run) -> float:
    (first, last) = run.times("start_phase")
    assert last == 0.0
    assert first == run.ticks[0].t_s < 0.0
    return first


def test_the_scenario_s_clock_starts_at_the_end_of_the_start_phase_in_both_programs() -> None:
    """The emulator's scenario started when the pumps first ran: a fault at 5 s came while the tanks were filling."""
    run = play(from_empty(fault("pump_effectiveness", 5.0, 1, 0.4)))
    assert begun_s(run) < -60.0
    assert run.at(0.0).t_s == 0.0
    assert run.truth_at(-1.0).scenario_s is None
    assert run.truth_at(4.0).scenario_s == pytest.approx(4.0)
    assert run.truth_at(4.9).effectiveness == (1.0, 1.0)
    assert run.truth_at(5.1).effectiveness == (0.4, 1.0)
    assert run.finding("pump_effectiveness 1").detected_s == pytest.approx(5.3, abs=0.3)
    assert run.outcome.t_s == pytest.approx(8.2, abs=0.3)
    assert run.seen.column("h1_cm")[-1] < 14.0


def test_a_run_that_begins_at_its_reference_has_none() -> None:
    run = play(scenario_data(duration_s=2.0, rig=QUICK))
    assert run.times("start_phase") == []
    assert run.ticks[0].t_s == 0.0


@pytest.mark.parametrize("gain", [0.85, 1.15])
def test_pumps_that_are_not_as_the_file_says_with_a_dead_zone_get_through_without_a_trip(gain: float) -> None:
    """Pumps 15 % stronger than their file tripped in 2 s, from empty tanks, as stuck on."""
    pumps = {"gain_cm3_Vs": [gain * 3.33, gain * 3.35], "dead_zone_V": 0.5}
    run = play(from_empty(pumps=pumps), seed=1)
    begun_s(run)
    assert run.trips == [], run.told
    assert run.outcome.status == "complete"
    assert max(run.at(0.0).measured_V[:2]) < 7.0


def test_a_pump_that_is_named_on_the_ramp_does_not_send_both_to_their_limit() -> None:
    """The integrals took the way that was still to go for a deviation: 10 V for 18 s, and a trip at 19 cm."""
    run = play_with_early_fault(from_empty(fault("pump_effectiveness", 0.0, 2, 0.7)), 15.0, seed=3)
    named_s = run.finding("pump_effectiveness 2").isolated_s
    assert named_s is not None
    assert begun_s(run) + 15.0 < named_s < begun_s(run) + 20.0
    near = [tick for tick in run.ticks if named_s - 2.0 <= tick.t_s <= named_s + 5.0]
    first, second = ([tick.command_V[pump] for tick in near] for pump in (0, 1))
    assert max(first) - min(first) < 1.5
    assert max(second) < 1.7 * max(second[:10])
    assert run.trips == [], run.told


def test_a_drift_on_a_rig_that_its_file_does_not_describe_ends_the_phase_before_the_tank_is_full() -> None:
    """It was taken for the rig's own pumps and outlets, and named a leak when 41 cm3 had gone over the rim."""
    pumps = {"gain_cm3_Vs": [1.15 * 3.33, 1.15 * 3.35], "dead_zone_V": 0.5}
    data = scenario_data(
        fault("sensor_drift", 0.0, 2, -0.05),
        duration_s=8.0,
        method="glr",
        emulator={"parameter_spread": 0.1, "pumps": pumps, **EMPTY},
    )
    run = play_with_early_fault(data, 17.0, seed=80005)
    assert run.outcome.reason == "start_failed"
    assert "tank 2 gets" in " ".join(run.told)
    assert max(run.seen.column("h2_cm")) < 6.0


def test_a_drift_in_the_first_seconds_is_not_learned_as_the_valve_s_share() -> None:
    """A drift of -25 mV/s looked like a valve that sends less into the tank; the water stood 2 mm below the rim.

    The upper outlet is 10 % wider than its file says, so that the valve seems to send more: the two cancelled.
    """
    pumps = {"gain_cm3_Vs": [0.9 * 3.33, 0.95 * 3.35]}
    tanks = {**EMPTY["tanks"], "outlet_cm2": [0.0653, 0.0542, 0.0781, 0.0542]}
    data = scenario_data(
        fault("sensor_drift", 0.0, 2, -0.025), duration_s=8.0, method="glr", emulator={"pumps": pumps, "tanks": tanks}
    )
    run = play_with_early_fault(data, 3.0, seed=61802)
    assert run.outcome.reason == "start_failed", run.told
    assert max(run.seen.column("h2_cm")) < 6.0


def test_no_tank_is_filled_whose_sensor_is_lost() -> None:
    """A drift was named rightly after 9 s, and the model, whose valves were 13 % off, filled the tank over the rim."""
    pumps = {"gain_cm3_Vs": [1.06 * 3.33, 0.87 * 3.35], "valve_split": [0.79, 0.64]}
    data = scenario_data(
        fault("sensor_drift", 0.0, 2, -0.1), duration_s=8.0, method="glr", emulator={"pumps": pumps, **EMPTY}
    )
    run = play_with_early_fault(data, 5.0, seed=61718)
    assert run.outcome.reason == "start_failed", run.told
    assert "sensor of tank 2 is lost" in " ".join(run.told)
    assert max(run.seen.column("h2_cm")) < 6.0
