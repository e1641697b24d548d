"""A rig that its file does not describe is learned, and no name is given to what is its own."""

import numpy as np
import pytest

from hil.core.diagnosis.glr import first_day
from hil.core.diagnosis.glr.filter import VOLTAGE
from hil.core.diagnosis.glr.memory import Memory, Wide
from hil.core.diagnosis.glr.model import SCALE, N
from hil.core.types import Measurement
from tests.glr.glr_bench import DETECTOR

CONFIG = DETECTOR.config


def a_memory(lead: float, moved_V: float) -> Memory:
    """Half a minute into a run, with a wide filter that leads by so much since the onset of the likeliest fault."""
    reading = Measurement((6.2, 6.4, 0.8, 0.7), (True,) * 4, 0.0, 5)
    m = Memory.begin(CONFIG, 0.0, reading, (3.0, 3.0))
    m.t_s, m.now = 30.0, 300
    m.history.entries[:, VOLTAGE : VOLTAGE + 2] = 3.0
    m.history.entries[295, VOLTAGE + 1] = 3.0 + moved_V
    m.wide = Wide(x=m.x + 0.1, P=2.0 * m.P, began=0)
    m.wide.lead[300] = lead
    return m


@pytest.mark.parametrize(("lead", "moved_V", "is_own"), [(10.5, 0.6, True), (9.5, 0.6, False), (10.5, 0.4, False)])
def test_the_wide_filter_takes_over_where_it_leads_and_a_voltage_has_moved(
    lead: float, moved_V: float, *, is_own: bool
) -> None:
    """What grows while the voltages rest is a fault, however well a wider filter can follow it."""
    m = a_memory(lead, moved_V)
    before = m.x.copy()
    assert first_day.explains(CONFIG, m, 290, 20.0) is is_own
    assert m.is_wide is is_own
    assert m.x == pytest.approx(before + (0.1 if is_own else 0.0))


def test_a_part_of_what_was_learned_is_forgotten_and_the_prior_is_kept() -> None:
    prior = np.zeros(N)
    prior[SCALE] = 0.2
    P = np.zeros((N, N))
    P[SCALE, SCALE] = 1.0 / (1.0 / 0.2**2 + 900.0)
    first_day._forget_share(P, 0.3, prior)
    assert P[SCALE, SCALE] == pytest.approx(1.0 / (1.0 / 0.2**2 + 270.0))
