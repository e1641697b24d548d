"""Cases 38 to 40, 43, 58, 59: pumps that weaken, die, run on or run dry, and the gains that follow. 3 % off."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import pytest

from hil.campaigns.observer import DRY_V, ran_dry
from hil.core.types import Mode
from tests.faults.faults_bench import (
    T_S,
    TIME_TOLERANCE_S,
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
PUMPS = (1, 2)
LEVEL_MAX_CM = 19.0
RATE_V_S = 20.0
LIMIT_V = 4.0
DWELL_S = 10.0


@pytest.mark.parametrize("lost", first(4, 0.1, 0.2, 0.6, 0.9, 0.3, 0.4, 0.5, 0.7, 0.8))
@pytest.mark.parametrize("pump", PUMPS)
def test_case_38_pump_loses_gain(pump: int, lost: float) -> None:
    """10 % are found, 20 % and more isolated and answered with new gains, within 10 s."""
    run = play(watched(fault("pump_effectiveness", AT_S, pump, 1.0 - lost)))
    assert_no_trip(run)
    assert AT_S <= min(not_none(f.detected_s) for f in run.findings) <= AT_S + 10.0, run.told
    if lost > 0.15:
        found = run.finding(f"pump_effectiveness {pump}")
        assert found.isolated_s is not None
        assert found.isolated_s <= AT_S + 10.0
        assert run.times("reconfigured")[0] <= AT_S + 10.0
        assert run.ticks[-2].effectiveness[pump - 1] == pytest.approx(1.0 - lost, abs=0.05)
        assert run.from_s(AT_S + 10.0)[0].mode is Mode.DEGRADED


@pytest.mark.parametrize("policy", ["continue", "stop"])
@pytest.mark.parametrize("pump", PUMPS)
def test_case_39_pump_dead(pump: int, policy: str) -> None:
    """A dead pump is isolated within 5 s; then the nearest reachable reference, or an orderly stop."""
    run = play(watched(fault("pump_dead", AT_S, pump), rig={"safety": {"dead_pump": policy}}))
    assert run.trips == []
    found = run.finding(f"pump_dead {pump}", f"pump_effectiveness {pump}")
    assert found.isolated_s is not None
    assert found.isolated_s <= AT_S + 5.0
    if policy == "stop":
        assert (run.outcome.status, run.outcome.reason) == ("stopped", "pump_dead")
        assert run.outcome.t_s <= AT_S + 6.0
    else:
        assert_no_trip(run)
        assert run.times("target")[0] <= AT_S + 5.0, "says that the reference can't be reached, and what it aims at"


@pytest.mark.parametrize("volts", [2.0, 5.0, 10.0])
@pytest.mark.parametrize("pump", PUMPS)
def test_case_40_pump_stuck_on(pump: int, volts: float) -> None:
    """A pump that runs whatever it is told: 0 V, the relay's cut asked for, an alarm, before the trip level."""
    run = play(watched(fault("pump_stuck_on", AT_S, pump, volts), duration_s=60.0))
    assert run.cause == "pump_stuck_on", run.told
    assert run.times("relay_cut") == [run.trip_s]
    assert run.finding(f"pump_stuck_on {pump}")
    assert max(run.truth_at(run.trip_s).levels_cm) < LEVEL_MAX_CM
    assert run.node_off_s(AT_S) <= run.trip_s + TIME_TOLERANCE_S


def test_case_43_reservoir_low() -> None:
    """Both pumps move air: the dry-run interlock stops them within 2 s."""
    run = play(watched(fault("reservoir_low", AT_S)))
    assert_tripped(run, AT_S, 2.0, "dry_run")


@pytest.mark.parametrize("tank", [1, 2])
def test_case_43_reservoir_low_while_a_pump_stands_still(tank: int) -> None:
    """The pump of a blocked tank hardly turns and shows no lack of water; the other one's is enough.

    With a larger blockage the law aims at levels that both pumps hardly need to run for.
    """
    run = play(watched(fault("outlet_block", 10.0, tank, 0.5), fault("reservoir_low", AT_S)))
    assert run.at(AT_S - T_S).applied_V[tank - 1] < DRY_V
    assert_tripped(run, AT_S, 2.0, "dry_run")


@pytest.mark.parametrize("tank", [1, 2])
def test_case_43_reservoir_low_while_both_pumps_are_at_rest(tank: int) -> None:
    """After a large blockage both pumps may rest, and then nothing shows an empty reservoir until one of them starts.

    It trips before the pump turns: 14 s after the reservoir was empty, at 0.4 V.
    """
    run = play(watched(fault("outlet_block", 8.0, tank, 0.8), fault("reservoir_low", AT_S)), checks=False)
    assert run.cause == "dry_run", run.told
    assert not ran_dry(run.seen)
    started_s = next(tick.t_s for tick in run.from_s(AT_S) if max(tick.applied_V) > DRY_V)
    assert run.trip_s < started_s + 2.0


def test_case_43_reservoir_low_and_an_outlet_blocked_at_once() -> None:
    """A blocked tank keeps its water, which at first looks like a pump that still gives some."""
    run = play(watched(fault("reservoir_low", AT_S + 0.21), fault("outlet_block", AT_S + 0.35, 1, 0.83)), seed=1926)
    assert_tripped(run, AT_S, 2.0, "dry_run")


def flapping(
    values: Sequence[float], *, every_s: float = 1.0, from_s: float = 10.0, to_s: float = 60.0
) -> list[dict[str, Any]]:
    """A pump that loses a share of its gain and gets it back, again and again."""
    times = [from_s + i * 2 * every_s for i in range(int((to_s - from_s) / (2 * every_s)))]
    return [
        fault("pump_effectiveness", t, 1, values[i % len(values)], until_s=t + every_s) for i, t in enumerate(times)
    ]


FLAPPING = [("ideal", 0.95), ("ideal", 0.9), ("glr", 0.95), ("glr", 0.9)]


@pytest.mark.parametrize(("method", "left"), FLAPPING)
def test_case_58_flapping(method: str, left: float) -> None:
    """A fault that comes and goes at its threshold changes the gains at most once in 10 s."""
    diagnosis = {"method": method} | ({"delay_s": 0.2} if method == "ideal" else {})
    scenario = scenario_data(*flapping([left]), duration_s=70.0) | {"diagnosis": diagnosis}
    run = play(scenario)
    assert_no_trip(run)
    changes = run.times("reconfigured")
    assert method == "glr" or changes, "it does follow"
    assert all(b - a >= DWELL_S - TIME_TOLERANCE_S for a, b in pairwise(changes)), changes


@pytest.mark.parametrize("left", [0.7, 0.4])
def test_case_59_gain_change_at_saturation(left: float) -> None:
    """New gains while a pump is at its limit: no step beyond the rate, and no windup to pay back afterwards."""
    up, down = (5.0, (2.2, 0.0)), (40.0, (-2.2, 0.0))
    made: dict[str, Any] = {
        "diagnosis": {"method": "ideal", "delay_s": 0.2},
        "rig": {"pumps": {"range_V": [0.0, LIMIT_V]}},
    }
    run = play(
        scenario_data(fault("pump_effectiveness", 7.0, 1, left), duration_s=140.0, references=(up, down), **made),
    )
    assert_no_trip(run)
    change_s = run.times("reconfigured")[0]
    assert any(v > LIMIT_V - 0.01 for v in run.at(change_s - T_S).command_V), "it is saturated"
    commands = [tick.command_V for tick in run.from_s(change_s - T_S, change_s + 5.0)]
    steps = [abs(b - a) for v, w in pairwise(commands) for a, b in zip(v, w, strict=True)]
    assert max(steps) <= RATE_V_S * T_S + TIME_TOLERANCE_S
    first_s = next(tick.t_s for tick in run.from_s(40.0) if tick.command_V[0] < LIMIT_V - 0.1)
    assert first_s - 40.0 <= 1.0, "the pump leaves its limit as soon as the reference falls"
    target = run.at(139.0).target_V[0]
    under = min(t.levels_cm[0] for tick, t in zip(run.ticks, run.keeper.truths, strict=True) if tick.t_s > 60.0)
    assert target / 0.5 - under < 1.5, "no long way below either"
