"""The probe on a rig that is 3 % off its file: a slow fault at rest that only a movement of the pumps tells apart."""

from __future__ import annotations

from typing import Any

import pytest

from hil.core.types import UNRESOLVED
from tests.faults.faults_bench import Run, assert_no_trip, fault, play, scenario_data

AT_S = 40.0


def at_rest(*faults: dict[str, Any], duration_s: float, probe: bool = True) -> Run:
    tables: dict[str, Any] = {"emulator": {"parameter_spread": 0.03}, "diagnosis": {"method": "glr", "probe": probe}}
    return play(scenario_data(*faults, duration_s=duration_s, **tables), seed=11)


def probes(run: Run) -> list[str]:
    return [str(event.data["state"]) for tick in run.ticks for event in tick.events if event.code == "probe"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "slow", "duration_s"),
    [
        ("sensor_drift 1", fault("sensor_drift", AT_S, 1, -0.0025), 230.0),
        ("sensor_drift 2", fault("sensor_drift", AT_S, 2, 0.0025), 260.0),
    ],
)
def test_a_slow_fault_at_rest_gets_its_name_after_a_movement(
    name: str, slow: dict[str, Any], duration_s: float
) -> None:
    """At rest the lead over the leak or blockage that looks the same was luck: the onsets were not the same."""
    run = at_rest(slow, duration_s=duration_s)
    assert_no_trip(run)
    assert probes(run)[:2] == ["begin", "end"]
    assert run.names == [name], run.told
    moved = [tick.probe_V for tick in run.ticks if tick.probe_V != (0.0, 0.0)]
    assert max(abs(voltage) for pair in moved for voltage in pair) <= 0.3
    begun_s = next(tick.t_s for tick in run.ticks if tick.probe_V != (0.0, 0.0))
    assert all(alarm["kind"] == UNRESOLVED for t_s, alarm in alarms(run) if t_s <= begun_s)


def alarms(run: Run) -> list[tuple[float, dict[str, Any]]]:
    return [(tick.t_s, dict(event.data)) for tick in run.ticks for event in tick.events if event.code == "alarm"]


@pytest.mark.long
def test_nothing_moves_without_a_fault_or_where_it_is_forbidden() -> None:
    assert not probes(at_rest(duration_s=300.0))
    run = at_rest(fault("sensor_drift", AT_S, 1, -0.0025), duration_s=150.0, probe=False)
    assert not probes(run)
    assert all(tick.probe_V == (0.0, 0.0) for tick in run.ticks)
