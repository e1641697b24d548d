"""Controller and emulator in step on a simulated clock: every frame encoded, sent on a virtual bus, checked, decoded.

The same loop, wire and nodes as live, only faster, and the same to the byte for the same seed.
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
) -> Outcome:
    """Run to the end.

    port, emulator : two ends of one virtual bus that keeps timestamps. on_progress : gets the number of steps made.

    A step at time t sees what the nodes sent up to t; its command takes effect at t.
    """
    period_ns = round(period_s * 1e9)
    now_ns = number = 0
    while loop.outcome is None:
        emulator.step(now_ns)
        for frame in port.waiting():
            loop.receive(frame, round(frame.timestamp * 1e9))
        loop.tick(now_ns, NO_DELAY)
        emulator.read(now_ns)
        now_ns += period_ns
        number += 1
        if on_progress is not None and number % 100 == 0:
            on_progress(number)
    return loop.outcome
