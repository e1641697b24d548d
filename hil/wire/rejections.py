"""What was rejected, for a person: how many frames, of which identifier, why, and what to do about it.

See docs/decisions/0001-wire.md for the checks that a frame must pass.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from hil.core.counted import counted
from hil.wire.contract import Contract
from hil.wire.frame_check import Frame, Rejection

CANOPEN_HEARTBEAT_BASE, CANOPEN_NODE_ID_MAX = 0x700, 127
"""CiA 301: the heartbeat of a CANopen node has one byte and the identifier 0x700 + node id, 1 to 127."""
MAX_KEYS = 256
"""Different identifiers, causes and lengths that are counted apart; later ones are counted together."""

_Key = tuple[int, Rejection, int]
_OTHERS: _Key = (-1, Rejection.UNKNOWN_ID, 0)


class RejectedFrames:
    """Counts rejected frames by identifier, cause and, where the length is wrong, length."""

    def __init__(self, contract: Contract) -> None:
        self._lengths = {spec.frame_id: spec.length for spec in contract.frames.values()}
        self._counts: Counter[_Key] = Counter()
        self._changes = 0
        self._summary = (0, "")

    def add(self, frame: Frame, cause: Rejection) -> None:
        """Count one frame."""
        key = (frame.arbitration_id, cause, len(frame.data) if cause is Rejection.LENGTH else 0)
        if cause is Rejection.ERROR_FRAME:
            key = (-1, cause, 0)
        if key not in self._counts and len(self._counts) >= MAX_KEYS:
            key = _OTHERS
        self._counts[key] += 1
        self._changes += 1

    def summary(self) -> str:
        """All counts in words, the most frequent identifier first; "" for none. Built only after a change."""
        if self._changes != self._summary[0]:
            self._summary = self._changes, self._words()
        return self._summary[1]

    def _words(self) -> str:
        frame_ids = Counter[int]()
        for (frame_id, _, _), number in self._counts.items():
            frame_ids[frame_id] += number
        parts = [self._of(frame_id) for frame_id, _ in frame_ids.most_common() if frame_id >= 0]
        others, errors = self._counts[_OTHERS], self._counts[(-1, Rejection.ERROR_FRAME, 0)]
        if others:
            parts.append(f"{counted(others, 'frame', form=',')} of other identifiers")
        if errors:
            parts.append(counted(errors, "error frame", form=","))
        return "; ".join(parts)

    def _of(self, frame_id: int) -> str:
        causes = Counter[Rejection]()
        lengths = Counter[int]()
        for (of_id, cause, length), number in self._counts.items():
            if of_id == frame_id:
                causes[cause] += number
                if cause is Rejection.LENGTH:
                    lengths[length] += number
        return frames_rejected(frame_id, causes, lengths, self._lengths.get(frame_id))


def frames_rejected(
    frame_id: int, causes: Mapping[Rejection, int], lengths: Mapping[int, int], length: int | None
) -> str:
    """Say what was rejected of one identifier, and who may have sent it.

    causes : numbers by cause. lengths : numbers by length in bytes, of frames whose length is wrong. length : the right
    one; None when the identifier is none of ours.
    """
    by_number = sorted(causes.items(), key=lambda item: -item[1])
    numbers = ", ".join(f"{number:,} {cause.value.replace('_', ' ')}" for cause, number in by_number if number)
    text = f"frames of {frame_id:#05x} rejected: {numbers}"
    if not lengths or length is None:
        return text
    return f"{text} ({wrong_length(frame_id, lengths, length)}); {other_sender(frame_id, lengths)}"


def wrong_length(frame_id: int, lengths: Mapping[int, int], length: int) -> str:
    """Say how long the frames were, in bytes, and what such frames usually are."""
    seen = ", ".join(f"{size}" for size in sorted(lengths))
    text = f"{seen} {'byte' if seen == '1' else 'bytes'} instead of {length}"
    return f"{text}, like a CANopen heartbeat" if _is_like_heartbeat(frame_id, lengths) else text


def other_sender(frame_id: int, lengths: Mapping[int, int]) -> str:
    """Say who sends frames of a wrong length under this identifier, and what to do.

    CAN itself protects the length, so a bad cable is not the cause.
    """
    if _is_like_heartbeat(frame_id, lengths):
        return (
            f"another node on the bus uses the identifier {frame_id:#05x}: "
            f"give it another CANopen node id than {frame_id - CANOPEN_HEARTBEAT_BASE}, or take it off this bus"
        )
    return (
        f"another node on the bus uses the identifier {frame_id:#05x}: take it off this bus; "
        "or ours was built for another DBC"
    )


def _is_like_heartbeat(frame_id: int, lengths: Mapping[int, int]) -> bool:
    return 1 in lengths and 0 < frame_id - CANOPEN_HEARTBEAT_BASE <= CANOPEN_NODE_ID_MAX


def lines_rejected(counts: Mapping[str, int]) -> str:
    """Say what an slcan adapter has refused and what was rejected of its lines; "" for nothing.

    counts : "refused", "dropped" and "rejected_CAUSE", as `SlcanBus.counts` has them.
    """
    rejected = {
        name.removeprefix("rejected_"): number
        for name, number in counts.items()
        if name.startswith("rejected_") and number
    }
    parts = []
    if rejected:
        by_number = sorted(rejected.items(), key=lambda item: -item[1])
        numbers = ", ".join(f"{number:,} {cause}" for cause, number in by_number)
        parts.append(f"{counted(sum(rejected.values()), 'line', form=',')} rejected: {numbers}")
    if counts.get("refused"):
        parts.append(f"{counted(counts['refused'], 'command', form=',')} refused by the adapter")
    if counts.get("dropped"):
        not_sent = counted(counts["dropped"], "command", form=",")
        parts.append(f"{not_sent} not sent: the line was full or the adapter no longer answered")
    return "; ".join(parts)
