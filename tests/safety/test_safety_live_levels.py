"""The veto of a live sensor: what a reading without trust may still show, and what can't be water."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest

from hil.core.diagnosis.ideal import NoDetector
from hil.core.estimator import Estimate
from hil.core.live_levels import (
    FORGET_S,
    NONE,
    LiveLevels,
    fastest_changes,
    live_levels_cm,
    watch_readings,
)
from hil.core.tanks import TankModel
from hil.core.types import Diagnosis, Inputs, Measurement, Mode, Pair, TripCause
from tests.core.core_bench import Plant, bench_loop, controller_config, run
from tests.narrowing import quad
from tests.safety.safety_bench import ALL, BENCH, HEALTHY, REST_CM, REST_V, doubted, level

SECOND = 1_000_000_000
DT_NS = SECOND // 10
MAX_V = (10.0, 10.0)
QUIET = (1e-12,) * 4


def reading(level_cm: Iterable[float], **more: Any) -> Measurement:
    return replace(Measurement(quad(0.5 * h for h in level_cm), ALL, 0.01, 5, jitter_V2=quad(QUIET)), **more)


def watched(
    *levels_cm: tuple[float, ...], trusted: tuple[bool, ...] = ALL, dt_ns: int = DT_NS, **more: Any
) -> LiveLevels:
    """The monitor after these readings, one a step."""
    live = LiveLevels()
    for number, levels in enumerate(levels_cm):
        live = watch_readings(BENCH, MAX_V, live, reading(levels, **more), trusted, number * dt_ns)
    return live


def path(channel: int, *values: float) -> list[tuple[float, ...]]:
    """Readings of which one channel takes these values; the others stay at 5 cm."""
    return [tuple(value if i == channel else 5.0 for i in range(4)) for value in values]


# what can be water


def test_the_fastest_changes_are_those_of_a_shut_outlet_and_of_no_inflow() -> None:
    """By hand: 1.5 times a pump at 10 V and a full tank above; 1.5 times the outflow of a full tank."""
    a1, a2 = 0.071 * math.sqrt(2 * 981 * 20), 0.057 * math.sqrt(2 * 981 * 20)
    rises, falls = fastest_changes(BENCH, MAX_V)
    assert rises == pytest.approx(
        (1.5 * (33.3 + a1) / 28, 1.5 * (33.5 + a2) / 32, 1.5 * 33.5 / 28, 1.5 * 33.3 / 32), rel=1e-12
    )
    assert falls == pytest.approx((1.5 * a1 / 28, 1.5 * a2 / 32, 1.5 * a1 / 28, 1.5 * a2 / 32), rel=1e-12)
    other = TankModel(outlet_cm2=(0.01, 0.02, 0.03, 0.04), area_cm2=(10.0, 20.0, 30.0, 40.0))
    out = [a * math.sqrt(2 * 981 * 20) for a in other.outlet_cm2]
    rises, falls = fastest_changes(other, (1.0, 1.0))
    assert rises == pytest.approx(
        (1.5 * (3.33 + out[2]) / 10, 1.5 * (3.35 + out[3]) / 20, 1.5 * 3.35 / 30, 1.5 * 3.33 / 40), rel=1e-12
    )
    assert falls == pytest.approx([1.5 * out[i] / other.area_cm2[i] for i in range(4)], rel=1e-12)


@pytest.mark.parametrize("channel", range(4))
def test_a_rise_that_water_can_make_counts_in_full_a_faster_one_not_at_all(channel: int) -> None:
    most = 0.1 * fastest_changes(BENCH, MAX_V)[0][channel]
    slow = watched(*path(channel, 5.0, 5.0 + 0.999 * most, 5.0 + 1.998 * most), trusted=doubted(channel))
    assert slow.sudden_cm == (0.0,) * 4
    fast = watched(*path(channel, 5.0, 5.0 + 1.001 * most), trusted=doubted(channel))
    assert fast.sudden_cm == pytest.approx([1.001 * most if i == channel else 0.0 for i in range(4)])
    assert fast.reading_cm[channel] == pytest.approx(5.0 + 1.001 * most)


@pytest.mark.parametrize("channel", range(4))
def test_what_water_can_just_make_is_water(channel: int) -> None:
    rises, falls = fastest_changes(BENCH, MAX_V)
    exact: dict[str, Any] = {"jitter_V2": (math.nan,) * 4}  # nothing is added for noise
    rise, fall = 0.1 * rises[channel], 0.1 * falls[channel]
    at_zero, at_fall = quad((0.0,) * 4), quad((fall,) * 4)
    risen = watch_readings(
        BENCH, MAX_V, LiveLevels(at_zero), reading(path(channel, rise)[0], **exact), doubted(channel), DT_NS
    )
    assert risen.sudden_cm[channel] == 0.0
    before = LiveLevels(at_fall, sudden_cm=quad((1.0,) * 4))
    fallen = watch_readings(BENCH, MAX_V, before, reading(at_zero, **exact), doubted(channel), DT_NS)
    assert fallen.sudden_cm[channel] == 1.0


@pytest.mark.parametrize("channel", range(4))
def test_a_sudden_fall_gives_back_what_a_sudden_rise_took_and_a_slow_one_does_not(channel: int) -> None:
    fall = 0.1 * fastest_changes(BENCH, MAX_V)[1][channel]
    up = path(channel, 5.0, 8.0)
    back = watched(*up, *path(channel, 8.0 - 1.001 * fall), trusted=doubted(channel))
    assert back.sudden_cm[channel] == pytest.approx(3.0 - 1.001 * fall)
    water = watched(*up, *path(channel, 8.0 - 0.999 * fall), trusted=doubted(channel))
    assert water.sudden_cm[channel] == pytest.approx(3.0)
    below = watched(*up, *path(channel, 1.0), trusted=doubted(channel))
    assert below.sudden_cm[channel] == 0.0


def test_after_a_longer_time_water_can_rise_further() -> None:
    rise = fastest_changes(BENCH, MAX_V)[0][0]
    levels = path(0, 5.0, 5.0 + 0.9 * rise)
    assert watched(*levels, dt_ns=SECOND).sudden_cm[0] == 0.0
    assert watched(*levels, dt_ns=SECOND // 2).sudden_cm[0] > 0.0


def test_an_invalid_reading_is_skipped_and_the_next_valid_one_has_had_the_time_of_both() -> None:
    rise = fastest_changes(BENCH, MAX_V)[0][0]
    live = watched(*path(0, 5.0), dt_ns=SECOND)
    for damage in (
        {"valid": doubted(0)},
        {"level_V": (math.nan, 2.5, 2.5, 2.5)},
        {"level_V": (math.inf, 2.5, 2.5, 2.5)},
    ):
        missed = watch_readings(BENCH, MAX_V, live, reading((20.0, 5.0, 5.0, 5.0), **damage), ALL, SECOND)
        assert missed.reading_cm == (5.0,) * 4
        assert missed.read_ns == (0, SECOND, SECOND, SECOND)
        late = watch_readings(BENCH, MAX_V, missed, reading((5.0 + 1.9 * rise, 5.0, 5.0, 5.0)), ALL, 2 * SECOND)
        assert late.sudden_cm == (0.0,) * 4
        assert late.read_ns == (2 * SECOND,) * 4


def test_noise_is_no_sudden_rise() -> None:
    """Six standard deviations of the difference of two means of five readings, at 0.5 V/cm."""
    rises, falls = fastest_changes(BENCH, MAX_V)
    noise_cm = 6.0 * math.sqrt(2.0 * 0.01 / 5.0) / 0.5
    noisy: dict[str, Any] = {"jitter_V2": (0.01,) * 4, "trusted": doubted(0)}
    for change, limit in ((1.0, 0.1 * rises[0] + noise_cm), (-1.0, 0.1 * falls[0] + noise_cm)):
        start = path(0, 5.0, 10.0) if change < 0 else path(0, 10.0)
        at = start[-1][0]
        kept = watched(*start, *path(0, at + 0.999 * change * limit), **noisy).sudden_cm[0]
        moved = watched(*start, *path(0, at + 1.001 * change * limit), **noisy).sudden_cm[0]
        assert kept == (5.0 if change < 0 else 0.0)
        assert moved == pytest.approx(kept + 1.001 * change * limit)
    for unknown in ({"jitter_V2": (math.nan,) * 4}, {"readings": 0, "jitter_V2": (0.01,) * 4}):
        assert watched(*path(0, 5.0, 5.0 + 0.11 * rises[0]), **unknown).sudden_cm[0] > 0.0
    one = watched(*path(0, 5.0, 5.0 + 0.11 * rises[0]), readings=1, jitter_V2=(0.01,) * 4)
    assert one.sudden_cm[0] == 0.0


def test_a_sudden_rise_is_forgotten_while_the_sensor_is_trusted_only() -> None:
    jump = path(0, 5.0, 8.0)
    kept = watched(*jump, *path(0, *[8.0] * 10), trusted=doubted(0))
    assert kept.sudden_cm[0] == 3.0
    forgotten = watched(*jump, *path(0, *[8.0] * 10), trusted=doubted(1))
    assert forgotten.sudden_cm[0] == pytest.approx(3.0 * math.exp(-1.1 / FORGET_S))
    assert FORGET_S == 60.0


# what a sensor without trust shows


def test_only_a_valid_reading_without_trust_that_is_not_refuted_shows_a_level() -> None:
    live = LiveLevels(reading_cm=(11.0, 12.0, 13.0, 14.0), sudden_cm=(1.0, 2.0, 3.0, 4.0), read_ns=(0,) * 4)
    seen = HEALTHY.measurement
    for channel, shown in enumerate((10.0, 10.0, 10.0, 10.0)):
        expected = tuple(shown if i == channel else -math.inf for i in range(4))
        assert live_levels_cm(BENCH, live, seen, Diagnosis(trusted=doubted(channel))) == expected
        refuted = quad(i == channel for i in range(4))
        assert live_levels_cm(BENCH, live, seen, Diagnosis(trusted=doubted(channel), refuted=refuted)) == NONE
        assert (
            live_levels_cm(BENCH, live, replace(seen, valid=doubted(channel)), Diagnosis(trusted=doubted(channel)))
            == NONE
        )
    assert live_levels_cm(BENCH, live, seen, Diagnosis()) == NONE
    assert list(NONE) == [-math.inf] * 4


@pytest.mark.parametrize(("proven_V", "shown_cm"), [(0.0, 13.0), (1.0, 13.0), (1.5, 12.0), (3.0, 9.0), (-1.0, 13.0)])
def test_what_is_proven_to_be_the_sensors_own_is_not_level(proven_V: float, shown_cm: float) -> None:
    """In volts; a jump may be part of it, so that only the larger of the two is subtracted."""
    live = LiveLevels(reading_cm=(15.0,) * 4, sudden_cm=(2.0,) * 4, read_ns=(0,) * 4)
    for channel in range(4):
        proven = quad(proven_V if i == channel else 5.0 for i in range(4))
        seen = Diagnosis(trusted=doubted(channel), proven_V=proven)
        assert live_levels_cm(BENCH, live, HEALTHY.measurement, seen)[channel] == pytest.approx(shown_cm)


def test_what_a_proven_drift_reads_more_from_then_on_counts_again() -> None:
    """The proof is about one moment: the outlet may clog afterwards."""
    seen = Diagnosis(trusted=doubted(0), proven_V=(1.0, 0.0, 0.0, 0.0))
    shown = [
        live_levels_cm(BENCH, LiveLevels(reading_cm=(h, 12.0, 2.0, 2.0), read_ns=(0,) * 4), HEALTHY.measurement, seen)[
            0
        ]
        for h in (14.0, 17.0, 20.5)
    ]
    assert shown == [12.0, 15.0, 18.5]


def test_the_monitor_begins_with_nothing() -> None:
    begun = LiveLevels()
    with pytest.raises(AttributeError):
        begun.reading_cm = begun.sudden_cm  # type: ignore[misc]
    assert not hasattr(begun, "__dict__")
    assert all(math.isnan(h) for h in begun.reading_cm)
    assert (begun.sudden_cm, begun.read_ns) == ((0.0,) * 4, (0,) * 4)
    first = watch_readings(BENCH, MAX_V, begun, HEALTHY.measurement, ALL, 7 * SECOND)
    assert first.reading_cm == pytest.approx(REST_CM)
    assert (first.sudden_cm, first.read_ns) == ((0.0,) * 4, (7 * SECOND,) * 4)


# the whole control step


class CallsItDrift(NoDetector):
    """A detector that takes everything for a drift of one sensor from 5 s on, and stays at the level of rest."""

    def __init__(self, sensor: int) -> None:
        self.trusted = doubted(sensor)

    def step(
        self, memory: object, t_s: float, measurement: Measurement, estimate: Estimate, applied_V: Pair
    ) -> tuple[None, Diagnosis]:
        if t_s < 5.0:
            return super().step(memory, t_s, measurement, estimate, applied_V)
        y = measurement.level_V
        level_V = quad(y[i] if self.trusted[i] else REST_V[i] for i in range(4))
        return None, Diagnosis(trusted=self.trusted, level_V=level_V)


class CloggingPlant(Plant):
    """The outlet of one lower tank closes at a rate, in shares a second."""

    def __init__(self, tank: int, rate_1_s: float) -> None:
        super().__init__()
        self.tank, self.rate_1_s, self.share = tank, rate_1_s, 1.0
        self.highest_cm = 0.0

    def advance(self, applied_V: Pair, dt_s: float) -> None:
        self.share = max(self.share - self.rate_1_s * dt_s, 0.0)
        outlets = quad(a * (self.share if i == self.tank else 1.0) for i, a in enumerate(BENCH.outlet_cm2))
        self.model = replace(BENCH, outlet_cm2=outlets)
        super().advance(applied_V, dt_s)
        self.highest_cm = max(self.highest_cm, max(self.level_cm))


@pytest.mark.parametrize("tank", [0, 1])
@pytest.mark.parametrize("rate_1_s", [0.005, 0.02, 0.2])
def test_a_clogging_outlet_that_is_called_a_drift_trips_before_the_rim(tank: int, rate_1_s: float) -> None:
    """It overflowed: the loop held the model's level, and no interlock looked at the sensor.

    With the pumps stopped the tank above still drains into it, so the peak counts, by the outlet as the reading
    shows it.
    """
    plant = CloggingPlant(tank, rate_1_s)
    config = controller_config(bench_loop(detector=CallsItDrift(tank)))
    state, records = run(config, plant, round(600 + 4.5 / rate_1_s))
    assert state.supervision.cause is TripCause.HIGH_LEVEL
    assert records[-1].command_V == (0.0, 0.0)
    for _ in range(600):
        plant.advance((0.0, 0.0), 0.1)
    assert 17.0 < plant.highest_cm < 20.0


def test_a_bias_that_jumps_costs_no_trip_and_the_level_above_it_still_does() -> None:
    """A reading that jumps by 8 cm can't be water; what the level does afterwards still shows in it."""

    def biased(number: int, seen: Inputs) -> Inputs:
        return level(seen, 0, seen.measurement.level_V[0] + 4.0) if number >= 60 else seen

    config = controller_config(bench_loop(detector=CallsItDrift(0)))
    calm, _ = run(config, Plant(), 600, on_step=biased)
    assert calm.supervision.mode is Mode.DEGRADED
    assert calm.monitors.live.sudden_cm[0] == pytest.approx(8.0, abs=0.1)
    plant = CloggingPlant(0, 0.02)
    clogged, _ = run(config, plant, 800, on_step=biased)
    assert clogged.supervision.cause is TripCause.HIGH_LEVEL
    assert plant.highest_cm < 20.0


def test_the_outlets_are_seen_through_the_live_sensor_too() -> None:
    """The loop's levels rest on the model, which knows of no blockage."""
    state, _ = run(controller_config(bench_loop(detector=CallsItDrift(0))), CloggingPlant(0, 0.005), 400)
    monitors = state.monitors
    assert monitors.live_outlets.share[0] == pytest.approx(0.8, abs=0.03)
    assert monitors.outlets.share[0] > 0.95
    healthy, _ = run(controller_config(bench_loop()), Plant(), 100)
    assert healthy.monitors.live_outlets == healthy.monitors.outlets


def test_a_full_tank_is_full_at_its_own_rim_and_drains_with_its_own_head() -> None:
    """By hand: heads of height and datum; a pump at its own largest drive."""
    model = replace(BENCH, height_cm=(20.0, 22.0, 24.0, 26.0), datum_cm=(5.0, 4.0, 3.0, 2.0))
    out = [a * math.sqrt(2 * 981 * head) for a, head in zip(model.outlet_cm2, (25.0, 26.0, 27.0, 28.0), strict=True)]
    rises, falls = fastest_changes(model, (12.0, 9.0))
    q1, q2 = 3.33 * 12.0, 3.35 * 9.0
    assert rises == pytest.approx(
        (1.5 * (q1 + out[2]) / 28, 1.5 * (q2 + out[3]) / 32, 1.5 * q2 / 28, 1.5 * q1 / 32), rel=1e-12
    )
    assert falls == pytest.approx([1.5 * out[i] / model.area_cm2[i] for i in range(4)], rel=1e-12)
