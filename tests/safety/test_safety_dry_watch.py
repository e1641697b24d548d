"""The dry watch: pumps that lose their flow under other names, and what must not look like it."""

import pytest

from hil.core.dry_watch import DRY_S, MIN_V, DryWatch, watch_dry
from hil.core.tanks import equilibrium, level_rates
from hil.core.types import Pair
from tests.narrowing import quad
from tests.safety.safety_bench import ALL, BENCH, doubted

SECOND = 1_000_000_000


def watched(
    left: Pair, pump_V: Pair = (3.0, 3.0), seconds: float = 60.0, trusted: tuple[bool, ...] = ALL, start_V: float = 3.0
) -> DryWatch:
    """The watch after a run by steps of 0.1 s, with these shares of the pumps' flow left."""
    watch, level = DryWatch(), equilibrium(BENCH, (start_V, start_V))
    for number in range(round(10 * seconds)):
        rates = level_rates(BENCH, level, (left[0] * pump_V[0], left[1] * pump_V[1]))
        level = quad(max(h + 0.1 * rate, 0.0) for h, rate in zip(level, rates, strict=True))
        watch = watch_dry(BENCH, watch, level, pump_V, trusted, (number + 1) * SECOND // 10)
    return watch


def test_pumps_without_water_are_dry_after_some_seconds() -> None:
    """Two pumps that faded to nothing in 400 s ran on for the rest of the run: neither was called dead."""
    assert not watched((0.0, 0.0), seconds=DRY_S).is_dry
    assert watched((0.0, 0.0), seconds=DRY_S + 10.0).is_dry
    assert watched((0.05, 0.05)).is_dry


@pytest.mark.parametrize("left", [(1.0, 1.0), (0.0, 1.0), (1.0, 0.0), (0.15, 0.0), (0.0, 0.15)])
def test_one_pump_that_gives_water_is_enough(left: Pair) -> None:
    watch = watched(left)
    assert not watch.is_dry
    assert watch.share == pytest.approx(left, abs=0.05)


def test_tanks_that_fill_from_empty_are_not_dry() -> None:
    assert watched((1.0, 1.0), start_V=0.0, seconds=15.0).share == pytest.approx((1.0, 1.0), abs=0.05)


@pytest.mark.parametrize("how", [{"pump_V": (MIN_V - 0.01, 3.0)}, {"trusted": doubted(2)}, {"trusted": doubted(3)}])
def test_what_can_not_be_judged_is_not_dry(how: dict[str, tuple[float, ...]]) -> None:
    watch = watched((0.0, 0.0), **how)  # type: ignore[arg-type]
    assert watch == DryWatch(level_cm=watch.level_cm, watched_ns=60 * SECOND)


def test_a_look_at_the_same_time_begins_again() -> None:
    before = DryWatch((0.0, 0.0), 9.0, (1.0, 1.0, 1.0, 1.0), SECOND)
    again = watch_dry(BENCH, before, (1.0, 1.0, 0.5, 0.4), (3.0, 3.0), ALL, SECOND)
    assert again == DryWatch(level_cm=(1.0, 1.0, 0.5, 0.4), watched_ns=SECOND)
