"""Settings of the safety, and what an operator may ask for, as the files say them."""

import tomllib
from pathlib import Path

import pytest

from hil.bench.assembly import controller_config, load
from hil.core.interlocks import BYPASSABLE
from hil.core.types import Action, Request, TripCause
from hil.edge.config.scenario_file import OperatorRequest, load_scenario
from hil.edge.config.settings_file import SettingsError
from tests.safety.safety_bench import LIMITS, ROOT

HEAD = '[scenario]\nname = "asked"\nduration_s = 10.0\n'


def scenario(tmp_path: Path, more: str) -> Path:
    path = tmp_path / "asked.toml"
    path.write_text(HEAD + more)
    return path


def asked(**keys: float | str) -> str:
    lines = "".join(f"{key} = {value}\n" for key, value in keys.items())
    return f"[[request]]\n{lines}"


def test_requests_of_a_scenario_reach_the_controller(tmp_path: Path) -> None:
    path = scenario(
        tmp_path,
        asked(at_s=1.0, action='"manual"')
        + asked(at_s=2.0, action='"manual"', voltage_V="[4.0, 2.5]")
        + asked(at_s=3.0, action='"auto"')
        + asked(at_s=4.0, action='"bypass"', interlock='"dry_run"', for_s=600.0)
        + asked(at_s=5.0, action='"clear"')
        + asked(at_s=6.0, action='"stop"'),
    )
    assert controller_config(load(path)).requests == (
        (1.0, Request(Action.MANUAL)),
        (2.0, Request(Action.MANUAL, (4.0, 2.5))),
        (3.0, Request(Action.AUTO)),
        (4.0, Request(Action.BYPASS, interlock=TripCause.DRY_RUN, for_s=600.0)),
        (5.0, Request(Action.CLEAR)),
        (6.0, Request(Action.STOP)),
    )


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (asked(at_s=0.0, action='"stop"'), "request[0].at_s"),
        (asked(at_s=1.0, action='"jump"'), "request[0].action"),
        (asked(at_s=1.0, action='"manual"', voltage_V="[4.0, 10.5]"), "request[0].voltage_V[1]"),
        (asked(at_s=1.0, action='"auto"', voltage_V="[4.0, 1.0]"), "voltage_V is for manual, not for auto"),
        (asked(at_s=1.0, action='"bypass"', for_s=5.0), "bypass needs interlock"),
        (asked(at_s=1.0, action='"bypass"', interlock='"dry_run"'), "bypass needs for_s"),
        (asked(at_s=1.0, action='"bypass"', interlock='"high_level"', for_s=5.0), "request[0].interlock"),
        (asked(at_s=1.0, action='"bypass"', interlock='"dry_run"', for_s=600.1), "request[0].for_s"),
        (asked(at_s=1.0, action='"stop"', for_s=5.0), "for_s is for bypass, not for stop"),
        (asked(at_s=2.0, action='"stop"') + asked(at_s=1.0, action='"clear"'), "request times [2.0, 1.0]"),
        (asked(at_s=1.0, action='"stop"', who='"me"'), "request[0].who"),
        ("[rig]\nsafety.rim_margin_cm = 1.5\n", "leaves no room for safety.level_max_cm 19 below tanks.height_cm 20"),
        ("[rig]\nsafety.dead_pump = 'hope'\n", "safety.dead_pump"),
        ("[rig]\nsafety.lost_lower_level = 'hope'\n", "safety.lost_lower_level"),
        ("[rig]\nsafety.bypass_max_s = 601.0\n", "safety.bypass_max_s"),
        ("[rig]\nsafety.invalid_run_max = 0\n", "safety.invalid_run_max"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(tmp_path: Path, more: str, named: str) -> None:
    with pytest.raises(SettingsError) as refusal:
        load(scenario(tmp_path, more))
    assert named in str(refusal.value)
    assert "asked.toml" in str(refusal.value)


def test_the_scenario_knows_the_interlocks_that_can_be_bypassed(tmp_path: Path) -> None:
    for cause in BYPASSABLE:
        request = asked(at_s=1.0, action='"bypass"', interlock=f'"{cause}"', for_s=1.0)
        found = load_scenario(scenario(tmp_path, request)).request
        expected = {"at_s": 1.0, "action": "bypass", "interlock": cause.value, "for_s": 1.0}
        assert found == (OperatorRequest.model_validate(expected),)


@pytest.mark.parametrize(("dead_pump", "lost_lower_level"), [("continue", "stop"), ("stop", "continue")])
def test_limits_are_those_of_the_rig_file(tmp_path: Path, dead_pump: str, lost_lower_level: str) -> None:
    policies = f'safety.dead_pump = "{dead_pump}"\nsafety.lost_lower_level = "{lost_lower_level}"\n'
    limits = controller_config(load(scenario(tmp_path, f"[rig]\n{policies}"))).limits
    safety = tomllib.loads((ROOT / "config/rig.toml").read_text())["safety"]
    for key, value in safety.items():
        if key not in ("dead_pump", "lost_lower_level", "arm_timeout_s"):
            assert getattr(limits, key) == value
    assert limits.stops_on_dead_pump is (dead_pump == "stop")
    assert limits.stops_on_lost_lower_level is (lost_lower_level == "stop")
    assert (limits.model, limits.lag_s, limits.level_gain_V_cm) == (LIMITS.model, (0.2, 0.2), 0.5)
