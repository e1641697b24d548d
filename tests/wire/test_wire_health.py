"""What the wire tells of its senders' health: valid readings, runs of refusals, error frames."""

import math

import can
import pytest

from hil.wire.frame_check import Rejection
from hil.wire.receiver import Receiver
from tests.wire.wire_bench import MS, NODE_FRAMES, feed_levels, frame, message, receiver

# readings that are not valid


def test_the_mean_is_that_of_the_valid_readings() -> None:
    """A sensor that is shorted for two readings of five used to move the mean by volts."""
    receiver_, _ = receiver((0.5, 9.5))
    readings = (6.0, 10.2, 6.2, 0.0, 6.1)
    for counter, y in enumerate(readings):
        feed_levels(receiver_, counter, counter * 20 * MS, (y, 6.4, 0.8, y))
    found = receiver_.measurement(90 * MS)
    assert found.level_V == pytest.approx((6.1, 6.4, 0.8, 6.1))
    assert found.variance_V2 == pytest.approx((0.01, 0.0, 0.0, 0.01))
    assert found.valid == (True,) * 4
    assert found.readings == 5
    assert receiver_.measurement(90 * MS).readings == 0


@pytest.mark.parametrize("channel", range(4))
def test_the_node_may_disown_one_channel_of_a_frame_and_the_other_counts(channel: int) -> None:
    receiver_, _ = receiver()
    statuses = tuple(3 * (i == channel) for i in range(4))
    feed_levels(receiver_, 0, 0, (2.0,) * 4)
    feed_levels(receiver_, 1, 20 * MS, (4.0,) * 4, statuses)
    found = receiver_.measurement(20 * MS)
    assert found.level_V == pytest.approx(tuple(2.0 if i == channel else 3.0 for i in range(4)))
    assert [math.isnan(v) for v in found.variance_V2] == [i == channel for i in range(4)]
    assert found.valid == tuple(i != channel for i in range(4))
    assert found.invalid_run == tuple(int(i == channel) for i in range(4))


def test_without_a_valid_reading_the_newest_one_stands_marked_as_it_is() -> None:
    receiver_, _ = receiver((0.5, 9.5))
    feed_levels(receiver_, 0, 0, (6.0,) * 4)
    receiver_.measurement(0)
    feed_levels(receiver_, 1, 20 * MS, (10.2, 6.0, 6.0, 6.0))
    found = receiver_.measurement(20 * MS)
    assert found.level_V[0] == pytest.approx(10.2)
    assert found.valid == (False, True, True, True)
    assert math.isnan(found.variance_V2[0])


# runs of refusals, error frames


def worst_run(receiver_: Receiver, now_ns: int = 0) -> int:
    return receiver_.bus(now_ns, 0, is_up=True).refused_run


def corrupt(name: str, counter: int) -> can.Message:
    bad = frame(name, counter)
    bad.data[0] ^= 0x40
    return bad


@pytest.mark.parametrize("name", [*NODE_FRAMES, "PumpCommand"])
def test_refusals_of_one_identifier_in_a_row_are_counted(name: str) -> None:
    receiver_, _ = receiver()
    receiver_.take(frame(name, 0), 0)
    for number in range(1, 5):
        assert receiver_.take(corrupt(name, number), number * MS) is Rejection.CRC
        assert worst_run(receiver_) == number
    assert worst_run(receiver_) == 0, "nothing new since the last step"
    assert receiver_.take(frame(name, 5), 6 * MS) is None
    assert receiver_.take(corrupt(name, 6), 7 * MS) is Rejection.CRC
    assert worst_run(receiver_) == 1


def test_a_run_that_ended_before_the_step_is_still_seen() -> None:
    receiver_, _ = receiver()
    receiver_.take(frame("LowerLevels", 0), 0)
    for number in range(1, 6):
        receiver_.take(corrupt("LowerLevels", number), number * MS)
    receiver_.take(frame("LowerLevels", 6), 6 * MS)
    assert worst_run(receiver_) == 5
    assert worst_run(receiver_) == 0


def test_good_frames_of_other_identifiers_do_not_break_a_run() -> None:
    receiver_, _ = receiver()
    for number in range(4):
        receiver_.take(corrupt("PumpStatus", number), number * MS)
        receiver_.take(frame("LowerLevels", number), number * MS)
    assert worst_run(receiver_) == 4


@pytest.mark.parametrize("kind", ["is_extended_id", "is_fd", "is_remote_frame", "is_error_frame"])
def test_frames_of_another_kind_are_nobodys_run(kind: str) -> None:
    receiver_, _ = receiver()
    for number in range(9):
        odd = frame("PumpStatus", number)
        setattr(odd, kind, True)
        receiver_.take(odd, number * MS)
    assert worst_run(receiver_) == 0


PERIODS = [("LowerLevels", 20), ("PumpStatus", 50), ("PumpHeartbeat", 100), ("LevelHeartbeat", 100)]


@pytest.mark.parametrize(("name", "period_ms"), PERIODS)
@pytest.mark.parametrize("counter", [0, 7, 15])
def test_a_counter_that_is_stuck_is_five_frames_running_after_five_frames(
    name: str, period_ms: int, counter: int
) -> None:
    """What gets in after each silence must not look like health: two of three heartbeats would."""
    receiver_, _ = receiver()
    receiver_.take(frame(name, counter), 1000 * MS)
    assert worst_run(receiver_) == 0
    for number in range(1, 6):
        receiver_.take(frame(name, counter), (1000 + number * period_ms) * MS)
        assert worst_run(receiver_) == number
    receiver_.take(frame(name, (counter + 1) % 16), (1000 + 6 * period_ms) * MS)
    receiver_.take(corrupt(name, (counter + 2) % 16), (1000 + 7 * period_ms) * MS)
    assert worst_run(receiver_) == 1


def test_a_silence_of_sixteen_frames_is_one_doubtful_frame() -> None:
    receiver_, _ = receiver()
    receiver_.take(frame("LowerLevels", 3), 0)
    assert receiver_.take(frame("LowerLevels", 3), 320 * MS) is None
    assert worst_run(receiver_) == 1
    assert receiver_.take(frame("LowerLevels", 4), 340 * MS) is None
    receiver_.take(corrupt("LowerLevels", 5), 360 * MS)
    assert worst_run(receiver_) == 1


def error_frames(receiver_: Receiver, count: int, first_ms: int = 0, every_ms: int = 1) -> None:
    for number in range(count):
        receiver_.take(message(0, b"", is_error_frame=True), (first_ms + number * every_ms) * MS)


def test_error_frames_of_the_last_second_are_counted() -> None:
    receiver_, _ = receiver()
    error_frames(receiver_, 7, every_ms=100)
    assert receiver_.bus(600 * MS, 0, is_up=True).errors_per_s == 7
    assert receiver_.bus(1000 * MS, 0, is_up=True).errors_per_s == 7
    assert receiver_.bus(1000 * MS + 1, 0, is_up=True).errors_per_s == 6
    assert receiver_.bus(1550 * MS, 0, is_up=True).errors_per_s == 1
    assert receiver_.bus(1601 * MS, 0, is_up=True).errors_per_s == 0
    assert receiver_.rejections[Rejection.ERROR_FRAME] == 7


def test_a_storm_takes_no_more_memory_than_it_has_to() -> None:
    receiver_, _ = receiver()
    error_frames(receiver_, 5000, every_ms=0)
    assert receiver_.bus(MS, 0, is_up=True).errors_per_s == 1000
    assert receiver_.bus(MS, 0, is_up=True).rejected == 5000


def test_bus_health_passes_on_what_the_bus_complained_of() -> None:
    receiver_, _ = receiver()
    assert receiver_.bus(0, 0, is_up=True).last_error == ""
    assert receiver_.bus(0, 0, is_up=False, last_error="gone").last_error == "gone"
