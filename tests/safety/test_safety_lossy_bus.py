"""Heartbeats on a bus that loses frames, and silence once somebody else commands the pumps."""

import pytest

from hil.core import supervisor
from hil.core.interlocks import LOSSY_AGE_FACTOR
from hil.core.supervisor import Supervision
from hil.core.types import Mode, TripCause
from hil.wire.command_sender import CommandSender
from hil.wire.receiver import LOSSY_NS, Receiver
from tests.safety.safety_bench import CONTRACT, HEALTHY, LIMITS, MS, PERIOD_NS, LoopBench, but, raw_command


@pytest.mark.parametrize(
    ("is_lossy", "age_s", "trips"),
    [(False, 0.25, False), (False, 0.2501, True), (True, 0.2501, False), (True, 0.75, False), (True, 0.7501, True)],
)
def test_a_heartbeat_may_be_three_times_as_old_on_a_lossy_bus(is_lossy: bool, age_s: float, trips: bool) -> None:
    assert LIMITS.heartbeat_age_max_s * LOSSY_AGE_FACTOR == pytest.approx(0.75)
    inputs = but(HEALTHY, "nodes", age_s=age_s, is_lossy=is_lossy)
    state, _ = supervisor.next_mode(LIMITS, Supervision(mode=Mode.RUNNING), inputs, 0)
    assert (state.mode is Mode.TRIPPED, state.cause is TripCause.NODE_LOST) == (trips, trips)


def test_a_bus_is_lossy_for_two_seconds_after_a_frame_was_missing() -> None:
    frames = LoopBench()
    receiver = Receiver(CONTRACT, CommandSender(CONTRACT), (0.0, 10.24))

    def hear(counter: int, at_ns: int) -> bool:
        frames.counter = counter
        for frame in frames.frames().values():
            receiver.take(frame, at_ns)
        return receiver.nodes(at_ns).is_lossy

    assert not hear(0, 0)
    assert not hear(1, 100 * MS)
    assert hear(3, 200 * MS)
    assert receiver.nodes(200 * MS + LOSSY_NS).is_lossy
    assert not receiver.nodes(200 * MS + LOSSY_NS + 1).is_lossy


def test_after_somebody_elses_command_0_volts_are_sent_once_and_then_nothing() -> None:
    """0 V again and again would keep the node's watchdog from tripping it."""
    bench = LoopBench().run()
    bench.loop.receive(raw_command(9.0, 9.0), bench.now_ns + MS)
    before = len(bench.port.sent)
    bench.step(6)
    assert len(bench.port.sent) == before + 1
    assert (bench.last.voltage_V, bench.last.enable) == ((0.0, 0.0), False)
    assert bench.last.at_ns == bench.now_ns - 5 * PERIOD_NS
    bench.loop.make_safe(bench.now_ns)
    assert len(bench.port.sent) == before + 2, "the very end of the process says it once more"
