"""What of a pump's effectiveness the law follows: a fade soon, what comes and goes seldom."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from hil.core.following import DWELL_S, GROWN_CHANGE, GROWN_S, Followed, follow
from hil.core.types import Diagnosis

PERIOD_S = 0.1


def course(effectiveness: Callable[[float], float], until_s: float) -> list[tuple[float, Followed]]:
    """(run time, what is followed) each time that the law follows another effectiveness of pump 1."""
    changes, now = [], Followed()
    for step in range(round(until_s / PERIOD_S)):
        t_s = step * PERIOD_S
        before, now = now, follow(now, Diagnosis((effectiveness(t_s), 1.0)), t_s)
        if now.effectiveness != before.effectiveness:
            changes.append((t_s, now))
    return changes


def test_a_pump_that_fades_is_kept_up_with() -> None:
    """The law followed a fade of 0.5 %/s once in 10 s: the output's error was four times as large as it is now."""
    changes = course(lambda t_s: 1.0 - 0.005 * t_s, 100.0)
    behind = [abs(now.effectiveness[0] - before.effectiveness[0]) for (_, before), (_, now) in pairwise(changes)]
    assert max(behind[1:]) < 2.0 * GROWN_CHANGE
    assert len(changes) > 40
    told = {now.told_s for _, now in changes}
    assert len(told) <= 100.0 / DWELL_S + 1, "the record tells of it every 10 s only"


def test_a_fast_fade_is_followed_every_second() -> None:
    times = [t_s for t_s, _ in course(lambda t_s: max(1.0 - 0.05 * t_s, 0.3), 20.0)]
    assert min(b - a for a, b in pairwise(times)) > GROWN_S - 0.5 * PERIOD_S


def test_what_comes_and_goes_is_followed_once_in_ten_seconds() -> None:
    times = [t_s for t_s, _ in course(lambda t_s: 0.9 if t_s % 2.0 < 1.0 else 1.0, 60.0)]
    assert len(times) > 1
    assert min(b - a for a, b in pairwise(times)) > DWELL_S - 0.5 * PERIOD_S


def test_the_noise_of_an_estimate_is_not_followed() -> None:
    assert len(course(lambda t_s: 0.7 + 0.004 * ((t_s * 7.3) % 1.0 - 0.5), 100.0)) == 1
