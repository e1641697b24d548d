"""Cases 56, 57: what an operator must not, and what one may for a while."""

from typing import Any

import pytest

from hil.core.types import Mode
from tests.faults.faults_bench import OFF, T_S, TIME_TOLERANCE_S, Run, assert_safe, fault, play, scenario_data

AT_S = 5.0


def ask(at_s: float, action: str, **more: str | float) -> dict[str, Any]:
    return {"at_s": at_s, "action": action, **more}


@pytest.mark.parametrize(
    ("given_fault", "cause"),
    [
        (fault("sensor_open", AT_S, 3, until_s=8.0), "invalid_levels"),
        (fault("heartbeat_stop", AT_S, "level", until_s=8.0), "node_lost"),
        (fault("error_frames", AT_S, None, 100.0, until_s=8.0), "error_storm"),
        (fault("frame_burst", AT_S, "UpperLevels", 150), "stale_levels"),
    ],
)
def test_case_56_clearing_while_the_cause_is_active(given_fault: dict[str, str | float], cause: str) -> None:
    """Refused in the same tick, and said so; once the cause is gone the rig is armed again."""
    requests = [ask(7.0, "clear"), ask(10.0, "clear")]
    run = play(scenario_data(given_fault, duration_s=14.0, request=requests))
    assert run.cause == cause
    (refused_s,) = run.times("refused")
    assert refused_s == pytest.approx(7.0, abs=TIME_TOLERANCE_S)
    assert all(tick.mode is Mode.TRIPPED and tick.command_V == OFF for tick in run.from_s(7.0, 10.0))
    assert run.at(12.0).mode is Mode.RUNNING
    assert run.outcome.status == "complete"


def test_case_56_an_unknown_sender_s_trip_is_never_cleared() -> None:
    """That somebody else has sent commands stands for the rest of the run."""
    foreign = fault("foreign_command", AT_S, None, 3.0, until_s=AT_S + 0.05)
    run = play(scenario_data(foreign, duration_s=10.0, request=[ask(8.0, "clear")]), is_alone=False)
    assert len(run.times("refused")) == 1
    assert_safe(run, AT_S + 0.1, 0.5)


def bypassed(for_s: float, until_s: float) -> dict[str, Any]:
    storm = fault("error_frames", 5.0, None, 60.0)
    request = [ask(3.0, "bypass", interlock="error_storm", for_s=for_s)]
    return scenario_data(storm, duration_s=until_s, request=request)


def assert_ends_by_itself(run: Run, for_s: float) -> None:
    (begun_s,), (ended_s,) = run.times("bypass"), run.times("bypass_end")
    assert begun_s == pytest.approx(3.0, abs=TIME_TOLERANCE_S)
    assert ended_s == pytest.approx(3.0 + for_s, abs=T_S + TIME_TOLERANCE_S)
    assert run.cause == "error_storm"
    assert run.trip_s == pytest.approx(ended_s, abs=TIME_TOLERANCE_S), "it counts again in the same step"


def test_case_57_bypass_ends_by_itself() -> None:
    """An interlock bypassed for 20 s: logged at both ends, then it counts again."""
    assert_ends_by_itself(play(bypassed(20.0, 40.0)), 20.0)


@pytest.mark.long
def test_case_57_bypass_ends_after_ten_minutes() -> None:
    """The longest bypass there is: ten minutes."""
    assert_ends_by_itself(play(bypassed(600.0, 700.0)), 600.0)


@pytest.mark.parametrize("key", ["stale_levels", "high_level", "node_tripped", "sensors_lost", "bus_failed"])
def test_case_57_what_must_not_be_bypassed(key: str) -> None:
    """Neither what keeps tanks from overflowing nor the loss of a node, the bus or a level; and nothing for longer."""
    from hil.edge.config.settings_file import SettingsError

    with pytest.raises(SettingsError, match="interlock"):
        play(scenario_data(request=[ask(3.0, "bypass", interlock=key, for_s=20.0)]))
    with pytest.raises(SettingsError, match="for_s"):
        play(scenario_data(request=[ask(3.0, "bypass", interlock="error_storm", for_s=601.0)]))
