"""Cases 29, 30: a node that boots in the midst of a run, one without a heartbeat."""

import pytest

from tests.faults.faults_bench import T_S, assert_tripped, fault, play, scenario_data

AT_S = 5.0
BEAT_S = 0.1


@pytest.mark.parametrize("at_s", [5.0, 5.03, 5.099])
@pytest.mark.parametrize("target", ["pump", "level"])
def test_case_29_node_reboots(target: str, at_s: float) -> None:
    """A node boots while running: its outputs are at 0 V, the controller trips with its next heartbeat."""
    run = play(scenario_data(fault("node_reboot", at_s, target)))
    assert_tripped(run, at_s, BEAT_S + T_S, "node_rebooted")
    if target == "pump":
        boot = next(c for c in run.keeper.changes if c.cause == "reboot")
        assert boot.applied_V == (0.0, 0.0)
        after = [c for c in run.keeper.changes if c.node == "pump" and c.t_ns >= boot.t_ns]
        assert all(c.applied_V == (0.0, 0.0) for c in after), "it never moves again by itself"


@pytest.mark.parametrize("at_s", [5.0, 5.05, 5.099])
@pytest.mark.parametrize("target", ["pump", "level"])
def test_case_30_heartbeat_stops(target: str, at_s: float) -> None:
    """Heartbeats stop, data flow on: trip within two periods of the first one that is missing, and a step."""
    run = play(scenario_data(fault("heartbeat_stop", at_s, target)))
    missing_s = 5.0 if at_s == 5.0 else 5.1
    assert_tripped(run, at_s, missing_s - at_s + 2 * BEAT_S, "node_lost")


@pytest.mark.parametrize("target", ["pump", "level"])
def test_case_30_heartbeat_stops_on_a_bus_that_loses_frames(target: str) -> None:
    """Where frames get lost all the time it takes longer to tell: three times the age, and a step."""
    lossy = [fault("frame_loss", 2.0, frame, 0.05) for frame in ("LowerLevels", "UpperLevels", "PumpStatus")]
    run = play(scenario_data(*lossy, fault("heartbeat_stop", AT_S, target)))
    assert_tripped(run, AT_S, 3 * 0.25 + T_S, "node_lost")
