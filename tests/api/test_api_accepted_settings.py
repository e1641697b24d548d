"""Whatever the settings check accepts runs its first control steps; everything else is refused with a reason."""

import operator
import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hil
from hil.edge.config.settings_file import default_config_dir

NUMBER = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(min_value=1e-6, max_value=1e6),
    st.sampled_from([0.0, 1e-300, 5e-324, 1e300, 1.0, 0.5, 0.1, 0.2, 10.0]),
)
SHARE = st.one_of(NUMBER, st.floats(min_value=0.0, max_value=1.0))
POLE = st.one_of(NUMBER, st.floats(min_value=-10.0, max_value=0.0))
WHOLE = st.integers(min_value=-1, max_value=1001)
VOLT = st.one_of(NUMBER, st.floats(min_value=0.0, max_value=10.0))


def _vector(values: st.SearchStrategy[float], count: int) -> st.SearchStrategy[list[float]]:
    return st.lists(values, min_size=count, max_size=count)


def _one_or(count: int, values: st.SearchStrategy[float]) -> st.SearchStrategy[object]:
    return st.one_of(values, _vector(values, count))


KEYS: dict[str, st.SearchStrategy[object]] = {
    "tanks.area_cm2": _vector(NUMBER, 4),
    "tanks.outlet_cm2": _vector(NUMBER, 4),
    "tanks.height_cm": _one_or(4, NUMBER),
    "tanks.datum_cm": _one_or(4, st.one_of(NUMBER, st.floats(min_value=0.0, max_value=2.0))),
    "tanks.gravity_cm_s2": NUMBER,
    "pumps.gain_cm3_Vs": _vector(NUMBER, 2),
    "pumps.valve_split": _vector(SHARE, 2),
    "pumps.lag_s": _one_or(2, NUMBER),
    "pumps.dead_zone_V": _one_or(2, VOLT),
    "pumps.curve_1_V": _one_or(2, st.one_of(NUMBER, st.floats(min_value=-0.06, max_value=0.3))),
    "pumps.delay_s": _one_or(2, VOLT),
    "pumps.range_V": _vector(VOLT, 2),
    "pumps.rate_V_s": NUMBER,
    "sensors.gain_V_cm": _one_or(4, st.one_of(NUMBER, st.floats(min_value=-0.5, max_value=0.5))),
    "sensors.offset_V": _one_or(4, st.one_of(NUMBER, VOLT)),
    "sensors.noise_V": _one_or(4, NUMBER),
    "uncertainty.pump_gain": _one_or(2, SHARE),
    "uncertainty.valve_split": _one_or(2, SHARE),
    "uncertainty.outlet": _one_or(4, SHARE),
    "uncertainty.lag": _one_or(2, VOLT),
    "sensors.range_V": _vector(NUMBER, 2),
    "control.period_s": st.one_of(NUMBER, st.floats(min_value=0.001, max_value=0.2)),
    "control.operating_point_V": _vector(VOLT, 2),
    "control.output_poles": _vector(POLE, 4),
    "control.noise_gain_max": NUMBER,
    "control.anti_windup_s": NUMBER,
    "control.level_filter_s": NUMBER,
    "safety.level_max_cm": NUMBER,
    "safety.rim_margin_cm": NUMBER,
    "safety.levels_age_max_s": NUMBER,
    "safety.status_age_max_s": NUMBER,
    "safety.heartbeat_age_max_s": NUMBER,
    "safety.echo_age_max_s": NUMBER,
    "safety.echo_tolerance_V": NUMBER,
    "safety.echo_mismatch_s": NUMBER,
    "safety.invalid_run_max": WHOLE,
    "safety.refused_run_max": WHOLE,
    "safety.errors_per_s_max": WHOLE,
    "safety.dead_below": SHARE,
    "safety.dry_run_V": NUMBER,
    "safety.stop_ramp_V_s": NUMBER,
}
SHIPPED = tomllib.loads((default_config_dir() / "rig.toml").read_text(encoding="utf-8"))


def _near(key: str) -> st.SearchStrategy[object]:
    """The shipped value times 0.3 to 3, each entry of a list on its own: most of these are accepted."""
    section, name = key.split(".")
    value = SHIPPED[section][name]
    factor = st.floats(min_value=0.3, max_value=3.0)
    if isinstance(value, list):
        return st.tuples(*[factor.map(partial(operator.mul, entry)) for entry in value]).map(list)
    return factor.map(lambda f: type(value)(value * f))


CHANGES = st.lists(st.sampled_from(sorted(KEYS)), min_size=1, max_size=3, unique=True).flatmap(
    lambda keys: st.fixed_dictionaries({key: st.one_of(_near(key), _near(key), KEYS[key]) for key in keys})
)


def _toml(value: object) -> str:
    return f"[{', '.join(map(repr, value))}]" if isinstance(value, list) else repr(value)


@settings(
    max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@pytest.mark.long
@given(CHANGES, st.sampled_from(["glr", "none"]), st.sampled_from(["rig", "rig", "calibrated"]))
def test_whatever_the_check_accepts_survives_its_first_steps(
    tmp_path: Path, changes: dict[str, object], method: str, design: str
) -> None:
    """Splits of 0.5 and 0.5, and much else, used to pass the check and to trip `controller_failed` at once."""
    lines = "".join(f"{key} = {_toml(value)}\n" for key, value in changes.items())
    path = tmp_path / "drawn.toml"
    path.write_text(
        f'[scenario]\nname = "drawn"\nduration_s = 0.5\n[diagnosis]\nmethod = "{method}"\n'
        f'[control]\ndesign = "{design}"\n[rig]\nsafety.arm_timeout_s = 1.0\n{lines}'
    )
    with np.errstate(all="ignore"):
        try:
            bench = hil.load(path)
        except hil.SettingsError as error:
            refusal = str(error)
        else:
            refusal = ""
            result = hil.simulate(bench)
    if refusal:
        assert "drawn.toml" in refusal
        assert "\n" not in refusal
        return
    assert result.reason != "controller_failed", [event.text for event in result.events]


@pytest.mark.parametrize("key", sorted(KEYS))
def test_every_number_of_the_rig_file_may_be_drawn_alone(key: str) -> None:
    """The strategies above cover each number of the rig file that has more than a choice of words."""
    section, name = key.split(".")
    assert name in type(getattr(hil.load("steps").rig, section)).model_fields
