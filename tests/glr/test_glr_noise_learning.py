import numpy as np
import numpy.typing as npt
import pytest

from hil.core.diagnosis.glr.filter import ENTRY, PERIOD, READING, WALK, WEIGHT, StepResult
from hil.core.diagnosis.glr.noise_learning import CANDIDATES, ProcessNoise, learn_process_noise
from tests.glr.glr_bench import DETECTOR, MODEL, NO_ESTIMATE, PERIOD_S, Plant

AREA_CM2 = np.array(MODEL.area_cm2)
GAIN, DT, W = 0.5, 0.1, 0.6
NOISE_V2 = 0.00224**2


class LevelFilter:
    """The Kalman filter of one level that wanders, read by the mean of five readings a period."""

    def __init__(self, walk: float) -> None:
        self.walk, self.x, self.P = walk * DT, 0.0, 1e-4

    def step(self, y: float) -> tuple[float, float, float]:
        """Innovation, its variance, gain."""
        q, seen = self.walk, GAIN * W * (1.0 + 2.0 * W) / 3.0 * GAIN
        S = GAIN * GAIN * self.P + seen * q + NOISE_V2
        K = (GAIN * self.P + GAIN * W * q) / S
        e = y - GAIN * self.x
        self.x += K * e
        self.P += q - K * K * S
        return e, S, K


def entry_of(walk: float) -> npt.NDArray[np.float64]:
    entry = np.zeros(ENTRY)
    entry[PERIOD], entry[WEIGHT] = DT, W
    entry[READING : READING + 4] = [0.0, np.nan, np.nan, np.nan]
    entry[WALK] = walk * DT
    return entry


@pytest.mark.parametrize("used", [0, 4, 8])
def test_a_candidate_expects_what_a_filter_with_its_walk_expects(used: int) -> None:
    """Also where the candidate's walk is smaller than the filter's, and the difference is a negative variance."""
    noise, result = ProcessNoise.begin(6.3e-4), StepResult.empty()
    own = LevelFilter(noise.candidate[used])
    others = [LevelFilter(walk) for walk in noise.candidate]
    random = np.random.default_rng(1)
    level, expected = 0.0, np.zeros(CANDIDATES)
    result.A[0, 0] = 1.0
    noise.evidence[0] = -1.0
    for number in range(300):
        level += 3e-3 * np.sqrt(DT) * random.normal()
        y = GAIN * level + np.sqrt(NOISE_V2) * random.normal()
        result.innovation[0], result.variance[0], result.K[0, 0] = own.step(y)
        before = noise.evidence[0].copy()
        learn_process_noise(GAIN, entry_of(own.walk / DT), result, noise, 1.0 + number, True)
        for m, other in enumerate(others):
            e, S, _ = other.step(y)
            expected[m] = -0.5 * (np.log(S) + min(e * e / S, 9.0))
        gained = noise.evidence[0] - before * (1.0 - DT / 200.0)
        inside = (noise.evidence[0] > -15.0) & (before > -15.0)
        assert gained[inside] - gained[inside][0] == pytest.approx(expected[inside] - expected[inside][0], abs=1e-6)


def learned(turbulence: float, seconds: int, seed: int = 3) -> tuple[npt.NDArray[np.float64], int]:
    """The walks on a rig with this turbulence, cm3/sqrt(s), after a time, in the same unit; the number of alarms."""
    plant = Plant(seed)
    plant.turbulence_cm3_sqrt_s = turbulence
    memory, alarms, walk = None, 0, (0.0, 0.0, 0.0, 0.0)
    for number in range(10 * seconds):
        memory, verdict = DETECTOR.step(memory, number * PERIOD_S, plant.period((3.0, 3.0)), NO_ESTIMATE, (3.0, 3.0))
        alarms, walk = alarms + len(verdict.new_alarms), verdict.level_walk_cm_sqrt_s
    return np.array(walk) * AREA_CM2, alarms


@pytest.mark.parametrize("turbulence", [0.1, 0.5])
def test_turbulence_is_learned_without_an_alarm(turbulence: float) -> None:
    """With a fixed walk, turbulence of 0.05 cm3/sqrt(s) raised 49 alarms an hour."""
    found, alarms = learned(turbulence, 60)
    assert alarms == 0
    assert found == pytest.approx(np.full(4, turbulence), rel=0.6)


def test_a_quiet_rig_is_seen_to_be_quiet() -> None:
    found, alarms = learned(0.0, 100)
    assert alarms == 0
    assert found.max() < 0.05


def test_the_walk_stays_within_its_bounds_and_rises_slowly() -> None:
    """Innovations of ten standard deviations are no process noise yet: the walk that is used follows within minutes."""
    noise, result = ProcessNoise.begin(6.3e-4), StepResult.empty()
    result.A[0, 0], result.K[0, 0], result.variance[0] = 1.0, 0.1, NOISE_V2
    noise.walk[0] = noise.candidate[0]
    for number in range(20_000):
        result.innovation[0] = (-1) ** (number // 7) * 10.0 * np.sqrt(NOISE_V2)
        learn_process_noise(GAIN, entry_of(noise.walk[0]), result, noise, 1e5, True)
        if number == 49:
            assert noise.walk[0] <= noise.candidate[0] * 1.35
    assert noise.candidate[0] < noise.walk[0] <= 3.0 * noise.candidate[-1]
