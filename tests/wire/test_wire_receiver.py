"""What may change the picture of the bench, and what the picture is."""

import math
from itertools import combinations

import pytest
from can import Message
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.types import NodeState, Pair
from hil.wire.frame_check import MAX_COUNTER_STEP, RESYNCHRONISE_NS, Rejection
from hil.wire.receiver import Receiver
from tests.wire.wire_bench import (
    CONTRACT,
    MS,
    NAMES,
    NODE_FRAMES,
    feed_levels,
    frame,
    go,
    message,
    payload_of,
    receiver,
    sealed,
    seen,
)

PERIOD_NS = {"LowerLevels": 20 * MS, "UpperLevels": 20 * MS, "PumpStatus": 50 * MS}


def test_before_the_first_frame_nothing_is_known() -> None:
    receiver_, _ = receiver()
    measurement, pumps, nodes = receiver_.measurement(MS), receiver_.pumps(MS), receiver_.nodes(MS)
    assert all(map(math.isnan, measurement.level_V))
    assert measurement.valid == (False,) * 4
    assert measurement.age_s == pumps.age_s == nodes.age_s == math.inf
    assert measurement.readings == 0
    assert all(map(math.isnan, pumps.applied_V))
    assert pumps.state is NodeState.BOOT
    assert pumps.shortfall_V == (0.0, 0.0)
    assert not nodes.rebooted


# what is refused


@pytest.mark.parametrize("flips", [1, 2])
@pytest.mark.parametrize("name", NAMES)
def test_every_flip_of_one_or_two_bits_is_refused(name: str, flips: int) -> None:
    good = payload_of(name, 5)
    receiver_, _ = receiver()
    broken = message(CONTRACT.frames[name].frame_id, good)
    tried = 0
    for bits in combinations(range(8 * len(good)), flips):
        broken.data = bytearray(good)
        for bit in bits:
            broken.data[bit // 8] ^= 1 << bit % 8
        assert receiver_.take(broken, MS) is Rejection.CRC
        tried += 1
    assert tried == len(good) * 8 * (1 if flips == 1 else (len(good) * 8 - 1) / 2)
    assert receiver_.rejections == {Rejection.CRC: tried}
    assert receiver_.accepted == 0
    broken.data = bytearray(good)
    assert receiver_.take(broken, MS) is None


STATUS_ID = CONTRACT.frames["PumpStatus"].frame_id
GOOD = payload_of("PumpStatus", 1)
REFUSED = [
    (message(STATUS_ID, GOOD, is_error_frame=True), Rejection.ERROR_FRAME),
    (message(STATUS_ID, GOOD, is_extended_id=True), Rejection.KIND),
    (message(STATUS_ID, GOOD, is_fd=True), Rejection.KIND),
    (Message(arbitration_id=STATUS_ID, is_extended_id=False, is_remote_frame=True, dlc=8), Rejection.KIND),
    (message(0x000, b""), Rejection.UNKNOWN_ID),
    (message(STATUS_ID + 1 + 0x400, GOOD), Rejection.UNKNOWN_ID),
    (message(0x1FFFFFFF, GOOD, is_extended_id=True), Rejection.UNKNOWN_ID),
    *[(message(STATUS_ID, GOOD[:length]), Rejection.LENGTH) for length in range(8)],
    (message(STATUS_ID, GOOD[:3], dlc=8), Rejection.LENGTH),
    (message(STATUS_ID, GOOD[:7] + bytes([GOOD[7] ^ 0x80])), Rejection.CRC),
    (message(STATUS_ID, bytes(8)), Rejection.CRC),
    (message(CONTRACT.frames["LowerLevels"].frame_id, GOOD[:7]), Rejection.CRC),
    (message(CONTRACT.frames["LowerLevels"].frame_id, GOOD), Rejection.LENGTH),
    (message(CONTRACT.frames["PumpHeartbeat"].frame_id, GOOD), Rejection.CRC),
    (frame("PumpStatus", 1, State=4), Rejection.RANGE),
    (frame("PumpStatus", 1, TripCause=2), Rejection.RANGE),
    (frame("PumpStatus", 1, Applied2=10.0002), Rejection.RANGE),
    (frame("LowerLevels", 1, Level1=10.2402), Rejection.RANGE),
    (frame("UpperLevels", 1, Status4=4), Rejection.RANGE),
    (frame("PumpStatus", 0), Rejection.DUPLICATE),
    (frame("PumpStatus", 0, Applied1=9.0), Rejection.DUPLICATE),
    (frame("PumpStatus", 15), Rejection.OLD),
    (frame("PumpStatus", 9), Rejection.OLD),
]


@pytest.mark.parametrize(("bad", "cause"), REFUSED)
def test_what_is_refused_changes_nothing_and_is_counted_by_its_cause(bad: Message, cause: Rejection) -> None:
    def begun() -> Receiver:
        receiver_, _ = receiver()
        for name in NODE_FRAMES:
            assert receiver_.take(frame(name, 0), MS) is None
        return receiver_

    receiver_ = begun()
    assert receiver_.take(bad, 2 * MS) is cause
    assert receiver_.rejections == {cause: 1}
    assert receiver_.bus(0, 0, is_up=True).rejected == 1
    assert seen(receiver_, 3 * MS) == seen(begun(), 3 * MS)
    for name in NODE_FRAMES:  # nor does it keep the next good frame out
        assert receiver_.take(frame(name, 1), 4 * MS) is None


@settings(max_examples=200, deadline=None)
@given(
    st.one_of(st.sampled_from(CONTRACT.ids), st.integers(0, 0x1FFFFFFF)),
    st.binary(max_size=64),
    st.booleans(),
    st.booleans(),
    st.booleans(),
    st.integers(0, 10**12),
    st.booleans(),
)
def test_no_frame_raises(
    can_id: int, data: bytes, extended: bool, remote: bool, error: bool, at_ns: int, seal: bool
) -> None:
    receiver_, sender = receiver()
    sender.encode(go(), 0)
    name = next((n for n, s in CONTRACT.frames.items() if s.frame_id == can_id), None)
    if name and seal:
        data = sealed(name, data[: CONTRACT.frames[name].length - 1])
    bad = message(can_id, b"", is_extended_id=extended, is_remote_frame=remote, is_error_frame=error)
    bad.data = bytearray(data)
    receiver_.take(bad, at_ns)
    measurement, _, _ = receiver_.measurement(at_ns), receiver_.pumps(at_ns), receiver_.nodes(at_ns)
    assert not all(measurement.valid)
    assert receiver_.accepted + receiver_.rejections.total() == 1


# counters


@pytest.mark.parametrize("last", range(16))
@pytest.mark.parametrize("step", range(16))
def test_counter_rule(last: int, step: int) -> None:
    receiver_, _ = receiver()
    assert receiver_.take(frame("LowerLevels", last), 0) is None
    verdict = receiver_.take(frame("LowerLevels", (last + step) % 16), 20 * MS)
    if step == 0:
        assert verdict is Rejection.DUPLICATE
    elif step > MAX_COUNTER_STEP:
        assert verdict is Rejection.OLD
    else:
        assert verdict is None
        assert receiver_.lost == step - 1


@pytest.mark.parametrize("step", range(16))
def test_after_the_resynchronisation_time_any_counter_is_good(step: int) -> None:
    for late_ns, is_taken in ((RESYNCHRONISE_NS, 1 <= step <= MAX_COUNTER_STEP), (RESYNCHRONISE_NS + 1, True)):
        receiver_, _ = receiver()
        receiver_.take(frame("LowerLevels", 3), 0)
        assert (receiver_.take(frame("LowerLevels", (3 + step) % 16), late_ns) is None) == is_taken
        if late_ns > RESYNCHRONISE_NS:
            assert receiver_.lost == 0


@pytest.mark.parametrize("name", ["LowerLevels", "UpperLevels", "PumpStatus"])
@pytest.mark.parametrize("burst", range(1, 33))
def test_after_a_burst_of_lost_frames_the_next_is_taken(name: str, burst: int) -> None:
    """15, 16 and 32 lost frames wrap the counter; the time gone tells them from duplicates."""
    receiver_, _ = receiver()
    period_ns = PERIOD_NS[name]
    numbers = [*range(5), *range(5 + burst, 40 + burst)]
    for number in numbers:
        assert receiver_.take(frame(name, number % 16), number * period_ns) is None
    within = (burst + 1) * period_ns <= RESYNCHRONISE_NS
    assert receiver_.lost == (burst if within else 0)
    assert receiver_.accepted == len(numbers)


def test_a_stuck_counter_goes_stale_and_then_gets_in_once_per_resynchronisation() -> None:
    receiver_, _ = receiver()
    verdicts = [receiver_.take(frame("LowerLevels", 7), n * 20 * MS) for n in range(17)]
    assert [n for n, v in enumerate(verdicts) if v is None] == [0, 8, 16]
    assert receiver_.rejections == {Rejection.DUPLICATE: 14}


def test_counters_of_different_frames_do_not_mix() -> None:
    receiver_, _ = receiver()
    for counter, name in enumerate(NODE_FRAMES):
        assert receiver_.take(frame(name, 3 * counter), MS) is None
    for counter, name in enumerate(NODE_FRAMES):
        assert receiver_.take(frame(name, 3 * counter + 1), 2 * MS) is None
    assert receiver_.lost == 0


def test_swapped_frames_leave_the_newer_one() -> None:
    receiver_, _ = receiver()
    receiver_.take(frame("LowerLevels", 0, Level1=1.0), 0)
    receiver_.take(frame("LowerLevels", 2, Level1=3.0), MS)
    assert receiver_.take(frame("LowerLevels", 1, Level1=2.0), 2 * MS) is Rejection.OLD
    receiver_.measurement(2 * MS)
    assert receiver_.measurement(2 * MS).level_V[0] == pytest.approx(3.0)


# levels


def test_a_step_gets_the_mean_of_the_readings_since_the_last_one() -> None:
    receiver_, _ = receiver()
    for counter, y in enumerate((1.0, 2.0, 6.0)):
        feed_levels(receiver_, counter, counter * 20 * MS, (y, y + 0.1, y + 0.2, y + 0.3))
    first = receiver_.measurement(50 * MS)
    assert first.level_V == pytest.approx((3.0, 3.1, 3.2, 3.3))
    assert first.readings == 3
    assert first.age_s == pytest.approx(0.01)
    feed_levels(receiver_, 3, 60 * MS, (4.0, 4.1, 4.2, 4.3))
    assert receiver_.measurement(60 * MS).level_V == pytest.approx((4.0, 4.1, 4.2, 4.3))


def test_without_new_readings_the_newest_stands_and_ages() -> None:
    receiver_, _ = receiver()
    feed_levels(receiver_, 0, 0, (1.0, 1.0, 1.0, 1.0))
    feed_levels(receiver_, 1, 20 * MS, (2.0, 2.0, 2.0, 2.0))
    receiver_.measurement(20 * MS)
    late = receiver_.measurement(320 * MS)
    assert late.level_V == pytest.approx((2.0,) * 4)
    assert late.readings == 0
    assert late.age_s == pytest.approx(0.3)
    assert late.valid == (True,) * 4


@pytest.mark.parametrize("silent", ["LowerLevels", "UpperLevels"])
def test_the_older_frame_makes_the_age_and_the_scarcer_one_the_readings(silent: str) -> None:
    receiver_, _ = receiver()
    feed_levels(receiver_, 0, 0)
    other = "UpperLevels" if silent == "LowerLevels" else "LowerLevels"
    for counter in (1, 2):
        receiver_.take(frame(other, counter), counter * 20 * MS)
    found = receiver_.measurement(100 * MS)
    assert found.age_s == pytest.approx(0.1)
    assert found.readings == 1
    assert receiver_.measurement(100 * MS).readings == 0


def test_one_level_frame_alone_is_not_a_measurement() -> None:
    receiver_, _ = receiver()
    receiver_.take(frame("LowerLevels", 0), 0)
    found = receiver_.measurement(MS)
    assert found.age_s == math.inf
    assert found.valid == (True, True, False, False)
    assert found.readings == 0


@pytest.mark.parametrize("channel", range(4))
@pytest.mark.parametrize(
    ("reading", "is_valid"),
    [(0.0, False), (0.4998, False), (0.5, True), (9.5, True), (9.5002, False), (10.24, False)],
)
def test_a_reading_outside_of_the_sensors_range_is_not_valid_whatever_the_node_says(
    channel: int, reading: float, is_valid: bool
) -> None:
    receiver_, _ = receiver((0.5, 9.5))
    levels = [5.0] * 4
    levels[channel] = reading
    feed_levels(receiver_, 0, 0, levels)
    assert receiver_.measurement(MS).valid == tuple(is_valid if i == channel else True for i in range(4))


@pytest.mark.parametrize("channel", range(4))
@pytest.mark.parametrize("status", range(4))
def test_only_status_ok_vouches_for_a_channel(channel: int, status: int) -> None:
    receiver_, _ = receiver()
    statuses = [0] * 4
    statuses[channel] = status
    feed_levels(receiver_, 0, 0, statuses=statuses)
    assert receiver_.measurement(MS).valid == tuple(status == 0 if i == channel else True for i in range(4))


def test_validity_is_that_of_the_newest_reading() -> None:
    receiver_, _ = receiver()
    feed_levels(receiver_, 0, 0, statuses=(0, 3, 0, 0))
    feed_levels(receiver_, 1, 20 * MS)
    assert receiver_.measurement(20 * MS).valid == (True,) * 4
    feed_levels(receiver_, 2, 40 * MS, statuses=(0, 3, 0, 0))
    assert receiver_.measurement(40 * MS).valid == (True, False, True, True)


# pump status, heartbeats, commands of others


def test_status_is_what_the_node_last_said() -> None:
    receiver_, _ = receiver()
    receiver_.take(frame("PumpStatus", 0, State=1), 0)
    receiver_.take(frame("PumpStatus", 1, Applied1=1.5, Applied2=2.5, State=3, TripCause=1), 50 * MS)
    pumps = receiver_.pumps(80 * MS)
    assert pumps.applied_V == pytest.approx((1.5, 2.5))
    assert pumps.state is NodeState.TRIPPED
    assert pumps.trip_cause == 1
    assert pumps.age_s == pytest.approx(0.03)


@pytest.mark.parametrize("state", list(NodeState))
def test_every_node_state_is_known(state: NodeState) -> None:
    receiver_, _ = receiver()
    receiver_.take(frame("PumpStatus", 0, State=int(state)), 0)
    assert receiver_.pumps(0).state is state


@pytest.mark.parametrize("silent", ["PumpHeartbeat", "LevelHeartbeat"])
def test_both_nodes_have_to_beat(silent: str) -> None:
    other = "LevelHeartbeat" if silent == "PumpHeartbeat" else "PumpHeartbeat"
    receiver_, _ = receiver()
    receiver_.take(frame(other, 0), 0)
    assert receiver_.nodes(0).age_s == math.inf
    receiver_.take(frame(silent, 0), 0)
    receiver_.take(frame(other, 1), 100 * MS)
    health = receiver_.nodes(150 * MS)
    assert health.age_s == pytest.approx(0.15)
    assert health.contract_matches
    assert not health.rebooted


@pytest.mark.parametrize("name", ["PumpHeartbeat", "LevelHeartbeat"])
@pytest.mark.parametrize(("first", "then"), [(1, 2), (65535, 0), (5, 4), (0, 1)])
def test_a_changed_boot_count_is_a_reboot_for_ever(name: str, first: int, then: int) -> None:
    receiver_, _ = receiver()
    receiver_.take(frame(name, 0, BootCount=first), 0)
    receiver_.take(frame(name, 1, BootCount=first), 100 * MS)
    assert not receiver_.nodes(100 * MS).rebooted
    receiver_.take(frame(name, 2, BootCount=then), 200 * MS)
    assert receiver_.nodes(200 * MS).rebooted
    receiver_.take(frame(name, 3, BootCount=then), 300 * MS)
    assert receiver_.nodes(300 * MS).rebooted
    receiver_.take(frame(name, 4, BootCount=first), 400 * MS)
    assert receiver_.nodes(400 * MS).rebooted


@pytest.mark.parametrize("name", ["PumpHeartbeat", "LevelHeartbeat"])
def test_a_node_with_another_contract_is_noticed(name: str) -> None:
    receiver_, _ = receiver()
    receiver_.take(frame("PumpHeartbeat", 0), 0)
    receiver_.take(frame("LevelHeartbeat", 0), 0)
    receiver_.take(frame(name, 1, Contract=CONTRACT.fingerprint ^ 1), 100 * MS)
    assert not receiver_.nodes(100 * MS).contract_matches
    receiver_.take(frame(name, 2), 200 * MS)
    assert receiver_.nodes(200 * MS).contract_matches


def test_a_command_of_somebody_else_is_noticed() -> None:
    receiver_, _ = receiver()
    receiver_.take(frame("PumpCommand", 0, Enable=0), 0)
    assert receiver_.bus(0, 0, is_up=True).foreign_commands == 1
    broken = frame("PumpCommand", 1)
    broken.data[0] ^= 1
    receiver_.take(broken, MS)
    assert receiver_.bus(0, 0, is_up=True).foreign_commands == 1


def test_bus_health_passes_on_what_the_port_knows() -> None:
    receiver_, _ = receiver()
    receiver_.take(frame("PumpStatus", 0), 0)
    receiver_.take(message(5, b""), 0)
    health = receiver_.bus(0, 3, is_up=False)
    assert (health.accepted, health.rejected, health.send_failures, health.is_up) == (1, 1, 3, False)


# echoes


def status(
    receiver_: Receiver, counter: int, echo: int, accepted: int, applied: Pair = (3.0, 4.0), at_ns: int = 0
) -> None:
    values = {"Echo": echo, "Accepted": accepted % 256, "Applied1": applied[0], "Applied2": applied[1]}
    assert receiver_.take(frame("PumpStatus", counter % 16, **values), at_ns) is None


def test_shortfall_is_against_the_command_that_the_node_echoes() -> None:
    receiver_, sender = receiver()
    sender.encode(go(3.0, 4.0), 0)
    sender.encode(go(9.0, 9.0), 0)
    status(receiver_, 0, echo=0, accepted=1, applied=(2.5, 4.0))
    assert receiver_.pumps(0).shortfall_V == pytest.approx((0.5, 0.0))
    status(receiver_, 1, echo=1, accepted=2, applied=(8.0, 8.5))
    assert receiver_.pumps(0).shortfall_V == pytest.approx((1.0, 0.5))
    status(receiver_, 2, echo=1, accepted=2, applied=(9.0, 9.0))
    assert receiver_.pumps(0).shortfall_V == pytest.approx((0.0, 0.0))


def test_a_disabled_command_asks_for_0_volts() -> None:
    receiver_, sender = receiver()
    sender.encode(go(3.0, 4.0, enable=False), 0)
    status(receiver_, 0, echo=0, accepted=1, applied=(0.0, 0.2))
    assert receiver_.pumps(0).shortfall_V == pytest.approx((0.0, -0.2))


def test_a_node_that_has_accepted_nothing_confirms_nothing() -> None:
    receiver_, sender = receiver()
    sender.encode(go(), 0)
    status(receiver_, 0, echo=0, accepted=0, applied=(0.0, 0.0))
    pumps = receiver_.pumps(70 * MS)
    assert pumps.unechoed_s == pytest.approx(0.07)
    assert pumps.shortfall_V == (0.0, 0.0)
