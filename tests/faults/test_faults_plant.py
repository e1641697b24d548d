"""Cases 41, 42, 44, 45: leaks, blocked outlets, valves that move, and a rig that is merely not what its file says."""

from typing import Any

import pytest

from hil.core.types import Pair
from tests.faults.faults_bench import RIM_CM, assert_no_trip, fault, first, play, scenario_data, watched
from tests.narrowing import not_none

AT_S = 25.0
MINUTE_NS = 60_000_000_000
TANKS = (1, 2, 3, 4)
SPLIT = (0.70, 0.60)
PUMP_KINDS = ("pump_effectiveness", "pump_dead", "pump_stuck_on", "pump_lag")


@pytest.mark.parametrize("share", first(1, 0.5, 0.2, 1.0))
@pytest.mark.parametrize("tank", TANKS)
def test_case_41_leak(tank: int, share: float) -> None:
    """A leak is called one within 20 s, and never a pump's fault."""
    run = play(watched(fault("leak", AT_S, tank, share), duration_s=60.0))
    assert_no_trip(run)
    assert not_none(run.finding(f"leak {tank}").isolated_s) <= AT_S + 20.0, run.told
    assert not [name for name in run.names if name.startswith(PUMP_KINDS)]
    assert run.ticks[-1].effectiveness == (1.0, 1.0)


BLOCKED = [
    *((tank, method) for tank in (1, 3) for method in ("none", "glr")),
    *(pytest.param(tank, method, marks=pytest.mark.long) for tank in (2, 4) for method in ("none", "glr")),
]


@pytest.mark.parametrize(("tank", "method"), BLOCKED)
def test_case_42_outlet_blocked(tank: int, method: str) -> None:
    """A tank that can no longer drain fills: trip on a high level, before the rim.

    Or an orderly stop before that, because no law holds such tanks, if the diagnosis has found the blockage.
    """
    up = ((5.0, (1.5, 1.5)),)
    emulator = {"parameter_spread": 0.03}
    scenario = scenario_data(
        fault("outlet_block", AT_S, tank, 1.0), duration_s=600.0, method=method, references=up, emulator=emulator
    )
    run = play(scenario)
    is_stopped = method != "none" and run.outcome.reason == "no_stable_law"
    assert is_stopped or run.cause == "high_level", run.told
    run.emulator.advance(run.emulator.now_ns + MINUTE_NS)
    assert run.emulator.truth().spilled_cm3 == 0.0
    assert method == "none" or run.names == [f"outlet_block {tank}"], run.told
    assert max(max(truth.levels_cm) for truth in run.keeper.truths) < RIM_CM


@pytest.mark.parametrize("rate_1_s", first(1, 0.02, 0.005, 0.001))
@pytest.mark.parametrize("tank", first(1, 1, 2))
def test_case_42_outlet_clogs(tank: int, rate_1_s: float) -> None:
    """Before the rim also where it grows and is taken for a sensor drift, and with the upper tank drained afterwards.

    The tank overflowed without a trip: the model's level replaced the sensor's, which showed 19 cm.
    """
    clogging = fault("outlet_block", AT_S, tank, 0.95, ramp_s=0.95 / rate_1_s)
    scenario = scenario_data(
        clogging, duration_s=AT_S + 40.0 + 0.5 / rate_1_s, method="glr", emulator={"parameter_spread": 0.03}
    )
    run = play(scenario, seed=3)
    run.emulator.advance(run.emulator.now_ns + MINUTE_NS)
    assert run.emulator.truth().spilled_cm3 == 0.0, run.told
    assert run.cause in ("high_level", ""), run.told


@pytest.mark.parametrize("by", first(1, 0.15, -0.15))
@pytest.mark.parametrize("pump", [1, 2])
def test_case_44_valve_split_drifts(pump: int, by: float) -> None:
    """A valve that moves in five small steps: an alarm, or outputs that stay with their references, within 30 s."""
    steps = [fault("valve_split", AT_S + i, pump, SPLIT[pump - 1] + by * (i + 1) / 5) for i in range(5)]
    run = play(watched(*steps, duration_s=70.0))
    assert_no_trip(run)
    alarms = [f for f in run.findings if not_none(f.detected_s) <= AT_S + 30.0]
    assert alarms, "it is spoken of"
    assert not [name for name in run.names if name.startswith(("sensor", *PUMP_KINDS))], run.told


@pytest.mark.parametrize("pump", first(1, 1, 2))
def test_case_44_valve_beyond_a_sum_of_one_ends_in_an_orderly_way(pump: int) -> None:
    """The law of the rig file's splits is unstable then: it ran into a trip.

    Pump 1 leaves a sum of 0.85: the law of the other phase goes on, and says what it aims at. Pump 2 leaves 0.95, too
    near to 1 for any law.
    """
    run = play(watched(fault("valve_split", AT_S, pump, 0.25), duration_s=60.0))
    assert run.names == [f"valve_split {pump}"], run.told
    assert run.trips == [], run.told
    if pump == 1:
        assert run.outcome.status == "complete", run.told
        assert run.times("target")[0] <= AT_S + 5.0
    else:
        assert (run.outcome.status, run.outcome.reason) == ("stopped", "no_stable_law"), run.told
    assert max(max(truth.levels_cm) for truth in run.keeper.truths) < 16.0


def wandering(duration_s: float) -> tuple[tuple[float, Pair], ...]:
    """References that step every 40 s, up and down."""
    steps = ((0.3, 0.2), (-0.2, 0.1), (-0.1, -0.3), (0.0, 0.0), (0.2, -0.2), (-0.2, 0.2))
    return tuple((20.0 + 40.0 * i, steps[i % len(steps)]) for i in range(int(duration_s / 40.0)))


def quiet(duration_s: float) -> dict[str, Any]:
    """No fault; 5 % of model error, and turbulence."""
    emulator = {"parameter_spread": 0.05, "tanks": {"turbulence_cm3_sqrt_s": 0.02}}
    return scenario_data(duration_s=duration_s, method="glr", references=wandering(duration_s), emulator=emulator)


@pytest.mark.parametrize("seed", first(1, 1, 2, 3, 4, 5))
def test_case_45_nothing_wrong(seed: int) -> None:
    """Steps, disturbances and 5 % model error, two minutes: no alarm; the hour is among the long tests."""
    run = play(quiet(120.0), seed=seed)
    assert_no_trip(run)
    assert run.findings == (), run.told


@pytest.mark.long
@pytest.mark.parametrize("seed", [11, 12])
def test_case_45_nothing_wrong_for_an_hour(seed: int) -> None:
    """Steps, disturbances and 5 % model error, an hour: no alarm."""
    run = play(quiet(3600.0), seed=seed)
    assert_no_trip(run)
    assert run.findings == (), run.told
