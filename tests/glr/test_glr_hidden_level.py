"""The level behind a drift downwards that is not excluded: beside a declared fault, and while an alarm is open."""

from __future__ import annotations

from math import inf
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.core.diagnosis.glr import hidden_level
from hil.core.diagnosis.glr.hypotheses import BOTH, ROWS, drift_of, outlet_of
from hil.core.diagnosis.glr.memory_parts import Hidden
from hil.core.diagnosis.glr.model import DRIFT, LEVEL, N
from hil.core.diagnosis.glr.tuning import Tuning
from tests.glr.glr_bench import Fault, play, put

LIKELIHOOD = 3.0
NOTHING = (-inf, -inf)
DETECT = Tuning().detect


def config(likelihood: float = LIKELIHOOD) -> Any:
    """A detector's configuration whose filters beside the main one find every reading so likely."""
    return SimpleNamespace(tuning=Tuning(), filter_beside=lambda *_: likelihood)


def memory(**fields: Any) -> Any:
    """Replays in which the sensors of both lower tanks may drift downwards, tank 2's likelier; levels 12, 13 cm."""
    x = np.zeros((ROWS, N))
    evidence = np.full(ROWS, 30.0)
    for tank in (0, 1):
        x[drift_of(tank + 1), DRIFT + tank] = -0.01
        x[drift_of(tank + 1), LEVEL + tank] = 12.0 + tank
        evidence[drift_of(tank + 1)] = 15.0 + tank
    replays = SimpleNamespace(
        evidence=evidence,
        x=x,
        P=np.zeros((ROWS, N, N)),
        dropped=np.zeros(ROWS, dtype=np.int64),
        target=np.arange(ROWS),
    )
    known: dict[str, Any] = {
        "replays": replays,
        "suspicion": None,
        "hidden": None,
        "lost": {},
        "usable": [True] * 4,
        "entry": None,
        "is_wide": False,
    }
    return SimpleNamespace(**(known | fields))


def hidden(tank: int = 0, lead: float = 10.0, rate_V_s: float = -0.01, level_cm: float = 14.0) -> Hidden:
    x = np.zeros(N)
    x[DRIFT + tank], x[LEVEL + tank] = rate_V_s, level_cm
    return Hidden(tank=tank, x=x, P=np.zeros((N, N)), lead=lead, target=-1, limit=20.0)


@pytest.mark.parametrize(
    ("is_wide", "lead", "is_kept"), [(True, 59.0, True), (True, 61.0, False), (False, 59.0, False)]
)
def test_on_an_unknown_rig_a_drift_is_excluded_later_the_more_both_explain(
    lead: float, *, is_wide: bool, is_kept: bool
) -> None:
    """A leak led a drift of -50 mV/s by 11 of 20,800, and soon by 20: the interlock forgot the level it implied."""
    m, drift = memory(is_wide=is_wide, suspicion=SimpleNamespace(leader=outlet_of(2))), drift_of(2)
    m.replays.evidence[outlet_of(2)], m.replays.evidence[drift] = 20000.0, 20000.0 - lead
    found = hidden_level.begin(config(), m, outlet_of(2))
    assert (found is not None) is is_kept
    assert (hidden_level.levels_cm(config(), m)[1] > 0.0) is is_kept
    if found is not None:
        assert found.limit == pytest.approx(60.0)


@pytest.mark.parametrize("winner", [outlet_of(1), outlet_of(2), 0, BOTH])
def test_beside_a_declared_fault_the_likelier_drift_goes_on(winner: int) -> None:
    m = memory()
    found = hidden_level.begin(config(), m, winner)
    assert found is not None
    assert (found.tank, found.lead, found.target) == (1, 14.0, drift_of(2))
    assert found.x[LEVEL + 1] == 13.0
    assert found.x is not m.replays.x[drift_of(2)]
    assert not np.shares_memory(found.P, m.replays.P)


@pytest.mark.parametrize("winner", [drift_of(1), drift_of(4)])
def test_not_beside_a_declared_drift_whose_level_is_known(winner: int) -> None:
    assert hidden_level.begin(config(), memory(), winner) is None


def test_not_where_the_drift_is_excluded_or_rises_or_its_sensor_is_lost() -> None:
    m = memory()
    m.replays.dropped[drift_of(2)] = 1
    m.replays.x[drift_of(1), DRIFT] = 0.01
    assert hidden_level.begin(config(), m, outlet_of(1)) is None
    m = memory(usable=[True, False, True, True])
    found = hidden_level.begin(config(), m, outlet_of(1))
    assert found is not None
    assert found.tank == 0
    m.replays.evidence[drift_of(1)] = 30.0 - DETECT
    assert hidden_level.begin(config(), m, outlet_of(1)) is not None
    m.replays.evidence[drift_of(1)] -= 0.01
    assert hidden_level.begin(config(), m, outlet_of(1)) is None


def test_it_goes_on_until_the_readings_have_excluded_it() -> None:
    m = memory(hidden=hidden(lead=DETECT - 1.5))
    hidden_level.step(config(), m, LIKELIHOOD + 1.0)
    assert m.hidden.lead == DETECT - 0.5
    hidden_level.step(config(), m, LIKELIHOOD - 1.0)
    assert m.hidden.lead == DETECT - 1.5
    hidden_level.step(config(), m, LIKELIHOOD + 2.0)
    assert m.hidden is None
    hidden_level.step(config(), m, LIKELIHOOD)
    assert m.hidden is None


def test_it_ends_when_the_sensor_is_lost_or_the_drift_turns_round() -> None:
    m = memory(hidden=hidden(tank=1), lost={1: None})
    hidden_level.step(config(), m, LIKELIHOOD)
    assert m.hidden is None
    m = memory(hidden=hidden(rate_V_s=0.0))
    hidden_level.step(config(), m, LIKELIHOOD)
    assert m.hidden is None


def test_the_level_is_that_of_the_drift_s_filter_and_of_open_replays() -> None:
    m = memory()
    assert hidden_level.levels_cm(config(), m) == NOTHING
    m.suspicion = SimpleNamespace(leader=None)
    assert hidden_level.levels_cm(config(), m) == NOTHING
    m.suspicion.leader = outlet_of(1)
    assert hidden_level.levels_cm(config(), m) == (12.0, 13.0)
    m.replays.evidence[drift_of(1)] = 30.0 - DETECT - 0.01
    assert hidden_level.levels_cm(config(), m) == (-inf, 13.0)
    m.hidden = hidden(tank=1, level_cm=12.5)
    assert hidden_level.levels_cm(config(), m) == (-inf, 13.0)
    m.hidden = hidden(tank=0, level_cm=14.0)
    assert hidden_level.levels_cm(config(), m) == (14.0, 13.0)
    m.hidden.P[LEVEL, LEVEL], m.replays.P[drift_of(2), LEVEL + 1, LEVEL + 1] = 0.25, 4.0
    assert hidden_level.levels_cm(config(), m) == (15.0, 17.0), "two standard deviations higher than found"


def test_a_leak_has_such_a_level_for_some_seconds_only() -> None:
    leak: Fault = (10.0, put("leak", 0, 0.3))
    log = play(3, 60.0, (leak,), steps=())
    assert [(a.kind, a.target) for a in log.settled()] == [("leak", 1)]
    named_s = log.settled()[0].isolated_s
    assert named_s is not None
    levels = [(state.t_s, state.diagnosis.hidden_cm[0]) for state in log.states]
    assert max(level for t_s, level in levels if t_s < 10.0) == -inf
    assert 12.0 < max(level for _, level in levels) < 17.0
    assert all(level == -inf for t_s, level in levels if t_s > named_s + 35.0)
