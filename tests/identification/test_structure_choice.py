"""What a fit without an extension begins from, and which extensions are given up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.core.identification.estimate import RigEstimate, estimate
from hil.core.identification.parameters import Choice, RigModel, with_values
from hil.core.identification.structure import as_in_file, evidence, hopeless, is_significant, reduced_values
from tests.identification.made_records import record_of, steps

TRUTH = with_values(RigModel(), {"k2": 3.6, "a3": 0.078, "delay2": 0.15})
START = RigModel()
FREE = Choice("free")


@pytest.fixture(scope="module")
def found() -> RigEstimate:
    """Pump 1 rests and tank 4 stays empty, which nobody says; the delay of pump 2 is true."""
    voltage_V = steps(3, 100.0, 0.1, low_V=1.5, high_V=4.5, hold_s=5.0)
    voltage_V[:, 0] = 0.0
    record = record_of(TRUTH, voltage_V, 0.1, (5.0, 6.0, 1.0, 0.0))
    return estimate([record], START, {"delay": FREE, "overflow": FREE})


def test_without_an_extension_the_level_of_an_empty_tank_stays(found: RigEstimate) -> None:
    """Linear theory made the tank full: the fit without a delay never came near, and a delay of 2 ms was kept."""
    reduced = reduced_values(found, START, "delay")
    assert reduced["h4 of made"] == pytest.approx(0.0, abs=0.05)
    assert (reduced["delay1"], reduced["delay2"]) == (0.0, 0.0)
    assert reduced["lag2"] > found["lag2"] + 0.1, "the lag takes over"
    assert reduced["k2"] == pytest.approx(3.6, rel=0.01)


def test_the_evidence_for_what_is_there_is_well_above_one(found: RigEstimate) -> None:
    assert evidence(found, START, "delay") > 5.0
    assert evidence(found, with_values(START, {"delay1": found["delay1"], "delay2": found["delay2"]}), "delay") == 0.0


def test_an_extension_is_significant_only_beyond_what_chance_explains(found: RigEstimate) -> None:
    """With waves and turbulence a dead zone of 2.5 mV, 1.2 standard deviations, was kept for the held-out record alone.

    One parameter of two has moved: chi-squared of 13.8 for two of them is 3.7 standard deviations.
    """
    assert is_significant(found, START, "delay")
    at = [found.names.index(name) for name in ("delay1", "delay2")]
    inverse = np.linalg.pinv(found.covariance[np.ix_(at, at)], hermitian=True)
    conditional_sd = float(inverse[1, 1]) ** -0.5
    for away_sd, is_expected in ((1.2, False), (3.6, False), (3.8, True)):
        delays = {"delay1": found["delay1"], "delay2": found["delay2"] - away_sd * conditional_sd}
        assert is_significant(found, with_values(START, delays), "delay") == is_expected


def test_what_the_records_do_not_determine_is_given_up(found: RigEstimate) -> None:
    """No tank has overflowed; and the pump that rests has no delay that anybody could know."""
    lost, is_judged = hopeless(found, ("delay", "overflow"))
    assert set(lost) == {"overflow3", "overflow4", "delay1"}
    assert not is_judged, "the gain of pump 1 is a basic parameter"
    file = with_values(START, {"delay1": 0.4})
    assert as_in_file(found.model, file, (), lost).pumps.delay_s == (0.4, found["delay2"])


def test_readings_that_are_wild_do_not_count_and_the_rest_does() -> None:
    record = record_of(TRUTH, steps(4, 60.0, 0.1, low_V=1.5, high_V=4.5, hold_s=5.0), 0.1, (5.0, 6.0, 1.0, 1.0))
    reading_V = record.reading_V.copy()
    reading_V[100, 0] = 9.0
    wild = replace(record, reading_V=reading_V)
    got = estimate([wild], TRUTH, near={})
    (usable,) = got.problem.usable(got.values, got.noise)
    assert not usable[100, 0]
    assert np.mean(usable) > 0.99
