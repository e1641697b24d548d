import math

import pytest

from hil.core.diagnosis.glr.detection_bound import detection_bound_s, jumps_of_fault
from tests.glr.glr_bench import MODEL
from tests.narrowing import not_none


def bound(*faults: tuple[str, int, float | None], noise_V: float = 0.005) -> float | None:
    jumps: dict[int, float] = {}
    for kind, target, value in faults:
        jumps |= jumps_of_fault(kind, target, value, MODEL)
    return detection_bound_s(MODEL, 0.2, noise_V, jumps, (3.0, 3.0), 0.1, 0.02)


def test_larger_faults_are_found_sooner() -> None:
    bounds = [not_none(bound(("pump_effectiveness", 1, value))) for value in (0.4, 0.8, 0.9, 0.95)]
    assert bounds == sorted(bounds)
    assert bounds[0] < 0.3 < bounds[2] < 1.0


def test_two_pumps_are_found_sooner_than_one() -> None:
    both = bound(("pump_effectiveness", 1, 0.4), ("pump_effectiveness", 2, 0.4))
    assert both is not None
    assert both < min(not_none(bound(("pump_effectiveness", pump, 0.4))) for pump in (1, 2))


def test_a_bias_is_a_matter_of_readings() -> None:
    """A step of b in white noise s gathers b^2 / 2 s^2 a reading while the level stays where it is."""
    noise_V, bias_V = 0.02, 0.05
    wanted = math.log(864_000.0)
    readings = math.ceil(wanted / (0.5 * bias_V**2 / noise_V**2))
    assert bound(("sensor_bias", 3, bias_V), noise_V=noise_V) == pytest.approx(0.02 * readings, rel=0.2)


def test_what_is_no_jump_has_no_bound() -> None:
    assert bound(("sensor_stuck", 1, None)) is None
    assert bound(("leak", 1, 0.2), ("leak", 2, 0.2)) is None
    assert bound(("pump_effectiveness", 1, 0.9999)) is None
