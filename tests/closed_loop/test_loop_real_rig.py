"""Runs on a rig as it is: curve, dead zone, delay, datums, falling sensors, with the same values in the rig file."""

from pathlib import Path

import numpy as np
import pytest

from hil.bench import assembly
from hil.bench.reference_plan import reference_plan
from hil.bench.results import RunResult
from hil.core.laws.state_feedback_law import StateFeedbackLaw
from hil.edge.config.settings_file import SettingsError
from hil.review.ticks import LoggedEvent
from tests.real_rig import RIG, real_rig, scenario

HEAD = '[scenario]\nname = "real"\nduration_s = {}\n'
DELAY_S = 0.4


def run(tmp_path: Path, text: str, duration_s: float, seed: int = 4) -> RunResult:
    import hil

    file = scenario(tmp_path / "real.toml", HEAD.format(duration_s) + text)
    return hil.simulate(str(file), seed=seed)


def alarms(result: RunResult) -> list[LoggedEvent]:
    return [event for event in result.events if event.code == "alarm"]


def fault(kind: str, target: int, value: float, at_s: float) -> str:
    return f'[[fault]]\nat_s = {at_s}\nkind = "{kind}"\ntarget = {target}\nvalue = {value}\n'


def test_at_rest_and_on_steps_the_levels_hold_and_nothing_is_found(tmp_path: Path) -> None:
    """A law for straight pumps would begin 2 V below what holds these levels."""
    steps = "".join(
        f"[[reference]]\nat_s = {t}\nchange_V = {v}\n" for t, v in ((20.0, [0.4, -0.2]), (60.0, [-0.4, 0.3]))
    )
    result = run(tmp_path, steps, 120.0)
    assert alarms(result) == []
    assert result.status == "complete"
    series = {name: np.array(values) for name, values in result.series.items()}
    settled = (series["t_s"] > 15.0) & (series["t_s"] < 20.0)
    for output in (1, 2):
        error_cm = series[f"r{output}_V"] / 0.5 - series[f"true_h{output}_cm"]
        assert np.abs(error_cm[settled]).max() < 0.4
        assert abs(error_cm[-20]) < 0.2
        assert series[f"v{output}_operating_V"][0] == pytest.approx(RIG["control"]["operating_point_V"][output - 1])
    assert np.abs(series["h1_V"] - 0.5 * series["true_h1_cm"]).max() < 0.03
    assert np.abs(series["h4_V"] - 0.5 * series["true_h4_cm"]).max() < 0.06


@pytest.mark.parametrize(("left", "within_s"), [((0.4, 0.4), 0.3), ((1.0, 0.8), 0.7)])
def test_lost_gain_is_found_as_soon_as_its_water_is_missing(
    tmp_path: Path, left: tuple[float, float], within_s: float
) -> None:
    faults = "".join(fault("pump_effectiveness", j + 1, left[j], 40.0) for j in (0, 1) if left[j] < 1.0)
    result = run(tmp_path, faults, 46.0)
    first, *_ = alarms(result)
    assert 40.0 <= first.t_s <= 40.0 + DELAY_S + within_s + 1e-6
    named = {(event.data["kind"], event.data["target"]): event.data["size"] for event in alarms(result)}
    named.pop(("unresolved", 0), None)
    assert set(named) == {("pump_effectiveness", j + 1) for j in (0, 1) if left[j] < 1.0}
    last = [result.series[f"theta{j}"][-1] for j in (1, 2)]
    assert last == pytest.approx(left, abs=0.04)


@pytest.mark.parametrize(
    ("kind", "target", "value"), [("sensor_bias", 1, 0.2), ("sensor_bias", 4, -0.03), ("sensor_noise", 1, 0.05)]
)
def test_a_fault_of_a_sensor_is_told_in_its_own_volts(tmp_path: Path, kind: str, target: int, value: float) -> None:
    """Sensor 1 falls and has 0.45 V/cm, sensor 4 has a tenth of that."""
    found = alarms(run(tmp_path, fault(kind, target, value, 30.0), 34.0))[-1]
    assert (found.data["kind"], found.data["target"]) == (kind, target)
    assert found.data["size"] == pytest.approx(value, rel=0.15)


def test_a_pump_that_is_stuck_on_is_told_by_its_voltage(tmp_path: Path) -> None:
    result = run(tmp_path, fault("pump_stuck_on", 1, 5.0, 30.0), 40.0)
    assert result.reason.startswith("pump_stuck_on")
    (stuck,) = [event for event in alarms(result) if event.data["kind"] == "pump_stuck_on"]
    assert stuck.data["size"] == pytest.approx(5.0, abs=0.3)


def test_an_operator_takes_over_and_gives_back_without_a_bump(tmp_path: Path) -> None:
    """The integrals follow the drives of the operator's voltages."""
    text = '[[request]]\nat_s = 20.0\naction = "manual"\n[[request]]\nat_s = 24.0\naction = "auto"\n'
    result = run(tmp_path, text, 30.0)
    series = result.series
    t_s, v1 = np.array(series["t_s"]), np.array(series["v1_V"])
    around = (t_s > 19.5) & (t_s < 28.0)
    assert np.abs(np.diff(v1[around])).max() < 0.6


def refused(**over: dict[str, object]) -> str:
    with pytest.raises(SettingsError) as refusal:
        real_rig(**over)
    return str(refusal.value)


@pytest.mark.parametrize(
    ("over", "said"),
    [
        ({"pumps": {"curve_1_V": -0.06}}, "curve_1_V -0.06 of pump 1 must be above -0.05263"),
        ({"pumps": {"curve_1_V": [0.0, -0.053]}}, "of pump 2 must be above -0.05208"),
        ({"pumps": {"dead_zone_V": [0.5, 10.0]}}, "dead_zone_V 10 V of pump 2 is not below range_V's upper limit 10 V"),
        (
            {"pumps": {"delay_s": -0.1}},
            "pumps.delay_s = -0.1: must be a number at least 0 and at most 10 or a list of 2",
        ),
        ({"pumps": {"lag_s": [0.1]}}, "pumps.lag_s = [0.1]: must be a number at least 0 or a list of 2"),
        ({"pumps": {"lag_s": [0.1, -1.0]}}, "pumps.lag_s"),
        ({"tanks": {"datum_cm": -1.0}}, "tanks.datum_cm = -1.0: must be a number at least 0 or a list of 4"),
        ({"tanks": {"height_cm": [20.0, 20.0, 18.0, 20.0]}}, "level_max_cm 19 is not below tanks.height_cm 18"),
        ({"tanks": {"datum_cm": 5.0}}, "flow leaves through the low outlet of tank 3, 4, which is empty"),
        ({"sensors": {"gain_V_cm": [0.5, 0.0, 0.5, 0.5]}}, "a gain is 0.001 V/cm or more, or negative"),
        ({"sensors": {"offset_V": [8.0, 0.1, 1.0, 8.0]}}, "sensor 1 would read -0.55 V at 19 cm (safety.level_max_cm)"),
        ({"sensors": {"offset_V": [9.5, 0.1, 11.0, 8.0]}}, "sensor 3 would read 11.09 V at 1.7"),
        ({"uncertainty": {"outlet": [0.1, 0.1]}}, "uncertainty.outlet = [0.1, 0.1]: must be a number at least 0"),
        ({"uncertainty": {"lag": 5.1}}, "uncertainty.lag = 5.1: must be a number at least 0 and at most 5"),
        ({"uncertainty": {"pump": 0.1}}, "uncertainty.pump = 0.1: unknown key"),
    ],
)
def test_what_can_not_be_is_refused_by_name(over: dict[str, dict[str, object]], said: str) -> None:
    assert said in refused(**over)


def test_keys_may_be_left_out_and_give_the_numbers_of_the_papers_rig(tmp_path: Path) -> None:
    from hil.edge.config.rig_file import load_rig
    from hil.edge.config.settings_file import default_config_dir

    text = (default_config_dir() / "rig.toml").read_text(encoding="utf-8")
    new = (
        "datum_cm",
        "dead_zone_V",
        "curve_1_V",
        "delay_s",
        "offset_V",
        "[uncertainty]",
        "pump_gain",
        "outlet =",
        "lag =",
    )
    kept = [line for line in text.splitlines() if not line.startswith(new)]
    short = tmp_path / "rig.toml"
    short.write_text("\n".join(line for line in kept if line != "valve_split = 0.03" and "0.03  " not in line))
    whole, brief = load_rig(default_config_dir() / "rig.toml"), load_rig(short)
    assert brief == whole
    assert brief.uncertainty.of_each.pump_gain == (0.03, 0.03)
    assert brief.level_sensors.is_plain
    assert brief.pump_path.is_straight


def test_a_reference_is_a_level_signal(tmp_path: Path) -> None:
    """0.5 V/cm whatever the sensors; the first output is read by a falling sensor of 0.45 V/cm."""
    file = scenario(tmp_path / "real.toml", HEAD.format(20.0) + "[[reference]]\nat_s = 5.0\nlevels_V = [6.0, 6.5]\n")
    bench = assembly.load(file)
    assert reference_plan(bench.scenario, bench.rig, "")[0][-1] == (5.0, (6.0, 6.5))
    chosen = assembly.controller_config(bench).loop.law
    assert isinstance(chosen, StateFeedbackLaw)
    law = chosen.reconfiguration.law((6.0, 6.5), (1.0, 1.0))
    assert law.operating_level_cm[:2] == pytest.approx((12.0, 13.0))
