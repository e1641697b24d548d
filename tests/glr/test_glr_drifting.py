"""On a rig that its file does not describe, the drift of a sensor is told from what the rig itself is."""

import numpy as np
import pytest

from hil.core.diagnosis.glr import drifting, first_day, verdict
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Drifting, Suspicion, Wide
from hil.core.diagnosis.glr.model import DRIFT, GAIN, LEAK, OUTLET
from hil.core.types import Measurement
from tests.glr.glr_bench import DETECTOR, Plant
from tests.glr.test_glr_first_day import CONFIG, a_memory, near_each_other, number_of


def with_drift(m: Memory, lead: float, sensor: int) -> Memory:
    """The memory with a filter that has room for drifts beside its wide one, and leads it since the step 295."""
    assert m.wide is not None
    m.wide.drifting = Drifting(x=m.wide.x.copy(), P=m.wide.P.copy())
    m.wide.drifting.x[DRIFT : DRIFT + 4] = 1e-4
    m.wide.drifting.x[DRIFT + sensor] = 2e-3
    m.wide.drifting.P[range(DRIFT, DRIFT + 4), range(DRIFT, DRIFT + 4)] = 1e-7
    m.wide.drifting.lead[295:] = [lead] * len(m.wide.drifting.lead[295:])
    return m


@pytest.mark.parametrize(
    ("own", "lead", "onset", "is_own"),
    [(12.0, 5.9, 290, True), (12.0, 6.1, 290, False), (12.0, 6.1, 296, True), (20.0, 9.9, 290, True)],
)
def test_what_a_drift_explains_and_the_rig_does_not_is_not_learned(
    own: float, lead: float, onset: int, *, is_own: bool
) -> None:
    """Three learnings in 15 s hid a drift of 2 mV/s, of which the relearning filter explained 0.4 to 0.7 each time."""
    m = a_memory(0.0, 0.6)
    m.is_wide = True
    assert m.wide is not None
    m.wide.lead[297:301] = [own] * 4
    with_drift(m, lead, 2)
    assert first_day.explains(CONFIG, m, onset, 30.0) is is_own


def in_question(m: Memory) -> Memory:
    """The memory with an open alarm since which a drift of sensor 3 has been in question, however much it leads now."""
    m.suspicion = Suspicion(number=1, detected_s=29.5)
    drifting.watch(with_drift(m, 9.0, 2), m.suspicion, 290)
    drifting.watch(with_drift(m, 1.0, 2), m.suspicion, 290)
    assert m.suspicion.drift == 2
    return m


@pytest.mark.parametrize(
    ("drifts_mV_s", "found"),
    [
        ((0.1, 0.1, 2.0, 0.1), 2),
        ((0.1, 0.1, -2.0, 0.1), 2),
        ((0.1, 0.1, 0.5, 0.1), None),
        ((-1.4, 0.1, 2.0, 0.1), None),
        ((-1.2, 0.1, 2.0, 0.1), 2),
    ],
)
def test_a_drift_is_one_of_one_sensor(drifts_mV_s: tuple[float, float, float, float], found: int | None) -> None:
    """Where several seem to drift, the model of the rig errs; each is known to 0.3 mV/s here."""
    m = with_drift(a_memory(0.0, 0.6), 9.0, 2)
    assert m.wide is not None
    assert m.wide.drifting is not None
    m.wide.drifting.x[DRIFT : DRIFT + 4] = 1e-3 * np.array(drifts_mV_s)
    assert drifting.sensor(m, 290) == found


@pytest.mark.parametrize(
    ("state", "size", "evidence", "is_open"),
    [
        (OUTLET + 2, -0.1, 37.9, True),
        (OUTLET + 2, -0.1, 38.1, False),
        (GAIN, -0.1, 37.9, True),
        (LEAK, 0.1, 37.9, True),
        (DRIFT + 1, 0.1, 37.9, False),
    ],
)
def test_a_fault_of_the_process_needs_a_greater_lead_before_such_a_drift(
    state: int, size: float, evidence: float, *, is_open: bool
) -> None:
    """After a step of the references an outlet led by 6.5, because it explained what the model erred by as well."""
    m = in_question(near_each_other((state, size, evidence), (DRIFT + 2, 0.002, 28.0)))
    assert drifting.may_be_drift(CONFIG, m, number_of(state)) is is_open
    m.replays.dropped[number_of(DRIFT + 2)] = 1
    assert not drifting.may_be_drift(CONFIG, m, number_of(state))


def test_what_may_be_the_rigs_own_is_not_learned_before_such_a_drift() -> None:
    m = near_each_other((OUTLET + 2, -0.05, 30.0), (DRIFT + 2, 0.002, 28.0))
    outlet = number_of(OUTLET + 2)
    assert verdict.own_instead(CONFIG, m, outlet, 0.0) == outlet
    assert verdict.own_instead(CONFIG, in_question(m), outlet, 0.0) is None


@pytest.mark.parametrize(("sensor", "rate_V_s"), [(0, 0.003), (1, -0.003), (2, 0.002), (3, -0.002), (None, 0.0)])
def test_a_drift_is_found_while_the_rig_is_learned_again(sensor: int | None, rate_V_s: float) -> None:
    """Among voltages that move, with a wide filter of 15 s and parameters that are up to 3 % off; without, none is."""
    plant = Plant(seed=5)
    m = Memory.begin(CONFIG, 0.0, Measurement((6.2, 6.4, 0.8, 0.7), (True,) * 4, 0.0, 5), (3.0, 3.0))
    m.is_wide = True
    for step in range(1, 1300):
        if step == 1200 and sensor is not None:
            plant.drift[sensor] = rate_V_s
        if step == 1050:
            m.wide = None
        pump_V = (3.0 + 1.5 * np.sign(np.sin(step / 40)), 3.0 + 1.5 * np.sign(np.cos(step / 55)))
        DETECTOR._note(m, 0.1 * step, plant.period(pump_V), pump_V)
        DETECTOR._filter(m)
    assert drifting.sensor(m, 1200) == sensor


def test_a_wide_filter_that_still_believes_the_file_has_none_beside_it() -> None:
    m = a_memory(0.0, 0.6)
    m.wide = None
    first_day.step(CONFIG, m, 0.0)
    assert isinstance(m.wide, Wide)
    assert m.wide.drifting is None
    assert drifting.sensor(m, 0) is None
