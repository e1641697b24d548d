"""Commands that the pump node must accept or refuse, at 0 V; a frame with a voltage is never enabled.

A frame that must be refused is sent directly after a valid one, so that its counter would be the next one.
"""

from __future__ import annotations

from collections.abc import Callable

from hil.conformance.dialogue import CommandFrame, Dialogue, differences
from hil.core.types import NodeState
from hil.doctor.check_watchdog import WATCHDOG_S

READY, RUN = NodeState.READY, NodeState.RUN
MAX_RAW = 50_000
NEWER_STEPS = range(1, 9)
OLD_STEPS = range(9, 16)


def takes_valid(node: Dialogue) -> str:
    """Twenty commands with consecutive counters: all are counted, the last one is echoed."""
    reply = node.send(*(node.valid() for _ in range(20)), gap_s=0.01)
    return differences(reply, accepted=20, echo=node.probe.counter, state=READY, highest_V=0.0)


def runs_when_enabled(node: Dialogue) -> str:
    """Enable = 1 at 0 V: run. Enable = 0: ready, no trip."""
    wrong = differences(node.send(node.valid(enable=True)), accepted=1, state=RUN, highest_V=0.0)
    return wrong or differences(node.send(node.valid()), accepted=1, state=READY, cause=0, highest_V=0.0)


def takes_newer(node: Dialogue) -> str:
    """A counter increased by 1 to 8 is new: frames in between were lost."""
    for step in NEWER_STEPS:
        frames = (node.valid(), node.valid(counter=node.probe.next_counter + step - 1))
        if wrong := differences(node.send(*frames), accepted=2, echo=node.probe.counter):
            return f"step {step}: {wrong}"
    return ""


def refuses_repeated(node: Dialogue) -> str:
    """The same counter again is the same frame."""
    return _refuses_step(node, 0)


def refuses_old(node: Dialogue) -> str:
    """A counter increased by 9 to 15 is an old one."""
    return next((wrong for step in OLD_STEPS if (wrong := _refuses_step(node, step))), "")


def resynchronises(node: Dialogue) -> str:
    """After more than 250 ms without an accepted command any counter is accepted."""
    node.send(node.valid())
    node.silence(WATCHDOG_S + 0.1)
    reply = node.send(node.valid(counter=node.probe.next_counter + 11))
    return differences(reply, accepted=1, echo=node.probe.counter, state=READY)


def refuses_wrong_crc(node: Dialogue) -> str:
    """A wrong CRC byte, or one without the data id."""

    def frames() -> list[CommandFrame]:
        body = node.body()
        right = node.sealed(body).data[-1]
        wrong_crcs = {right ^ 0x01, right ^ 0xFF, node.sealed(body, crc_start=0xFF).data[-1]}
        return [CommandFrame(body + bytes((crc,))) for crc in sorted(wrong_crcs)]

    return _refuses(node, frames)


def refuses_flipped_bits(node: Dialogue) -> str:
    """A disabled command with one bit flipped, for each bit."""

    def frames() -> list[CommandFrame]:
        data = node.sealed(node.body(enable=False)).data
        whole, length = int.from_bytes(data, "little"), len(data)
        return [CommandFrame((whole ^ 1 << bit).to_bytes(length, "little")) for bit in range(8 * length)]

    return _refuses(node, frames)


def refuses_other_data_id(node: Dialogue) -> str:
    """The CRC of each other frame: a payload with the wrong identifier."""
    others = [spec for spec in node.probe.contract.frames.values() if spec is not node.spec]
    return _refuses(node, lambda: [node.sealed(node.body(), other.crc_start) for other in others])


def refuses_wrong_length(node: Dialogue) -> str:
    """0 to 8 bytes except 6, with a right CRC in the last one; and a valid frame with more bytes after it."""
    lengths = (1, 2, 3, 4, 5, 7, 8)

    def frames() -> list[CommandFrame]:
        body = node.body()
        sealed = [node.sealed(body.ljust(length - 1, b"\0")[: length - 1]) for length in lengths]
        return [CommandFrame(b""), *sealed, *(CommandFrame(node.sealed(body).data + bytes(more)) for more in (1, 2))]

    return _refuses(node, frames)


def refuses_extended(node: Dialogue) -> str:
    """A 29-bit identifier of the same number."""
    return _refuses(node, lambda: [CommandFrame(node.sealed(node.body()).data, is_extended=True)])


def refuses_remote(node: Dialogue) -> str:
    """A remote frame of the same identifier and length."""
    return _refuses(node, lambda: [CommandFrame(bytes(node.spec.length), is_remote=True)])


def refuses_out_of_range(node: Dialogue) -> str:
    """More than 10 V on either pump, by one step and by the maximum; disabled, so that no pump can run."""
    raws = ((MAX_RAW + 1, 0), (0, MAX_RAW + 1), (0xFFFF, 0), (0, 0xFFFF))
    return _refuses(node, lambda: [node.sealed(node.body(raw, enable=False)) for raw in raws])


def ignores_spare_bits(node: Dialogue) -> str:
    """Bits 34 and 35 are reserved: set, they change nothing."""
    frame = node.sealed(node.body(enable=False, spare=0b11))
    node.probe.counter = node.probe.next_counter
    return differences(node.send(frame), accepted=1, echo=node.probe.counter, state=READY)


def stays_ready(node: Dialogue) -> str:
    """A node that is not enabled does not trip without commands."""
    node.send(node.valid())
    return differences(node.silence(2 * WATCHDOG_S), accepted=0, state=READY, cause=0, highest_V=0.0)


def _refuses_step(node: Dialogue, step: int) -> str:
    valid = node.valid()
    wrong = differences(
        node.send(valid, node.stale(step)), accepted=1, echo=node.probe.counter, state=READY, highest_V=0.0
    )
    return f"step {step}: {wrong}" if wrong else ""


def _refuses(node: Dialogue, frames: Callable[[], list[CommandFrame]]) -> str:
    """None of these frames may be counted, echoed or change the state; a valid one after them is accepted.

    They are made after the valid one before them was sent, so that their counter is the next one, and only their error
    can be the reason to refuse them.
    """
    valid = node.valid()
    last = node.probe.counter
    wrong = differences(node.send(valid, *frames()), accepted=1, echo=last, state=READY, highest_V=0.0)
    return wrong or differences(node.send(node.valid()), accepted=1, echo=node.probe.counter, state=READY)
