"""Faults of single frames between a node and the wire. Target: a frame's name in the contract, or "all".

PumpCommand is changed on its way to the pump node, all others on their way to the bus. Different kinds act together, in
the order of `STAGE_ORDER`; with "all", each frame has its own counts.
"""

from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from can import Message

from firmware_sim.faults.base import FailureWord, FaultTable, Share, kind_of
from firmware_sim.faults.effects import NS_PER_S, Effects, Stage
from firmware_sim.faults.episode import Episode
from firmware_sim.frames import COUNTER_AT, FRAME_IDS, remade, sealed
from firmware_sim.setting_types import named, whole, within

MAX_FLIPS = 3
OTHER_ID_BIT = 0x008
STAGE_ORDER = (
    "counter_stuck",
    "wrong_length",
    "wrong_id",
    "extended_id",
    "remote_frame",
    "frame_corrupt",
    "frame_loss",
    "frame_burst",
    "frame_duplicate",
    "frame_reorder",
)

FrameName = Annotated[str, named(*FRAME_IDS, "all")]


class FrameFault(FaultTable):
    """A fault of frames: each target frame gets a stage of its own, which lives as long as the fault."""

    acts_on = "frame"
    targets_text = 'a frame\'s name, or "all"'

    target: FrameName

    @property
    def can_ids(self) -> tuple[int, ...]:
        """Identifiers of the target frames."""
        return tuple(FRAME_IDS.values()) if self.target == "all" else (FRAME_IDS[self.target],)

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Add a stage for every target frame."""
        stages: dict[int, Stage] = episode.memory(dict)
        rank = STAGE_ORDER.index(kind_of(type(self)))
        for can_id in self.can_ids:
            if can_id not in stages:
                stages[can_id] = self.stage(can_id, episode)
            effects.stages.setdefault(can_id, {})[rank] = stages[can_id]

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Build what one frame passes through."""
        raise NotImplementedError


class FrameLoss(FrameFault):
    """Each frame is lost with probability `value`."""

    unit = "probability"
    grows_from = "0"
    words = (FailureWord("frames", "off", 1.0), FailureWord("frames", "intermittent"))

    kind: Literal["frame_loss"]
    value: Share

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Lose frames at random."""
        del can_id
        return _Sieve(lambda: episode.grown(0.0, self.value), episode.random)


class FrameBurst(FrameFault):
    """The next `value` frames in a row are lost, of each target frame; then the fault is over."""

    unit = "frames"
    words = (FailureWord("frames", "burst"),)

    kind: Literal["frame_burst"]
    value: Annotated[int, whole(1, 100_000)]

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Lose a number of frames."""
        del can_id, episode
        return _Gap(self.value)


class FrameDelay(FrameFault):
    """Every frame arrives `value` s later; the order is kept."""

    unit = "s"
    grows_from = "0"
    words = (FailureWord("frames", "delayed"),)

    kind: Literal["frame_delay"]
    value: Annotated[float, within(0.0, 60.0)]

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Set the delay of every target frame."""
        delay_s = episode.grown(0.0, self.value)
        effects.delay_ns |= dict.fromkeys(self.can_ids, round(delay_s * NS_PER_S))


class FrameDuplicate(FrameFault):
    """Every frame is sent twice."""

    words = (FailureWord("frames", "duplicate"),)

    kind: Literal["frame_duplicate"]

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Double frames."""
        del can_id, episode
        return _Each(lambda frame: [frame, frame])


class FrameReorder(FrameFault):
    """Frames are swapped in pairs: the second comes first, the first immediately after it."""

    words = (FailureWord("frames", "reorder"),)

    kind: Literal["frame_reorder"]

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Swap frames."""
        del can_id, episode
        return _Swap()


class FrameCorrupt(FrameFault):
    """With probability `value` one to three random bits of the payload flip; the CRC always detects that."""

    unit = "probability"
    grows_from = "0"
    words = (FailureWord("frames", "garbage", 1.0),)

    kind: Literal["frame_corrupt"]
    value: Share

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Flip bits at random."""
        del can_id
        return _Flip(lambda: episode.grown(0.0, self.value), episode.random)


class CounterStuck(FrameFault):
    """The counter keeps the value of the first frame; data are fresh and the CRC is right."""

    words = (FailureWord("frames", "stuck"),)

    kind: Literal["counter_stuck"]

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Freeze the counter."""
        del episode
        return _Freeze(can_id)


class WrongLength(FrameFault):
    """The payload is cut or padded to `value` bytes; without a value, or at its length, it is a byte too short."""

    unit = "bytes"
    words = (FailureWord("frames", "short"),)

    kind: Literal["wrong_length"]
    value: Annotated[int, whole(0, 8)] | None = None

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Cut or pad the payload."""
        del can_id, episode

        def resized(frame: Message) -> list[Message]:
            right = len(frame.data)
            length = right - 1 if self.value is None or self.value == right else self.value
            return [remade(frame, data=bytes(frame.data[:length]).ljust(length, b"\0"))]

        return _Each(resized)


class WrongId(FrameFault):
    """A frame has identifier `value`; without a value, its own with bit 3 flipped."""

    unit = "identifier"
    words = (FailureWord("frames", "wrong"),)

    kind: Literal["wrong_id"]
    value: Annotated[int, whole(0, 0x7FF)] | None = None

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Change the identifier."""
        del episode
        other = can_id ^ OTHER_ID_BIT if self.value is None else self.value
        return _Each(lambda frame: [remade(frame, can_id=other)])


class ExtendedId(FrameFault):
    """A frame has a 29-bit identifier of the same number."""

    words = (FailureWord("frames", "extended"),)

    kind: Literal["extended_id"]

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Make frames extended."""
        del can_id, episode
        return _Each(lambda frame: [remade(frame, is_extended=True)])


class RemoteFrame(FrameFault):
    """A frame becomes a remote frame of the same identifier and length, without data."""

    words = (FailureWord("frames", "remote"),)

    kind: Literal["remote_frame"]

    def stage(self, can_id: int, episode: Episode) -> Stage:
        """Make frames remote."""
        del can_id, episode
        return _Each(lambda frame: [remade(frame, is_remote=True)])


class _Each:
    """A stage without memory."""

    def __init__(self, change: Callable[[Message], list[Message]]) -> None:
        self._change = change

    def __call__(self, frame: Message) -> list[Message]:
        return self._change(frame)

    def rest(self) -> list[Message]:
        return []


class _Sieve(_Each):
    def __init__(self, probability: Callable[[], float], random: np.random.Generator) -> None:
        super().__init__(lambda frame: [] if random.random() < probability() else [frame])


class _Gap(_Each):
    def __init__(self, length: int) -> None:
        self._left = length
        super().__init__(self._pass)

    def _pass(self, frame: Message) -> list[Message]:
        if self._left == 0:
            return [frame]
        self._left -= 1
        return []


class _Swap(_Each):
    def __init__(self) -> None:
        self._held: list[Message] = []
        super().__init__(self._swap)

    def _swap(self, frame: Message) -> list[Message]:
        if self._held:
            return [frame, *self.rest()]
        self._held = [frame]
        return []

    def rest(self) -> list[Message]:
        held, self._held = self._held, []
        return held


class _Flip(_Each):
    def __init__(self, probability: Callable[[], float], random: np.random.Generator) -> None:
        self._probability = probability
        self._random = random
        super().__init__(self._flip)

    def _flip(self, frame: Message) -> list[Message]:
        bits = 8 * len(frame.data)
        if bits == 0 or self._random.random() >= self._probability():
            return [frame]
        data = bytearray(frame.data)
        count = int(self._random.integers(1, MAX_FLIPS + 1))
        for bit in self._random.choice(bits, size=count, replace=False).tolist():
            data[bit // 8] ^= 1 << bit % 8
        return [remade(frame, data=bytes(data))]


class _Freeze(_Each):
    def __init__(self, can_id: int) -> None:
        self._can_id = can_id
        self._at, self._shift = COUNTER_AT[can_id]
        self._counter: int | None = None
        super().__init__(self._freeze)

    def _freeze(self, frame: Message) -> list[Message]:
        data = bytearray(frame.data)
        if len(data) <= self._at + 1:
            return [frame]
        if self._counter is None:
            self._counter = data[self._at] >> self._shift & 0x0F
        data[self._at] = data[self._at] & ~(0x0F << self._shift) & 0xFF | self._counter << self._shift
        return [remade(frame, data=sealed(self._can_id, bytes(data[:-1])))]
