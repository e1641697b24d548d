"""Faults of the bus as a whole: strangers on it, disturbances, and the end of it."""

from collections.abc import Callable
from typing import Annotated, Literal

from can import Message

from firmware_sim.faults.base import FaultTable, Volt
from firmware_sim.faults.effects import NS_PER_S, Effects, Episode, Source
from firmware_sim.frames import COMMAND_ID, Frame, pack_command
from firmware_sim.setting_types import named, within

FOREIGN_ID = 0x7A5
TOP_ID = 0x000
FULL_LOAD_PER_S = 3700.0
COMMANDS_PER_S = 10.0

Rate = Annotated[float, within(0.1, 4000.0)]


class Babble(FaultTable):
    """A stranger sends `value` frames/s with random data.

    Target "foreign" (the default): under 0x7A5, which gives way to all of ours. "top": under 0x000, to which all give
    way; from 3700 frames/s on, which is all that 500 kbit/s can carry, nothing else gets through, either way.
    """

    kind: Literal["babble"]
    target: Annotated[str, named("foreign", "top")] = "foreign"
    value: Rate

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Put the stranger on the bus."""
        can_id = TOP_ID if self.target == "top" else FOREIGN_ID
        random = episode.random

        def frame(now_ns: int, counter: int) -> Message:
            del counter
            return Frame(now_ns / NS_PER_S, can_id, is_extended_id=False, data=random.bytes(8), is_rx=False)

        effects.sources[f"babble {self.target}"] = _source(episode, self.value, frame)
        if self.target == "top":
            effects.is_jammed = self.value >= FULL_LOAD_PER_S


class ForeignCommand(FaultTable):
    """Somebody else commands `value` V on both pumps, ten times a second, in frames that the pump node accepts."""

    kind: Literal["foreign_command"]
    target: Annotated[str, named("PumpCommand")] = "PumpCommand"
    value: Volt

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Put the other controller on the bus."""
        voltage_V = self.value

        def frame(now_ns: int, counter: int) -> Message:
            data = pack_command((voltage_V, voltage_V), counter)
            return Frame(now_ns / NS_PER_S, COMMAND_ID, is_extended_id=False, data=data, is_rx=False)

        effects.sources["foreign_command"] = _source(episode, COMMANDS_PER_S, frame)


class ErrorFrames(FaultTable):
    """`value` error frames/s. An slcan adapter has no way to report them."""

    kind: Literal["error_frames"]
    target: Annotated[str, named("all")] = "all"
    value: Rate

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Put the disturbance on the bus."""

        def frame(now_ns: int, counter: int) -> Message:
            del counter
            return Frame(now_ns / NS_PER_S, 0, is_extended_id=False, is_error_frame=True, data=bytes(8), is_rx=False)

        effects.sources["error_frames"] = _source(episode, self.value, frame)


class BusOff(FaultTable):
    """Nothing goes out or comes in any more."""

    kind: Literal["bus_off"]
    target: Annotated[str, named("all")] = "all"

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Cut the bus."""
        del episode
        effects.is_bus_off = True


def _source(episode: Episode, rate_per_s: float, frame: Callable[[int, int], Message]) -> Source:
    return episode.memory(lambda: Source(round(NS_PER_S / rate_per_s), episode.begin_ns, frame))


BUS_KINDS: tuple[type[FaultTable], ...] = (Babble, ForeignCommand, ErrorFrames, BusOff)
