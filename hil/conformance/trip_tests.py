"""The watchdog's trip: which frames do not prevent it, that it is latched, and how it is cleared. All at 0 V."""

from __future__ import annotations

from collections.abc import Callable

from hil.conformance.dialogue import CommandFrame, Dialogue, differences
from hil.core.types import NodeState
from hil.doctor.check_watchdog import TOLERANCE_S, TRIPPED_BY_WATCHDOG, WATCHDOG_S
from hil.probe.observation import STATUS

READY, RUN, TRIPPED = NodeState.READY, NodeState.RUN, NodeState.TRIPPED
FEED_S, FRAMES = 0.04, 5
LATCHED_S = 1.0
MAX_ALONE_S = 2.0
"""A watchdog that is slower than this counts as none; its own test says what is wrong with it."""


def is_not_fed_by_refused(node: Dialogue) -> str:
    """While it runs, it receives only refused frames of one kind: its watchdog must trip when it trips in silence.

    Their counters differ, so that a node that accepts one by mistake also accepts the next one.
    """
    kinds: dict[str, Callable[[int], CommandFrame]] = {
        "a wrong CRC": lambda number: CommandFrame(_body_and_crc(node, number, 0xFF)),
        "a repeated counter": lambda _: node.stale(0),
        "an old counter": lambda number: node.stale(15 - number),  # older and older
        "a wrong length": lambda number: _too_long(node, number),
        "a voltage out of range": lambda number: node.sealed(node.body((50_001, 0), enable=False, ahead=number)),
    }
    alone_s = _trips_alone_after_s(node)
    if alone_s is None:
        return f"it does not trip within {MAX_ALONE_S:g} s of silence either: see the watchdog's test"
    wait_s = max(WATCHDOG_S, alone_s) + TOLERANCE_S + node.cycle_s
    for what, made in kinds.items():
        if not node.settle():
            return "the node can't be brought to ready"
        node.send(node.valid(enable=True))
        sent_ns = node.probe.send(node.valid(enable=True).data)
        for number in range(FRAMES):
            node.probe.listen(FEED_S)
            node.probe.send(made(number).data)
        node.probe.listen_until(sent_ns + round(wait_s * 1e9))
        status = node.probe.listener.observed(sent_ns, node.probe.now_ns).last(STATUS)
        state = None if status is None else NodeState(int(status.values["State"]))
        if state is not TRIPPED:
            return f"still in state {state.name.lower() if state is not None else '?'}: {what} prevents the trip"
    return ""


def _trips_alone_after_s(node: Dialogue) -> float | None:
    """When the first status with "tripped" comes if nothing is sent; None if none comes within MAX_ALONE_S."""
    node.settle()
    node.send(node.valid(enable=True))
    sent_ns = node.probe.send(node.valid(enable=True).data)
    tripped = node.probe.await_status(MAX_ALONE_S, lambda status: int(status.values["State"]) == TRIPPED)
    return None if tripped is None else (tripped.t_ns - sent_ns) * 1e-9


def _body_and_crc(node: Dialogue, ahead: int, flip: int = 0) -> bytes:
    body = node.body(ahead=ahead)
    return body + bytes((node.sealed(body).data[-1] ^ flip,))


def _too_long(node: Dialogue, number: int) -> CommandFrame:
    """Alternately a valid frame with one more byte, and seven bytes with the right CRC at their end."""
    body = node.body(ahead=number)
    return CommandFrame(node.sealed(body).data + b"\0") if number % 2 else node.sealed(body + b"\0")


def is_latched(node: Dialogue) -> str:
    """Tripped, it accepts and echoes commands, enabled or not, stays tripped at 0 V and keeps the cause."""
    reply = node.trip()
    wrong = differences(reply, state=TRIPPED, cause=TRIPPED_BY_WATCHDOG, highest_V=0.0)
    if wrong:
        return wrong
    steps = round(LATCHED_S / 0.1)
    frames = [node.valid(enable=number % 2 == 0) for number in range(steps)]
    reply = node.send(*frames, gap_s=0.1)
    return differences(
        reply, accepted=steps, echo=node.probe.counter, state=TRIPPED, cause=TRIPPED_BY_WATCHDOG, highest_V=0.0
    )


def clear_must_be_at_rest(node: Dialogue) -> str:
    """ClearTrip with Enable = 1, or with a voltage on either pump, is accepted and clears nothing."""
    node.trip()
    for what, frame in (
        ("Enable = 1", node.valid(enable=True, clear=True)),
        ("0.2 V on pump 1", node.valid((0.2, 0.0), clear=True)),
        ("0.2 V on pump 2", node.valid((0.0, 0.2), clear=True)),
    ):
        if wrong := differences(node.send(frame), accepted=1, state=TRIPPED, cause=TRIPPED_BY_WATCHDOG, highest_V=0.0):
            return f"with {what}: {wrong}"
    return ""


def clears(node: Dialogue) -> str:
    """ClearTrip, Enable = 0, 0 V: ready, no cause, and it stays there without further commands."""
    node.trip()
    wrong = differences(node.send(node.valid(clear=True)), accepted=1, state=READY, cause=0, highest_V=0.0)
    return wrong or differences(node.silence(2 * WATCHDOG_S), accepted=0, state=READY, cause=0, highest_V=0.0)


def clear_is_harmless(node: Dialogue) -> str:
    """ClearTrip without a trip acts like any other command of 0 V."""
    return differences(node.send(node.valid(clear=True)), accepted=1, state=READY, cause=0, highest_V=0.0)


def clear_is_ignored_in_run(node: Dialogue) -> str:
    """ClearTrip while it runs is ignored: the node goes on with the rest of the command, enabled at 0 V."""
    frames = [node.valid(enable=True), node.valid(enable=True, clear=True)]
    reply = node.send(*frames)
    wrong = differences(reply, accepted=2, echo=node.probe.counter, state=RUN, cause=0, highest_V=0.0)
    return wrong or differences(node.send(node.valid()), accepted=1, state=READY, cause=0, highest_V=0.0)
