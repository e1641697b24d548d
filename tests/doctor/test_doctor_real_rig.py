"""The doctor on a rig as it is: curves, delays, datums, and sensors that fall when the level rises."""

from typing import Any

import pytest

from hil.cli.doctor_command import expectations
from hil.doctor.examination import examine
from hil.probe.check_result import Result, Verdict
from tests.doctor.doctor_bench import LockstepBench
from tests.real_rig import EMULATOR, real_rig


def examined(wrong: dict[str, dict[str, Any]] | None = None, **truth: dict[str, Any]) -> dict[str, Result]:
    """Results by name, pumps moved. wrong : what the rig file says otherwise. truth : what is otherwise on the rig."""
    overlay = {table: {**keys, **truth.get(table, {})} for table, keys in EMULATOR.items()}
    bench = LockstepBench(overlay=overlay)
    try:
        with bench.probe() as probe:
            results = examine(probe, expectations(real_rig(**(wrong or {}))), 3.0, with_pumps=True)
        return {result.check: result for result in results}
    finally:
        bench.close()


def test_a_healthy_rig_passes_every_check() -> None:
    results = examined()
    assert {result.verdict for result in results.values()} == {Verdict.PASS}, results


def test_a_curve_that_the_rig_file_does_not_know_is_seen() -> None:
    """At 3 V the pumps give 0.9 times what straight ones would."""
    results = examined({"pumps": {"dead_zone_V": 0.0, "curve_1_V": 0.0}, "control": {"operating_point_V": [3.0, 3.0]}})
    assert "expected from rig.toml (8" in results["pump 1 to tank 1"].found


@pytest.mark.parametrize("tank", [1, 2])
def test_an_offset_in_an_empty_tank_is_a_wrong_zero(tank: int) -> None:
    """The zero of a falling sensor lies high: 9.4 V in place of 9.5 V look like 2 mm of water that do not fall."""
    offset_V = [9.5 - 0.1 * (tank == 1), 0.1 + 0.1 * (tank == 2), 1.0, 8.0]
    results = examined(sensors={"offset_V": offset_V}, tanks={"start_V": [0.0, 0.0], "hold_until_run": False})
    found = results[f"sensor {tank} range"]
    assert found.verdict is Verdict.WARN
    assert ("does not rise" if tank == 1 else "does not fall") in found.found
    assert "sensors.offset_V" in found.advice
    assert results[f"sensor {3 - tank} range"].verdict is Verdict.PASS
    assert results["sensor 4 noise"].verdict is Verdict.PASS  # an offset keeps the noise of an empty tank


def test_a_ramp_within_the_dead_zone_is_not_made() -> None:
    rig = {"pumps": {"dead_zone_V": [0.5, 3.5]}, "control": {"operating_point_V": [3.27, 6.3]}}
    results = examined(rig)
    assert results["pump 1 to tank 1"].verdict is Verdict.PASS
    assert results["pumps"].verdict is Verdict.NOT_CHECKED
    assert "dead_zone_V" in results["pumps"].found


def test_a_tank_whose_outlet_draws_the_water_out_at_once_is_not_judged() -> None:
    """The expected rise is nothing, and used to be divided by."""
    results = examined(tanks={"start_V": [0.0, 0.0], "hold_until_run": False})
    assert results["pump 1 to tank 1"].verdict is Verdict.NOT_CHECKED
