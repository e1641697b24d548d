"""Controller and emulator in step on a simulated clock: every frame encoded, sent on a virtual bus, checked, decoded.

The same loop, wire and nodes as in real time, but faster, and with the same bytes for the same seed. See
docs/decisions/0007-lean-virtual-bus.md.
"""

from __future__ import annotations

from collections.abc import Callable

from firmware_sim.ports import BusPort as EmulatorPort
from hil.core.types import Timing
from hil.edge.can.bus import BusPort
from hil.loop import ControlLoop, Outcome

NO_DELAY = Timing()


def run(
    loop: ControlLoop,
    port: BusPort,
    emulator: EmulatorPort,
    period_s: float,
    on_progress: Callable[[int], None] | None = None,
    *,
    start_ns: int = 0,
    stop_reason: Callable[[], str] = lambda: "",
) -> Outcome:
    """Run to the end.

    port, emulator : the two ends of one virtual bus that keeps time stamps. on_progress : called every 100 steps with
    the number of steps done. start_ns : time of the first step, to which the emulator has advanced at the most.
    stop_reason : returns "" until a stop is requested.

    A step at time t receives what the nodes sent up to t; its command takes effect at t.
    """
    period_ns = round(period_s * 1e9)
    now_ns, number = start_ns, 0
    while loop.outcome is None:
        emulator.step(now_ns)
        for frame in port.waiting():
            loop.receive(frame, round(frame.timestamp * 1e9))
        loop.tick(now_ns, NO_DELAY, stop_reason())
        emulator.read(now_ns)
        now_ns += period_ns
        number += 1
        if on_progress is not None and number % 100 == 0:
            on_progress(number)
    return loop.outcome
