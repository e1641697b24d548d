"""The detection bound, and beside it a simulated likelihood-ratio test that knows kind, size and onset too."""

import math
from statistics import NormalDist

import numpy as np
import numpy.typing as npt
import pytest

from hil.bench.scenario_bound import delay_of_step
from hil.core.diagnosis.glr import kernels
from hil.core.diagnosis.glr.detection_bound import detection_bound_s, entry_of, jumps_of_fault, learned, wanted_stds
from hil.core.diagnosis.glr.filter import READING, StepResult
from hil.core.diagnosis.glr.hypotheses import JUMPS
from hil.core.diagnosis.glr.model import BIAS, LEVEL, MOVING, N
from tests.glr.glr_bench import MODEL
from tests.narrowing import not_none

HELD = ((150.0, (3.0, 3.0)),)
PERIOD_S, READING_S, NOISE_V = 0.1, 0.02, 0.005
STEPS_PER_FALSE_ALARM = 864_000.0

Fault = tuple[str, int, float | None]


def jumps_of(*faults: Fault) -> dict[int, float]:
    jumps: dict[int, float] = {}
    for kind, target, value in faults:
        jumps |= jumps_of_fault(kind, target, value, MODEL)
    return jumps


def bound(*faults: Fault, noise_V: float = NOISE_V) -> float | None:
    return detection_bound_s(MODEL, 0.2, noise_V, jumps_of(*faults), HELD, PERIOD_S, READING_S)


def test_larger_faults_are_found_sooner() -> None:
    bounds = [not_none(bound(("pump_effectiveness", 1, value))) for value in (0.4, 0.8, 0.9, 0.95)]
    assert bounds == sorted(bounds)
    assert bounds[0] < 0.3 < bounds[2] < 1.0


def test_two_pumps_are_found_sooner_than_one() -> None:
    both = bound(("pump_effectiveness", 1, 0.4), ("pump_effectiveness", 2, 0.4))
    assert both is not None
    assert both < min(not_none(bound(("pump_effectiveness", pump, 0.4))) for pump in (1, 2))


def test_a_bias_is_a_matter_of_readings() -> None:
    """A step of b in white noise s has the mean b, and the deviation s / sqrt(n), after n readings of a known level."""
    noise_V, bias_V = 0.02, 0.02
    readings = next(n for n in range(1, 100) if math.sqrt(n) * bias_V / noise_V >= wanted_stds(n * READING_S, PERIOD_S))
    assert bound(("sensor_bias", 3, bias_V), noise_V=noise_V) == pytest.approx(READING_S * readings, rel=0.2)


def test_the_false_alarms_of_all_steps_since_the_onset_count() -> None:
    assert wanted_stds(0.02, 0.1) == wanted_stds(0.1, 0.1)
    for steps in (1, 5, 50):
        share = 1.0 - NormalDist().cdf(wanted_stds(0.1 * steps, 0.1))
        assert share == pytest.approx(steps / STEPS_PER_FALSE_ALARM, rel=1e-6)


def test_the_rate_of_the_readings_makes_no_noise_of_the_process() -> None:
    """With a control period's process noise at every reading, frequent readings were no better than rare ones.

    Here the same information in more readings gives the same bound.
    """
    jumps = jumps_of(("outlet_block", 2, 0.1))
    rare = not_none(detection_bound_s(MODEL, 0.2, 0.005, jumps, HELD, 0.1, 0.02))
    often = not_none(detection_bound_s(MODEL, 0.2, 0.005 * math.sqrt(2.0), jumps, HELD, 0.1, 0.01))
    assert often == pytest.approx(rare, abs=0.021)


@pytest.mark.parametrize(("onset_s", "delay_s"), [(150.0, 0.1), (150.01, 0.09), (150.07, 0.03), (150.081, 0.019)])
def test_a_reading_soon_after_the_onset_counts(onset_s: float, delay_s: float) -> None:
    """One reading shows a bias of 0.5 V. For an onset 30 ms before a control step the bound once was the step after."""
    assert delay_of_step(onset_s, READING_S, READING_S, PERIOD_S) == pytest.approx(delay_s)


def test_what_is_no_jump_has_no_bound() -> None:
    assert bound(("sensor_stuck", 1, None)) is None
    assert bound(("leak", 1, 0.2), ("leak", 2, 0.2)) is None
    assert bound(("pump_effectiveness", 1, 0.99999)) is None


def ratios(jumps: dict[int, float], readings: int, runs: int) -> npt.NDArray[np.float64]:
    """Log-likelihood ratios after every reading, (runs, readings), of rigs that have the fault.

    Rigs are drawn from what a filter knows at the onset: levels, lags and parameters. Two filters read the same noisy
    readings of the nonlinear process; one knows the fault, one knows of none.
    """
    config, m = learned(MODEL, 0.2, NOISE_V, HELD, PERIOD_S, READING_S)
    random, entry, result = np.random.default_rng(1), entry_of((3.0, 3.0), NOISE_V**2, READING_S), StepResult.empty()
    values, vectors = np.linalg.eigh(m.P)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    jump = np.zeros(N)
    for j, size in jumps.items():
        jump[JUMPS[j].state] = size
    found = np.zeros((runs, readings))
    for run in range(runs):
        truth = m.x + root @ random.normal(size=N) + jump
        filters = [(m.x.copy(), m.P.copy()), (m.x + jump, m.P.copy())]
        total = 0.0
        for number in range(readings):
            kernels.predict(config.model, truth, np.zeros(2), entry[:2], READING_S, np.empty((MOVING, N)))
            noise_V = NOISE_V * random.normal(size=4)
            level_V = config.model.level_gain_V_cm * truth[LEVEL : LEVEL + 4]
            entry[READING : READING + 4] = level_V + truth[BIAS : BIAS + 4] + noise_V
            healthy, faulty = (kernels.filter_step(config.model, x, P, entry, result) for x, P in filters)
            total += faulty - healthy
            found[run, number] = total
    return found


def median_s(found: npt.NDArray[np.float64]) -> float:
    """When a test of these ratios has found the fault in half of the runs, at one false alarm a day of steps.

    It alarms at the first reading at which the ratio exceeds a constant threshold. The share of healthy rigs in which
    it has by then alarmed, too rare to count, is the mean of exp(-ratio) at the alarm over the rigs with the fault.
    """
    runs, readings = found.shape
    highest = np.maximum.accumulate(found, axis=1)
    for number in range(readings):
        threshold = float(np.median(highest[:, number]))
        has_alarm = highest[:, number] >= threshold
        first = np.argmax(found >= threshold, axis=1)
        false_alarms = float(np.exp(-found[np.arange(runs), first])[has_alarm].sum()) / runs
        since_s = (number + 1) * READING_S
        if false_alarms <= math.ceil(since_s / PERIOD_S - 1e-9) / STEPS_PER_FALSE_ALARM:
            return since_s
    raise AssertionError("too few readings")


CASES = [
    ((("pump_effectiveness", 1, 0.8),), 40),
    ((("pump_effectiveness", 2, 0.9),), 60),
    ((("pump_effectiveness", 1, 0.8), ("pump_effectiveness", 2, 0.8)), 40),
    ((("leak", 3, 0.2),), 50),
    ((("outlet_block", 2, 0.1),), 60),
    ((("sensor_drift", 1, 0.005),), 90),
]


@pytest.mark.long
@pytest.mark.parametrize(("faults", "readings"), CASES)
def test_an_optimal_test_is_within_a_tenth_of_the_bound(faults: tuple[Fault, ...], readings: int) -> None:
    """The bound once added a control period's process noise at every reading, and so was above what a test can do."""
    optimum_s = median_s(ratios(jumps_of(*faults), readings, 400))
    assert not_none(bound(*faults)) == pytest.approx(optimum_s, rel=0.1)
