"""The pump node: every state times every event, watchdog, latch, resynchronisation, converter."""

import pytest
from can import Message
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.frames import COMMAND_ID, NodeState, Rejection, TripCause
from firmware_sim.pump_node import Change, PumpNode, quantised
from tests.firmware_sim.sim_bench import MS, command, command_bytes, emulator, frame_of
from tests.narrowing import not_none

BOOT, READY, RUN, TRIPPED = NodeState
BOOT_NS = 200 * MS
WATCHDOG_NS = 250 * MS
T0 = 1000 * MS
EXACT = emulator(pumps={"dac_bits": 0})


def node_in(state: NodeState, changes: list[Change] | None = None) -> PumpNode:
    """A node that has been brought into a state by T0; the last accepted counter (if any) is 0."""
    node = PumpNode(EXACT, 0, (changes if changes is not None else []).append)
    if state is BOOT:
        return node
    node.run_event(BOOT_NS)
    if state is TRIPPED:
        node.receive(command(3.0, 4.0), T0 - WATCHDOG_NS - MS)
        node.run_event(T0 - MS)
    elif state is RUN:
        node.receive(command(3.0, 4.0), T0)
    assert node.state is state
    return node


OFF = (0.0, 0.0)
EVENTS = {
    "enable": command(1.0, 2.0, counter=1),
    "enable and clear": command(1.0, 2.0, clear=True, counter=1),
    "enable at 0 V": command(counter=1),
    "disable": command(enable=False, counter=1),
    "disable with voltage": command(1.0, 2.0, enable=False, counter=1),
    "clear": command(enable=False, clear=True, counter=1),
    "clear with voltage": command(0.0, 0.0002, enable=False, clear=True, counter=1),
    "out of range": command(10.0002, 0.0, counter=1),
    "broken": frame_of(command_bytes(1.0, 2.0, counter=1)[:5] + command_bytes(1.0, 2.0, counter=2)[5:]),
    "foreign": frame_of(b"\1\2", can_id=0x123),
    "error frame": Message(is_error_frame=True),
    "nothing": None,
}
TABLE = {
    (READY, "enable"): (RUN, (1.0, 2.0)),
    (READY, "enable and clear"): (RUN, (1.0, 2.0)),
    (READY, "enable at 0 V"): (RUN, OFF),
    (RUN, "enable"): (RUN, (1.0, 2.0)),
    (RUN, "enable and clear"): (RUN, (1.0, 2.0)),
    (RUN, "enable at 0 V"): (RUN, OFF),
    (RUN, "disable"): (READY, OFF),
    (RUN, "disable with voltage"): (READY, OFF),
    (RUN, "clear"): (READY, OFF),
    (RUN, "clear with voltage"): (READY, OFF),
    (TRIPPED, "clear"): (READY, OFF),
}


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("state", NodeState)
def test_every_state_times_every_event(state: NodeState, event: str) -> None:
    node = node_in(state)
    expected = TABLE.get((state, event), (state, node.applied_V))
    frame = EVENTS[event]
    if frame is not None:
        node.receive(frame, T0 if state is not BOOT else 0)
    assert (node.state, node.applied_V) == expected
    assert (node.trip_cause is TripCause.WATCHDOG) == (node.state is TRIPPED)


@pytest.mark.parametrize("state", NodeState)
def test_a_rejected_frame_changes_nothing_but_its_count(state: NodeState) -> None:
    node = node_in(state)
    before = (node.state, node.applied_V, node.accepted, node.lost, node.next_event_ns)
    for event, cause in [
        ("broken", Rejection.CRC),
        ("out of range", Rejection.RANGE),
        ("foreign", Rejection.FOREIGN),
        ("error frame", Rejection.ERROR),
    ]:
        assert node.receive(not_none(EVENTS[event]), T0) is cause
        assert node.rejected[cause] == 1
    assert (node.state, node.applied_V, node.accepted, node.lost, node.next_event_ns) == before


def test_boots_at_zero_volts_and_takes_no_command_before_it_is_ready() -> None:
    node = node_in(BOOT)
    assert node.applied_V == OFF
    assert node.next_event_ns == BOOT_NS
    assert node.receive(command(3.0, 3.0), BOOT_NS - 1) is Rejection.BOOT
    node.run_event(BOOT_NS - 1)
    assert node.state is BOOT
    node.run_event(BOOT_NS)
    assert (node.state, node.applied_V) == (READY, OFF)


def test_watchdog_fires_exactly_at_its_deadline() -> None:
    node = node_in(RUN)
    assert node.next_event_ns == T0 + WATCHDOG_NS
    node.run_event(T0 + WATCHDOG_NS - 1)
    assert node.state is RUN
    node.run_event(T0 + WATCHDOG_NS)
    assert (node.state, node.applied_V, node.trip_cause) == (TRIPPED, OFF, TripCause.WATCHDOG)


def test_only_an_accepted_command_feeds_the_watchdog() -> None:
    node = node_in(RUN)
    node.receive(not_none(EVENTS["broken"]), T0 + 100 * MS)
    node.receive(command(3.0, 4.0, counter=0), T0 + 100 * MS)
    assert node.next_event_ns == T0 + WATCHDOG_NS
    node.receive(command(3.0, 4.0, counter=1), T0 + 100 * MS)
    assert node.next_event_ns == T0 + 100 * MS + WATCHDOG_NS


@pytest.mark.parametrize("state", [READY, TRIPPED])
def test_watchdog_sleeps_outside_run(state: NodeState) -> None:
    assert node_in(state).next_event_ns is None


def test_a_trip_is_latched_against_everything_but_a_clear() -> None:
    node = node_in(TRIPPED)
    for counter in range(1, 40):
        node.receive(command(5.0, 5.0, clear=counter % 2 == 0, counter=counter % 16), T0 + counter * 100 * MS)
        assert (node.state, node.applied_V) == (TRIPPED, OFF)
    node.receive(command(enable=False, clear=True, counter=8), T0 + 4000 * MS)
    assert node.state is READY
    node.receive(command(5.0, 5.0, counter=9), T0 + 4100 * MS)
    assert (node.state, node.applied_V) == (RUN, (5.0, 5.0))


def test_commands_are_accepted_and_echoed_while_tripped() -> None:
    node = node_in(TRIPPED)
    node.receive(command(5.0, 5.0, counter=7), T0)
    status = node.status()
    assert node.accepted == 2
    assert status[5] & 0x0F == 7
    assert status[6] == 2


@pytest.mark.parametrize("step", range(16))
def test_counter_decides_while_the_link_is_fresh(step: int) -> None:
    node = node_in(RUN)
    rejection = node.receive(command(1.0, 1.0, counter=step), T0 + WATCHDOG_NS)
    expected = Rejection.DUPLICATE if step == 0 else None if step <= 8 else Rejection.OLD
    assert rejection is expected
    assert node.lost == (step - 1 if expected is None else 0)
    assert node.applied_V == ((1.0, 1.0) if expected is None else (3.0, 4.0))


@pytest.mark.parametrize("counter", range(16))
def test_any_counter_is_taken_first_and_after_a_silence(counter: int) -> None:
    fresh = node_in(READY)
    assert fresh.receive(command(1.0, 1.0, counter=counter), T0) is None
    silent = node_in(RUN)
    silent.run_event(T0 + WATCHDOG_NS)
    assert silent.receive(command(1.0, 1.0, counter=counter), T0 + WATCHDOG_NS + 1) is None
    assert silent.lost == 0


def test_changes_are_reported_with_their_causes() -> None:
    changes: list[Change] = []
    node = node_in(RUN, changes)
    node.receive(command(3.0, 4.0, counter=1), T0 + MS)
    node.receive(command(2.0, 4.0, counter=2), T0 + 2 * MS)
    node.receive(command(enable=False, counter=3), T0 + 3 * MS)
    node.receive(command(1.0, 1.0, counter=4), T0 + 4 * MS)
    node.run_event(T0 + 300 * MS)
    node.receive(command(enable=False, clear=True), T0 + 400 * MS)
    node.power_off(T0 + 500 * MS)
    causes = ["boot", "booted", "command", "command", "disabled", "command", "watchdog", "cleared", "shutdown"]
    assert [change.cause for change in changes] == causes
    assert [change.applied_V for change in changes[2:4]] == [(3.0, 4.0), (2.0, 4.0)]


@pytest.mark.parametrize(("state", "after"), [(BOOT, BOOT), (READY, READY), (RUN, READY), (TRIPPED, TRIPPED)])
def test_power_off_puts_out_zero_volts_from_every_state(state: NodeState, after: NodeState) -> None:
    changes: list[Change] = []
    node = node_in(state, changes)
    node.power_off(T0)
    assert (node.state, node.applied_V) == (after, OFF)
    assert (changes[-1].cause, changes[-1].applied_V) == ("shutdown", OFF)


def test_counters_of_sent_frames_rise_and_wrap() -> None:
    node = node_in(READY)
    assert [node.status()[5] >> 4 for _ in range(18)] == [*range(16), 0, 1]
    assert [node.heartbeat()[0] >> 4 for _ in range(18)] == [*range(16), 0, 1]


@given(st.integers(0, 50_000), st.sampled_from([8, 10, 12, 14, 16]))
def test_dac_is_off_by_half_a_step_at_most(raw: int, bits: int) -> None:
    voltage = raw / 5000
    step = 10.0 / (2**bits - 1)
    output = quantised(voltage, bits)
    assert abs(output - voltage) <= step / 2 + 1e-12
    assert output / step == pytest.approx(round(output / step), abs=1e-6)


@pytest.mark.parametrize("bits", [0, 8, 10, 12, 14, 16])
def test_dac_reaches_both_ends_exactly(bits: int) -> None:
    assert quantised(0.0, bits) == 0.0
    assert quantised(10.0, bits) == 10.0


def test_every_single_bit_error_on_the_wire_leaves_a_running_node_alone() -> None:
    node = node_in(RUN)
    data = command_bytes(1.0, 2.0, counter=1)
    for bit in range(48):
        broken = bytearray(data)
        broken[bit // 8] ^= 1 << bit % 8
        node.receive(frame_of(bytes(broken), can_id=COMMAND_ID), T0 + bit)
    assert node.applied_V == (3.0, 4.0)
    assert node.rejected[Rejection.CRC] == 48
