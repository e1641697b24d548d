"""Settling time and overshoot of outputs whose course is known."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hil.edge.record.manifest import Window
from hil.review.step_response import SETTLED_V, StepResponse, step_responses

Values = npt.NDArray[np.floating[Any]]

PERIOD_S = 0.1
TIMES_S: npt.NDArray[np.float64] = np.linspace(0.0, 59.9, 600)


def second_order(t_s: Values, damping: float, natural_1_s: float) -> Values:
    """Unit step response of an underdamped second-order system from t = 0 on."""
    since = np.maximum(t_s, 0.0)
    damped = natural_1_s * np.sqrt(1.0 - damping**2)
    decay = np.exp(-damping * natural_1_s * since)
    sine = damping / np.sqrt(1.0 - damping**2) * np.sin(damped * since)
    return np.asarray(1.0 - decay * (np.cos(damped * since) + sine))


def responses(
    output_1: Values, output_2: Values, reference_1: Values, window: Window
) -> tuple[StepResponse, StepResponse]:
    reference = np.column_stack([reference_1, np.zeros(len(TIMES_S))]).astype(np.float64)
    output = np.column_stack([output_1, output_2]).astype(np.float64)
    found = step_responses(TIMES_S, reference, output, window, PERIOD_S)
    assert found is not None
    return found


def is_unknown(output: Values, window: Window) -> bool:
    both = np.column_stack([output, output]).astype(np.float64)
    return step_responses(TIMES_S, 0.0 * both, both, window, PERIOD_S) is None


def test_the_overshoot_of_a_second_order_response_is_the_textbook_s() -> None:
    """exp(-pi z / sqrt(1 - z^2)) of the step, after pi / w_d; down as well as up."""
    damping, natural_1_s, step_V = 0.4, 0.8, 0.5
    wave = second_order(TIMES_S - 10.0, damping, natural_1_s)
    share = np.exp(-np.pi * damping / np.sqrt(1.0 - damping**2))
    for sign in (1.0, -1.0):
        found = responses(
            sign * step_V * wave, 0.0 * wave, np.where(TIMES_S < 9.95, 0.0, sign * step_V), Window("w", 10.0, 55.0)
        )
        one, two = found
        assert one.step_V == pytest.approx(sign * step_V)
        assert one.overshoot_V == pytest.approx(share * step_V, rel=0.01)
        assert one.overshoot_at_s == pytest.approx(
            10.0 + np.pi / (natural_1_s * np.sqrt(1.0 - damping**2)), abs=PERIOD_S
        )
        envelope_s = -np.log(SETTLED_V / step_V * np.sqrt(1.0 - damping**2)) / (damping * natural_1_s)
        assert 0.5 * envelope_s < one.settling_s <= envelope_s + PERIOD_S
        assert (two.settling_s, two.overshoot_V, two.overshoot_at_s) == (0.0, None, None)


def test_the_settling_counts_from_the_change_of_a_reference_wherever_the_window_begins() -> None:
    output = np.where(TIMES_S < 12.95, 0.0, 0.3)
    reference = np.where(TIMES_S < 9.95, 0.0, 0.3)
    for from_s in (2.0, 9.0, 10.0):
        one, two = responses(output, output - reference, reference, Window("w", from_s, 40.0))
        assert one.settling_s == pytest.approx(3.0)
        assert two.settling_s == pytest.approx(3.0), "it is disturbed by the other output's step"
        assert one.overshoot_V == 0.0


def test_without_a_change_it_counts_from_the_window_s_beginning() -> None:
    disturbed = np.where((TIMES_S > 20.05) & (TIMES_S < 24.95), -0.1, 0.0)
    one, _ = responses(disturbed, 0.0 * disturbed, 0.0 * disturbed, Window("w", 20.0, 50.0))
    assert (one.settling_s, one.peak_V) == pytest.approx((5.0, 0.1))
    assert one.overshoot_V is None


def test_an_output_outside_at_the_end_has_not_settled_and_a_short_record_has_no_figures() -> None:
    ramp = 0.01 * TIMES_S
    one, two = responses(ramp, 0.0 * ramp, 0.0 * ramp, Window("w", 10.0, 40.0))
    assert (one.settling_s, two.settling_s) == (None, 0.0)
    assert is_unknown(ramp, Window("w", 10.0, 61.0))
    assert is_unknown(ramp, Window("w", 70.0, 80.0))


def test_samples_that_are_not_known_are_left_out() -> None:
    """An unknown level counted as one within the band."""
    output = np.where(TIMES_S < 12.95, np.nan, 0.0)
    one, _ = responses(output, 0.0 * TIMES_S, 0.0 * TIMES_S, Window("w", 10.0, 40.0))
    assert one.settling_s == 0.0
    assert is_unknown(np.full(600, np.nan), Window("w", 10.0, 40.0))
