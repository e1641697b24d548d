"""The pump node's outputs, with pumps: 1 V on one, 0.5 V on both; only after all other tests have passed."""

from __future__ import annotations

from hil.conformance.dialogue import CommandFrame, Dialogue, differences
from hil.core.counted import counted
from hil.core.types import NodeState, Pair
from hil.doctor.check_watchdog import TOLERANCE_S, TRIPPED_BY_WATCHDOG, WATCHDOG_S
from hil.probe.bus_probe import OFF_V
from hil.probe.observation import STATUS

RUN, TRIPPED = NodeState.RUN, NodeState.TRIPPED
TOLERANCE_V = 0.05
PERIOD_S = 0.05
HOLD_S = 0.5
TRIED_V: tuple[Pair, ...] = ((0.5, 0.0), (1.0, 0.0), (0.0, 0.5), (0.0, 1.0), (0.5, 0.5))
LOW_V: Pair = (0.5, 0.5)


def applies(node: Dialogue) -> str:
    """The commanded voltage is applied within 0.05 V; disabled, both outputs are at 0 V in the second status after."""
    for voltage_V in TRIED_V:
        node.probe.drive(lambda _, voltage_V=voltage_V: voltage_V, HOLD_S, PERIOD_S)  # type: ignore[misc]
        reply = node.send(node.valid(voltage_V, enable=True), gap_s=0.0)
        if reply.state is not RUN or not _is_near(reply.applied_V, voltage_V):
            return f"{reply.applied_V} V in state {reply.state.name.lower()} for a command of {voltage_V} V"
    return differences(node.send(node.valid()), applied_V=OFF_V, state=NodeState.READY)


def refuses_while_running(node: Dialogue) -> str:
    """Running at 0.5 V, an enabled frame of 10.0002 V, or of 1 V with a wrong CRC or counter, moves nothing."""
    node.probe.drive(lambda _: LOW_V, HOLD_S, PERIOD_S)
    fresh = node.valid(LOW_V, enable=True)
    one = node.body((5000, 5000))
    frames = (
        fresh,
        node.sealed(node.body((50_001, 50_001))),
        CommandFrame(one + bytes((node.sealed(one).data[-1] ^ 0x01,))),
        CommandFrame(node.probe.payload((1.0, 1.0), enable=True, counter=node.probe.counter)),
    )
    reply = node.send(*frames)
    node.probe.command()
    if reply.accepted != 1 or max(abs(reply.highest_V - LOW_V[0]), abs(reply.applied_V[0] - LOW_V[0])) > TOLERANCE_V:
        accepted = counted(reply.accepted, "frame")
        return f"{accepted} accepted instead of 1, up to {reply.highest_V:.4g} V applied instead of 0.5 V"
    return ""


def trips_to_zero(node: Dialogue) -> str:
    """From 0.5 V the watchdog takes both outputs to 0 V."""
    node.probe.drive(lambda _: LOW_V, HOLD_S, PERIOD_S)
    sent_ns = node.probe.command(LOW_V, enable=True)
    node.probe.listen(WATCHDOG_S + 3 * node.cycle_s)
    latest_s = WATCHDOG_S + TOLERANCE_S + node.cycle_s
    for status in node.probe.listener.observed(sent_ns, node.probe.now_ns).of(STATUS):
        t_s = (status.t_ns - sent_ns) * 1e-9
        if t_s > latest_s and (status.values["Applied1"], status.values["Applied2"]) != OFF_V:
            return f"still a voltage {t_s * 1e3:.0f} ms after the last command"
    return differences(node.send(node.valid()), state=TRIPPED, cause=TRIPPED_BY_WATCHDOG, applied_V=OFF_V)


def never_moves_after_a_trip(node: Dialogue) -> str:
    """Tripped, it accepts enabled commands of 0.5 V and 1 V and applies nothing."""
    node.trip()
    frames = [node.valid(voltage_V, enable=True) for voltage_V in (LOW_V, (1.0, 1.0)) for _ in range(5)]
    reply = node.send(*frames, gap_s=PERIOD_S)
    return differences(reply, accepted=len(frames), state=TRIPPED, applied_V=OFF_V, highest_V=0.0)


def _is_near(applied_V: Pair, wanted_V: Pair) -> bool:
    return all(abs(a - w) <= TOLERANCE_V for a, w in zip(applied_V, wanted_V, strict=True))
