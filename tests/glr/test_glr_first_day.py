"""A rig that its file does not describe is learned, and no name is given to what is its own."""

import numpy as np
import pytest

from hil.core.diagnosis.glr import declaration, first_day, isolation, kernels, own_verdict, wide_filter
from hil.core.diagnosis.glr.filter import PERIOD, READING, VARIANCE, VOLTAGE, WEIGHT, StepResult
from hil.core.diagnosis.glr.hypotheses import BOTH, JUMPS, jumps_of
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.memory_parts import Declared, Lost, Suspicion, Wide
from hil.core.diagnosis.glr.model import BIAS, GAIN, LAG, LEAK, OUTLET, PUMP, SCALE, ZONE, N
from hil.core.types import Measurement
from tests.glr.glr_bench import DETECTOR

CONFIG = DETECTOR.config


def a_memory(lead: float, moved_V: float) -> Memory:
    """Half a minute into a run, with a wide filter that leads by so much since the onset of the likeliest fault."""
    reading = Measurement((6.2, 6.4, 0.8, 0.7), (True,) * 4, 0.0, 5)
    m = Memory.begin(CONFIG, 0.0, reading, (3.0, 3.0))
    m.t_s, m.now = 30.0, 300
    m.history.entries[:, VOLTAGE : VOLTAGE + 2] = 3.0
    m.history.entries[:, PERIOD] = 0.1
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


@pytest.mark.parametrize(("lead", "is_wide", "is_own"), [(8.0, True, True), (6.0, True, False), (8.0, False, False)])
def test_a_rig_that_is_proven_to_be_another_one_needs_less_of_an_explanation(
    lead: float, *, is_wide: bool, is_own: bool
) -> None:
    """A pump with 1.17 of its gain at the first large step: the filter beside had 0.47 of its evidence."""
    m = a_memory(lead, 0.6)
    m.is_wide = is_wide
    assert first_day.explains(CONFIG, m, 290, 20.0) is is_own


@pytest.mark.parametrize(("step", "is_wide", "is_own"), [(245, True, True), (235, True, False), (275, False, False)])
def test_a_step_of_the_voltages_counts_for_some_seconds(step: int, *, is_wide: bool, is_own: bool) -> None:
    """Four seconds after a step down, with both pumps at rest and the levels falling, a question was asked."""
    m = a_memory(14.0, 0.0)
    m.is_wide = is_wide
    m.history.entries[:step, VOLTAGE] = 4.0
    assert first_day.explains(CONFIG, m, 290, 20.0) is is_own


@pytest.mark.parametrize(("voltage_V", "std_V"), [(0.1, 0.05), (0.3, 0.05), (0.7, 0.02), (3.0, 0.02)])
def test_the_dead_zone_of_a_pump_near_its_end_is_never_known_exactly(voltage_V: float, std_V: float) -> None:
    """One of 0.41 V was known as 0.12 V, to 0.03 V: then a lag of 0.5 s. Above, a drift would hide in it."""
    m = a_memory(0.0, 0.0)
    m.x[ZONE] = 0.15
    m.P[ZONE, ZONE] = 0.02**2
    m.entry[:] = 0.0
    m.entry[VOLTAGE], m.entry[PERIOD], m.entry[WEIGHT] = voltage_V, 0.1, 1.0
    m.entry[READING : READING + 4], m.entry[VARIANCE : VARIANCE + 4] = np.nan, 1.0
    wide_filter.step(CONFIG, m.x, m.P, m.entry, StepResult.empty())
    assert np.sqrt(m.P[ZONE, ZONE]) == pytest.approx(std_V, rel=0.01)


@pytest.mark.parametrize(("kalman", "lag"), [(1.0, 1.3), (-1.0, np.exp(-0.3)), (-5.0, np.exp(-1.5))])
def test_a_lag_can_be_learned_to_be_short_and_never_to_be_nothing(
    kalman: float, lag: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 0.18 s, 0.02 s were left after the first tenths of a second of a step: then nothing is left to follow."""
    m = a_memory(0.0, 0.0)
    m.x[PUMP], m.entry[VOLTAGE] = 1.0, 3.0

    def corrected(_model: object, x: np.ndarray, *_: object) -> float:
        x[LAG] += 0.3 * kalman
        return 0.0

    monkeypatch.setattr(kernels, "filter_step", corrected)
    wide_filter.step(CONFIG, m.x, m.P, m.entry, StepResult.empty())
    assert m.x[LAG] == pytest.approx(lag)


@pytest.mark.parametrize(
    ("lead", "step", "t_s", "is_own"),
    [(15.5, 245, 30.0, True), (14.5, 245, 30.0, False), (15.5, 235, 30.0, False), (15.5, 245, 301.0, False)],
)
def test_at_first_a_lag_that_the_file_does_not_have_may_show_for_some_seconds(
    lead: float, step: int, t_s: float, *, is_own: bool
) -> None:
    """Three times the file's lag: a pump was asked about 3 s after a step to 0 V, although all was expected."""
    m = a_memory(lead, 0.0)
    m.t_s = t_s
    m.history.entries[:step, VOLTAGE] = 4.0
    assert first_day.explains(CONFIG, m, 290, 20.0) is is_own


@pytest.mark.parametrize(
    ("lead", "step", "t_s", "is_own"),
    [(-0.5, 105, 30.0, True), (-1.5, 105, 30.0, False), (-0.5, 95, 30.0, False), (-0.5, 105, 301.0, False)],
)
def test_at_first_what_the_wide_filter_gains_since_a_step_counts_even_if_the_fault_seems_older(
    lead: float, step: int, t_s: float, *, is_own: bool
) -> None:
    """A rig had rested for 90 s, in which room for so much cost the wide filter 16; then a leak since the start led."""
    m = a_memory(lead, 0.0)
    assert m.wide is not None
    m.t_s, m.wide.lead[1:150] = t_s, [-5.0] * 149
    m.wide.lead[150:300] = [-16.0] * 150
    m.history.entries[:step, VOLTAGE] = 4.0
    assert first_day.explains(CONFIG, m, 0, 20.0) is is_own


def test_a_part_of_what_was_learned_is_forgotten_and_the_prior_is_kept() -> None:
    prior = np.zeros(N)
    prior[SCALE] = 0.2
    P = np.zeros((N, N))
    P[SCALE, SCALE] = 1.0 / (1.0 / 0.2**2 + 900.0)
    first_day._forget_share(P, 0.3, prior)
    assert P[SCALE, SCALE] == pytest.approx(1.0 / (1.0 / 0.2**2 + 270.0))


@pytest.mark.parametrize(
    ("t_s", "driven_V", "is_wide", "is_own"),
    [
        (290.0, (5.1, 5.1), False, True),
        (310.0, (5.1, 5.1), False, False),
        (310.0, (5.1, 4.9), False, True),
        (310.0, (5.1, 5.1), True, True),
    ],
)
def test_a_rig_that_has_shown_to_be_as_its_file_says_is_not_another_one_later(
    t_s: float, driven_V: tuple[float, float], *, is_wide: bool, is_own: bool
) -> None:
    """A pump that stood still when it lost a quarter of its gain was learned without a word (known rig 70302)."""
    m = a_memory(15.0, 0.6)
    for voltages in ((3.0, 3.0), driven_V):
        m.applied_V = voltages
        first_day.step(CONFIG, m, 0.0)
    assert m.wide is not None
    m.wide.lead[300], m.t_s, m.is_wide = 15.0, t_s, is_wide
    assert first_day.explains(CONFIG, m, 290, 20.0) is is_own


def number_of(state: int) -> int:
    return next(number for number, jump in enumerate(JUMPS) if jump.state == state)


def a_verdict(state: int, now: float, *, onset: int = 290, moved_V: float = 0.6, is_wide: bool = False) -> Memory:
    """A memory in which the hypothesis of a state's jump says that the state is now this."""
    m = a_memory(0.0, moved_V)
    m.is_wide = is_wide
    m.times_s = [0.1 * step for step in range(len(m.times_s))]
    number = number_of(state)
    m.replays.before[number] = m.x
    m.replays.x[number] = m.x
    m.replays.x[number, state] = now
    m.replays.onset[number] = onset
    return m


@pytest.mark.parametrize(("lag", "is_own"), [(0.3, True), (1.4, True), (1.6, False)])
def test_a_lag_that_the_file_allows_is_no_fault(lag: float, *, is_own: bool) -> None:
    """A lag of 0.24 s was reported as a fault where the file has 0.2 s: the estimate before had been too small."""
    assert own_verdict.is_own(CONFIG, a_verdict(LAG, lag), number_of(LAG)) is is_own


@pytest.mark.parametrize(
    ("state", "now", "onset", "is_own"),
    [
        (GAIN, 0.7, 5, True),
        (GAIN, 0.55, 5, False),
        (GAIN, 0.7, 30, False),
        (LAG, 3.5, 5, True),
        (OUTLET, 0.8, 5, False),
    ],
)
def test_a_pump_that_always_was_so_is_no_fault(state: int, now: float, onset: int, *, is_own: bool) -> None:
    """Weak pumps were named 45 s after a start from empty tanks, and dead zone and curve were never learned then."""
    assert own_verdict.is_own(CONFIG, a_verdict(state, now, onset=onset), number_of(state)) is is_own


@pytest.mark.parametrize(
    ("size", "moved_V", "is_wide", "is_own"),
    [(0.08, 0.6, True, True), (0.12, 0.6, True, False), (0.08, 0.4, True, False), (0.08, 0.6, False, False)],
)
def test_a_small_jump_on_an_unknown_rig_is_learned(size: float, moved_V: float, *, is_wide: bool, is_own: bool) -> None:
    m = a_verdict(OUTLET, 1.0 + size, moved_V=moved_V, is_wide=is_wide)
    assert own_verdict.is_own(CONFIG, m, number_of(OUTLET)) is is_own
    m = a_verdict(BIAS, size, moved_V=moved_V, is_wide=is_wide)
    assert not own_verdict.is_own(CONFIG, m, number_of(BIAS)), "sensors are always reported"


@pytest.mark.parametrize(
    ("state", "size", "is_wide", "is_own"),
    [(GAIN, -0.5, True, False), (GAIN, -0.1, True, True), (GAIN, -0.1, False, False), (LAG, 3.0, True, True)],
)
def test_what_follows_a_fault_is_reported(state: int, size: float, *, is_wide: bool, is_own: bool) -> None:
    """A lag, or a tenth of a pump, that was named once used to end the learning of an unknown rig: more followed."""
    m = a_verdict(OUTLET, 1.08, is_wide=is_wide)
    m.declared[number_of(state)] = Declared("pump_effectiveness", size, 1.0, 1, 20.0, 20.0)
    assert own_verdict.is_own(CONFIG, m, number_of(OUTLET)) is is_own


@pytest.mark.parametrize(
    ("size", "declared_s", "is_learned"),
    [(-0.25, 200.0, True), (-0.35, 200.0, False), (-0.25, 320.0, False), (-0.1, 320.0, True)],
)
def test_a_pump_may_differ_by_as_much_as_pumps_do_while_a_rig_shows_what_it_is(
    size: float, declared_s: float, *, is_learned: bool
) -> None:
    """A pump with 0.84 of its gain at 4 V and all of it at 10 V was a fault at 37 s: ten wrong names followed."""
    m = a_memory(0.0, 0.6)
    m.declared[number_of(GAIN)] = Declared("pump_effectiveness", size, 1.0, 1, declared_s, declared_s)
    assert own_verdict.is_learned_on(m) is is_learned


@pytest.mark.parametrize(
    ("kind", "is_wide", "is_learned"),
    [
        ("sensor_stuck", True, True),
        ("sensor_open", True, True),
        ("sensor_drift", True, False),
        ("sensor_stuck", False, False),
    ],
)
def test_a_sensor_whose_own_readings_show_that_it_failed_does_not_end_the_learning(
    kind: str, *, is_wide: bool, is_learned: bool
) -> None:
    """A large step 90 s after a stuck sensor was a question for 3 s, and the run tripped: a level was not known."""
    m = a_memory(0.0, 0.6)
    m.is_wide = is_wide
    m.lost[1] = Lost(kind, 1, 20.0)
    assert own_verdict.is_learned_on(m) is is_learned


@pytest.mark.parametrize(
    ("open_s", "quiet_s", "is_quiet", "is_blind"),
    [
        (2.9, 0.0, False, False),
        (3.1, 0.0, False, True),
        (5.4, 0.0, True, False),
        (5.6, 0.0, True, True),
        (1.0, 1.9, False, False),
        (1.0, 2.1, False, True),
    ],
)
def test_without_a_lower_sensor_what_may_be_the_rigs_own_has_time_for_its_verdict(
    open_s: float, quiet_s: float, *, is_quiet: bool, is_blind: bool
) -> None:
    """The verdict that it is the rig's own comes after 5 s at the latest, and a run would trip after 3 s."""
    m = a_memory(0.0, 0.6)
    m.lost[1] = Lost("sensor_stuck", 1, 20.0)
    number = None if is_quiet else 2
    m.suspicion = Suspicion(number=number, detected_s=m.t_s - open_s, is_quiet=is_quiet, quiet_s=quiet_s)
    assert declaration.is_blind(m) is is_blind


@pytest.mark.parametrize(
    ("before", "now", "is_wide", "is_own"),
    [
        (0.0, 0.03, True, True),
        (0.0, 0.05, True, False),
        (0.06, 0.07, True, True),
        (0.07, 0.09, True, False),
        (0.0, 0.03, False, False),
    ],
)
def test_a_small_leak_of_an_upper_tank_is_learned(before: float, now: float, *, is_wide: bool, is_own: bool) -> None:
    """A leak of 0.7 % of tank 3 was named on a rig with other sensors and outlets than its file has."""
    m = a_verdict(LEAK, now, is_wide=is_wide)
    m.replays.before[number_of(LEAK), LEAK] = before
    assert own_verdict.is_own(CONFIG, m, number_of(LEAK)) is is_own


@pytest.mark.parametrize(
    ("voltage_V", "std_V", "is_learned"),
    [(3.05, 0.0, False), (4.0, 0.0, True), (3.05, 0.03, False), (3.05, 0.07, True)],
)
def test_the_lag_of_a_pump_whose_voltage_stands_still_is_not_learned(
    voltage_V: float, std_V: float, *, is_learned: bool
) -> None:
    """In the ramp of a start phase a lag went to a twentieth of the file's; the end of the ramp was a pump with 1.3.

    After a step it shows as long as what has not arrived yet may be as much (std_V): with half of the true lag, the
    estimate said so too soon, and the rest of the step was an open question.
    """
    m = a_memory(0.0, 0.0)
    m.P[PUMP, PUMP] = std_V**2
    m.P[LAG, LAG] = 1.5**2
    m.P[LAG, SCALE] = m.P[SCALE, LAG] = 0.9 * 1.5 * np.sqrt(m.P[SCALE, SCALE])
    entry, before = m.entry, m.x.copy()
    entry[VOLTAGE], entry[WEIGHT], entry[VARIANCE : VARIANCE + 4] = voltage_V, 1.0, 5e-6
    entry[READING : READING + 4] = np.array((6.2, 6.4, 0.8, 0.7)) + 0.02
    result = StepResult.empty()
    wide_filter.step(CONFIG, m.x, m.P, entry, result)
    assert bool(m.x[LAG] != before[LAG]) is is_learned
    assert bool(result.K[LAG].any()) is is_learned
    assert m.x[SCALE] != before[SCALE]
    assert np.linalg.eigvalsh(m.P).min() > -1e-9


@pytest.mark.parametrize(
    ("leader", "behind", "size", "is_learned"),
    [(GAIN, 4.0, -2.0, True), (GAIN, 6.0, -2.0, False), (GAIN, 4.0, 2.0, False), (BIAS, 4.0, -2.0, False)],
)
def test_a_quicker_pump_is_likelier_than_another_gain(
    leader: int, behind: float, size: float, *, is_learned: bool
) -> None:
    """A lag that was learned too long was a pump with 1.36 of its gain at the first large step. No fault is shorter."""
    m = a_verdict(LAG, 4.0 + size, is_wide=True)
    m.t_s = 400.0  # before, a longer one is chosen, and reported
    lag = number_of(LAG)
    m.replays.before[lag, LAG] = 4.0
    m.replays.dropped[:] = 1
    m.replays.dropped[[lag, number_of(leader)]] = 0
    m.replays.evidence[number_of(leader)], m.replays.evidence[lag] = 20.0, 20.0 - behind
    m.replays.x[number_of(leader)] = m.x
    m.replays.x[number_of(leader), leader] = 1.4
    m.replays.before[number_of(leader)] = m.x
    m.replays.onset[number_of(leader)] = 290
    assert (own_verdict.own_instead(CONFIG, m, number_of(leader)) == lag) is is_learned


@pytest.mark.parametrize(
    ("state", "moved_V", "is_wide", "is_quiet"),
    [(GAIN, 0.6, True, True), (GAIN, 0.4, True, False), (GAIN, 0.6, False, False), (BIAS, 0.6, True, False)],
)
def test_what_may_be_the_rigs_own_is_not_announced_at_once(
    state: int, moved_V: float, *, is_wide: bool, is_quiet: bool
) -> None:
    """Questions that were withdrawn after a quarter of a second were two thirds of the false alarms of unknown rigs."""
    m = a_memory(0.0, moved_V)
    m.is_wide = is_wide
    m.best.ratio[:], m.max_ratio = 0.0, 21.0
    m.best.ratio[number_of(state)], m.best.slot[:] = 21.0, 0
    m.bank.onset[0] = 290
    assert own_verdict.may_be_own(CONFIG, m) is is_quiet


@pytest.mark.parametrize(("behind", "is_quiet"), [(4.0, True), (6.0, False)])
def test_a_sensor_that_hardly_leads_does_not_make_a_question_at_once(behind: float, *, is_quiet: bool) -> None:
    """A bias led a pump by 4.6 in the bank; three steps later the filter from 3.5 s before explained all of it."""
    m = a_memory(0.0, 0.6)
    m.is_wide = True
    m.best.ratio[:], m.max_ratio = 0.0, 21.0
    m.best.ratio[number_of(BIAS)], m.best.ratio[number_of(GAIN)], m.best.slot[:] = 21.0, 21.0 - behind, 0
    m.bank.onset[0] = 290
    assert own_verdict.may_be_own(CONFIG, m) is is_quiet


def near_each_other(*found: tuple[int, float, float]) -> Memory:
    """An unknown rig on which these states may have changed by so much, with this evidence."""
    m = a_memory(0.0, 0.6)
    m.is_wide = True
    m.times_s = [0.1 * step for step in range(len(m.times_s))]
    m.replays.before[:], m.replays.x[:], m.replays.onset[:], m.replays.dropped[:] = m.x, m.x, 290, 1
    m.replays.evidence[:] = 0.0
    for state, size, evidence in found:
        number = number_of(state)
        m.replays.dropped[number], m.replays.evidence[number] = 0, evidence
        m.replays.x[number, state] += size
    return m


@pytest.mark.parametrize(
    ("found", "leads"),
    [
        (((GAIN, -0.01, 28.0), (OUTLET, -0.01, 29.0), (GAIN + 1, -0.4, 20.0)), OUTLET),
        (((GAIN, -0.01, 28.0), (OUTLET, -0.01, 29.0), (GAIN + 1, -0.4, 25.0)), None),
        (((OUTLET, -0.01, 29.0), (BIAS, 0.1, 25.0)), None),
        (((GAIN + 1, -0.4, 29.0), (OUTLET, -0.01, 20.0)), None),
    ],
)
def test_what_may_be_the_rigs_own_need_not_be_told_apart(
    found: tuple[tuple[int, float, float], ...], leads: int | None
) -> None:
    """A question stood open for 5 s although all that explained the readings were changes of less than 1 %."""
    m = near_each_other(*found)
    number = own_verdict.leads_as_own(CONFIG, m, m.replays.evidence[: BOTH + 1])
    assert number == (None if leads is None else number_of(leads))


@pytest.mark.parametrize(
    ("t_s", "moved_V", "lag", "is_chosen"),
    [(77.0, 0.6, 46.0, True), (77.0, 0.6, 44.0, False), (77.0, 0.4, 46.0, False), (310.0, 0.6, 46.0, False)],
)
def test_on_a_rig_that_is_being_learned_a_longer_lag_comes_before_another_fault(
    t_s: float, moved_V: float, lag: float, *, is_chosen: bool
) -> None:
    """A lag of 0.98 s, learned as 0.6 s, was a question for 12 s, beside a pump with 0.8 of its gain; then neither."""
    m = near_each_other((GAIN, -0.25, 50.0), (LAG, 2.2, lag))
    m.t_s = t_s
    m.history.entries[295, VOLTAGE + 1] = 3.0 + moved_V
    number = own_verdict.own_instead(CONFIG, m, number_of(GAIN))
    assert number == (number_of(LAG) if is_chosen else None)
    assert not own_verdict.is_own(CONFIG, m, number_of(LAG)), "it is reported"


@pytest.mark.parametrize(("t_s", "open_s", "is_told"), [(30.0, 1.5, False), (-30.0, 0.9, False), (-30.0, 1.0, True)])
def test_in_a_start_phase_no_alarm_is_kept_back_for_more_than_a_second(
    t_s: float, open_s: float, *, is_told: bool
) -> None:
    m = near_each_other((OUTLET, -0.01, 29.0))
    m.t_s = t_s
    m.suspicion = Suspicion(number=None, detected_s=t_s - open_s, is_quiet=True, leader=number_of(OUTLET))
    isolation._speak(CONFIG, m, m.suspicion)
    assert (m.suspicion.number is not None) is is_told


def test_the_filter_beside_the_wide_one_is_not_renewed_while_something_is_near() -> None:
    """It was renewed a second before a large step's alarm, which it had explained until then."""
    m = a_memory(0.0, 0.0)
    m.is_wide, m.relearned_s, m.now, m.t_s = True, 1e3, 700, 70.0
    m.max_ratio = 15.0
    first_day.step(CONFIG, m, 0.0)
    assert m.wide is not None
    assert m.wide.began == 0
    m.max_ratio, m.now = 3.0, 701
    first_day.step(CONFIG, m, 0.0)
    assert m.wide.began == 701


@pytest.mark.parametrize(
    ("state", "now", "lead", "t_s", "is_wide"),
    [
        (SCALE, 1.10, 0.0, 60.0, True),
        (SCALE, 1.08, 0.0, 60.0, False),
        (OUTLET + 3, 0.9, 0.0, 60.0, True),
        (SCALE, 1.10, -1.0, 60.0, False),
        (SCALE, 1.10, 0.0, 400.0, False),
    ],
)
def test_a_main_filter_that_refutes_the_rig_file_gives_way(
    state: int, now: float, lead: float, t_s: float, *, is_wide: bool
) -> None:
    """With a gain 17 % off a prior of 3 % nothing was ever found by which the wide filter would have been asked."""
    m = a_memory(lead, 0.6)
    m.t_s, m.x[state] = t_s, now
    assert m.wide is not None
    assert first_day._is_refuted(CONFIG, m, m.wide) is is_wide


def test_the_rig_file_is_refuted_for_some_seconds_before_the_wide_filter_takes_over() -> None:
    """A loss of 60 % moves the gain by a tenth before it is found, and the wide filter follows it sooner."""
    m = a_memory(10.0, 0.6)
    wide = m.wide
    assert wide is not None
    for t_s, gain in ((30.0, 0.88), (34.9, 0.88), (35.0, 1.0), (36.0, 0.88), (40.9, 0.88)):
        m.t_s, m.x[SCALE] = t_s, gain
        first_day._watch_file(CONFIG, m, wide)
        assert not m.is_wide
    m.t_s = 41.0
    first_day._watch_file(CONFIG, m, wide)
    assert m.is_wide


def test_a_gain_that_is_learned_keeps_flow_and_its_uncertainty() -> None:
    m = a_memory(0.0, 0.0)
    m.x[GAIN], m.x[SCALE] = 0.8, 1.1
    m.P[GAIN, GAIN], m.P[SCALE, SCALE] = 0.02**2, 0.03**2
    first_day.fold_gain(m, 0)
    assert (m.x[GAIN], m.x[SCALE]) == pytest.approx((1.0, 0.88))
    assert m.P[GAIN, GAIN] == 0.0
    assert m.P[SCALE, SCALE] == pytest.approx((1.1 * 0.02) ** 2 + (0.8 * 0.03) ** 2)


@pytest.mark.parametrize(("gain", "lead", "is_own"), [(0.7, 3.0, True), (0.55, 3.0, False), (0.7, -1.0, False)])
def test_the_wide_filter_takes_over_for_pumps_that_always_were_so(gain: float, lead: float, *, is_own: bool) -> None:
    m = a_memory(lead, 0.6)
    assert m.wide is not None
    m.wide.x[SCALE : SCALE + 2] = gain
    m.best.ratio[BOTH], m.best.slot[BOTH], m.max_ratio = 20.0, 0, 20.0
    m.bank.onset[0] = 0
    m.times_s = [0.1 * step for step in range(len(m.times_s))]
    assert first_day.explains_alarm(CONFIG, m) is is_own
    assert m.is_wide is is_own
    assert jumps_of(BOTH) == (0, 1)


def test_a_dead_zone_that_is_hardly_known_leaves_nothing_to_follow() -> None:
    """What has arrived is then known no better than what was sent, but both err by the same."""
    m = a_memory(0.0, 0.0)
    spread, states = 0.4, [PUMP, ZONE]
    m.P[np.ix_(states, states)] = spread**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    assert wide_filter._gap_V(m.x, m.P, 0, 3.0) == pytest.approx(0.0, abs=1e-6)
    m.P[PUMP, ZONE] = m.P[ZONE, PUMP] = 0.0
    assert wide_filter._gap_V(m.x, m.P, 0, 3.0) == pytest.approx(spread * np.sqrt(2.0))


@pytest.mark.parametrize(
    ("ratio", "moved_V", "is_wide", "is_above"),
    [
        (19.9, 0.0, True, False),
        (20.1, 0.0, True, True),
        (20.1, 0.6, False, True),
        (29.9, 0.6, True, False),
        (30.1, 0.6, True, True),
    ],
)
def test_what_begins_after_a_movement_of_an_unknown_rig_must_show_more(
    ratio: float, moved_V: float, *, is_wide: bool, is_above: bool
) -> None:
    """Two questions on 30 rigs were asked at 20 to 22, some seconds after a large step, and withdrawn."""
    m = a_memory(0.0, moved_V)
    m.is_wide = is_wide
    m.best.ratio[:], m.best.slot[:], m.bank.onset[0] = 0.0, 0, 297
    m.best.ratio[number_of(OUTLET)] = m.max_ratio = ratio
    assert own_verdict.is_above_limit(CONFIG, m) is is_above
