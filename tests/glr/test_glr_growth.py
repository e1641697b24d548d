"""Faults that grow: named as what they are, followed under one number, never called a drift or a lost sensor."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from hil.core.diagnosis.glr import onsets
from hil.core.diagnosis.glr.growth import BOTH_GAINS, NO_GROWTH, covers, grow
from hil.core.diagnosis.glr.hypotheses import PUMPS, drift_of
from hil.core.diagnosis.glr.model import BIAS, DRIFT, GAIN, OUTLET, RATE, N
from hil.core.types import UNRESOLVED
from tests.glr.glr_bench import PERIOD_S, Fault, Plant, play, put
from tests.glr.test_glr_tuning import a_memory
from tests.narrowing import not_none

AT_S, STEP_S = 20.0, 0.5


def growing(begin: Callable[[float], Callable[[Plant], None]], rate_1_s: float, to: float) -> tuple[Fault, ...]:
    """A fault of size 0 at AT_S that grows at this rate, in small steps, to a size."""
    steps = round(to / rate_1_s / STEP_S)
    return tuple((AT_S + STEP_S * n, begin(rate_1_s * STEP_S * (n + 1))) for n in range(steps))


def fading(pump: int) -> Callable[[float], Callable[[Plant], None]]:
    return lambda size: put("effectiveness", pump, 1.0 - size)


@pytest.mark.parametrize(
    ("name", "begin", "seed"),
    [
        ("leak 1", lambda size: put("leak", 0, size), 82),
        pytest.param("pump_effectiveness 1", fading(0), 81, marks=pytest.mark.long),
        pytest.param("outlet_block 2", lambda size: put("block", 1, size), 83, marks=pytest.mark.long),
        pytest.param("leak 2", lambda size: put("leak", 1, size), 84, marks=pytest.mark.long),
        pytest.param("outlet_block 1", lambda size: put("block", 0, size), 85, marks=pytest.mark.long),
        pytest.param("pump_effectiveness 2", fading(1), 86, marks=pytest.mark.long),
        pytest.param("leak 4", lambda size: put("leak", 3, size), 87, marks=pytest.mark.long),
    ],
)
def test_a_fault_that_grows_is_one_alarm_whose_size_follows(
    name: str, begin: Callable[[float], Callable[[Plant], None]], seed: int
) -> None:
    """A growing leak or blockage was called a drift of the healthy sensor; a fading pump took 26 alarms, or a trip."""
    size = 0.12
    log = play(seed, AT_S + 50.0, growing(begin, 0.003, size))
    assert {f"{alarm.kind} {alarm.target}" for alarm in log.alarms if alarm.kind != UNRESOLVED} == {name}
    assert len({alarm.number for alarm in log.alarms}) == 1
    last = log.alarms[-1]
    assert last.size == pytest.approx(1.0 - size if "pump" in name else size, abs=0.025)
    assert len(log.alarms) >= 4, "it is reported again as it grows"
    assert all(state.diagnosis.trusted == (True,) * 4 for state in log.states)
    sized = [alarm for alarm in log.settled() if not np.isnan(alarm.size)]
    assert all(not_none(b.isolated_s) > not_none(a.isolated_s) for a, b in pairwise(sized))


@pytest.mark.parametrize(
    ("name", "begin"),
    [
        ("outlet_block 3", lambda size: put("block", 2, size)),
        pytest.param("pump_effectiveness 1", fading(0), marks=pytest.mark.long),
        pytest.param("valve_split 1", lambda size: put("split", 0, 0.7 - size), marks=pytest.mark.long),
    ],
)
def test_a_fault_that_grows_fast_is_updated_under_one_number(
    name: str, begin: Callable[[float], Callable[[Plant], None]]
) -> None:
    """Found as one jump after the other, it made three to six alarms of one fault."""
    log = play(93, AT_S + 15.0, growing(begin, 0.02, 0.2))
    assert {f"{alarm.kind} {alarm.target}" for alarm in log.settled()} == {name}
    assert {alarm.number for alarm in log.alarms} == {1}


def test_a_fault_that_is_found_much_larger_later_is_a_new_alarm() -> None:
    jumps = ((AT_S, put("effectiveness", 0, 0.8)), (AT_S + 25.0, put("effectiveness", 0, 0.4)))
    log = play(94, AT_S + 30.0, jumps)
    assert [(alarm.kind, alarm.number) for alarm in log.settled()] == [
        ("pump_effectiveness", number) for number in (1, 2)
    ]


@pytest.mark.parametrize("seed", [90, pytest.param(91, marks=pytest.mark.long)])
def test_a_pump_that_fades_while_its_voltage_rises_is_not_stuck(seed: int) -> None:
    """A reference step after the verdict: the flow stayed constant by chance, and the run tripped on a stuck pump."""
    log = play(seed, AT_S + 25.0, growing(fading(0), 0.02, 0.5), ((5.0, 0.3), (AT_S + 4.0, 0.3)))
    assert not any(any(state.diagnosis.stuck_on) for state in log.states)
    assert {(alarm.kind, alarm.target) for alarm in log.settled()} == {("pump_effectiveness", 1)}


@pytest.mark.long
def test_an_outlet_that_clogs_slowly_at_rest_is_not_called_a_drift() -> None:
    """The replay of growth kept the onset that the bank had given it, and trailed the drift by more than the margin."""
    log = play(92, AT_S + 300.0, growing(lambda size: put("block", 1, size), 0.0002, 0.06), ())
    assert {(alarm.kind, alarm.target) for alarm in log.settled()} <= {("outlet_block", 2)}
    assert any("outlet_block 2" in alarm.candidates for alarm in log.alarms)


def test_a_drift_of_a_lower_sensor_stays_a_drift() -> None:
    log = play(88, AT_S + 40.0, ((AT_S, put("drift", 0, 0.02)),))
    assert [(alarm.kind, alarm.target) for alarm in log.settled()] == [("sensor_drift", 1)]


def test_a_lag_far_longer_than_the_files_is_told_as_a_lag() -> None:
    """The filter began at the file's lag, found a quarter of it, and the rest was a pump that was tripped as stuck."""
    log = play(89, AT_S + 25.0, ((AT_S, put("lag_s", 0, 5.0)),), ((5.0, 0.3), (AT_S + 5.0, -0.5)))
    assert {(alarm.kind, alarm.target, alarm.number) for alarm in log.settled()} == {("pump_lag", 1, 1)}
    first, last = log.settled()[0], log.settled()[-1]
    assert 1.0 < first.size < 10.0, "the filter learns it better from the next movements"
    assert abs(last.size - 5.0) < abs(first.size - 5.0), "and says so under the same number"
    assert not any(any(state.diagnosis.stuck_on) for state in log.states)


def test_the_rate_moves_its_parameter_and_nothing_else() -> None:
    x, P = np.zeros(N), np.diag(np.full(N, 1e-4))
    x[RATE], P[RATE, RATE] = 0.01, 4e-6
    before = x.copy()
    grow(x, P, OUTLET, 0.1)
    assert x[OUTLET] == pytest.approx(0.001)
    assert np.delete(x, OUTLET) == pytest.approx(np.delete(before, OUTLET))
    assert P[OUTLET, RATE] == P[RATE, OUTLET] == pytest.approx(4e-7)
    assert P[OUTLET, OUTLET] == pytest.approx(1e-4 + 4e-8)
    grow(x, P, BOTH_GAINS, 0.1)
    assert x[GAIN] == x[GAIN + 1] == pytest.approx(0.001)
    kept = x.copy()
    grow(x, P, NO_GROWTH, 0.1)
    assert (x == kept).all()
    assert all(covers(BOTH_GAINS, pump) for pump in PUMPS)
    assert not any(covers(NO_GROWTH, pump) for pump in PUMPS)


def test_a_drift_begins_at_an_unknown_moment_of_its_period() -> None:
    """A drift of 0.1 V/s was some mV off what its replay could have, and was called a leak: the tank spilled."""
    memory, number = a_memory(), drift_of(1)
    slot = onsets.slots_in_use(memory)[0]
    memory.bank.energy[number, slot], memory.bank.match[number, slot] = 1.0, -0.1
    onsets.begin(memory, memory.replays, number, number, -1, slot)
    added = memory.replays.P[number] - memory.history.P[slot]
    assert np.sqrt(added[BIAS, BIAS]) == pytest.approx(0.3 * 0.1 * PERIOD_S)
    assert np.flatnonzero(np.diag(added)).tolist() == [BIAS, DRIFT]
