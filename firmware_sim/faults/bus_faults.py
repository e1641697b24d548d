"""Faults of the bus as a whole: unknown senders, error frames, bus-off."""

from collections.abc import Callable
from typing import Annotated, Literal

from can import Message

from firmware_sim.faults.base import FailureWord, FaultTable, Volt
from firmware_sim.faults.effects import NS_PER_S, Effects, Source
from firmware_sim.faults.episode import Episode
from firmware_sim.frames import COMMAND_ID, Frame, pack_command
from firmware_sim.setting_types import named, within

FOREIGN_ID = 0x7A5
TOP_ID = 0x000
FULL_LOAD_PER_S = 3700.0
COMMANDS_PER_S = 10.0

Rate = Annotated[float, within(0.1, 4000.0)]


class Babble(FaultTable):
    """An unknown node sends `value` frames/s with random data.

    Target "foreign" (the default): identifier 0x7A5, of lower priority than all frames of the bench. "top": 0x000, of
    higher priority than all; from 3700 frames/s on, which is all that 500 kbit/s can carry, no other frame gets
    through, in either direction.
    """

    acts_on = "bus"
    unit = "frames/s"
    grows_from = "0"
    words = (FailureWord("bus", "babble", target="foreign"), FailureWord("bus", "flood", target="top"))

    kind: Literal["babble"]
    target: Annotated[str, named("foreign", "top")] = "foreign"
    value: Rate

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Add the unknown sender."""
        can_id = TOP_ID if self.target == "top" else FOREIGN_ID
        random = episode.random

        def frame(now_ns: int, counter: int) -> Message:
            del counter
            return Frame(now_ns / NS_PER_S, can_id, is_extended_id=False, data=random.bytes(8), is_rx=False)

        rate_per_s = episode.grown(0.0, self.value)
        _add_source(effects, f"babble {self.target}", episode, rate_per_s, frame)
        if self.target == "top":
            effects.is_jammed = rate_per_s >= FULL_LOAD_PER_S


class ForeignCommand(FaultTable):
    """Another controller commands `value` V on both pumps, 10 times a second, with a counter that is accepted."""

    acts_on = "bus"
    unit = "V"
    words = (FailureWord("bus", "command", target="PumpCommand"),)

    kind: Literal["foreign_command"]
    target: Annotated[str, named("PumpCommand")] = "PumpCommand"
    value: Volt

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Add the other controller."""
        voltage_V = self.value

        def frame(now_ns: int, counter: int) -> Message:
            data = pack_command((voltage_V, voltage_V), counter)
            return Frame(now_ns / NS_PER_S, COMMAND_ID, is_extended_id=False, data=data, is_rx=False)

        _add_source(effects, "foreign_command", episode, COMMANDS_PER_S, frame)


class ErrorFrames(FaultTable):
    """`value` error frames/s on the bus. An slcan adapter cannot report them."""

    acts_on = "bus"
    unit = "frames/s"
    grows_from = "0"
    words = (FailureWord("bus", "errors"),)

    kind: Literal["error_frames"]
    target: Annotated[str, named("all")] = "all"
    value: Rate

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Add the source of error frames."""

        def frame(now_ns: int, counter: int) -> Message:
            del counter
            return Frame(now_ns / NS_PER_S, 0, is_extended_id=False, is_error_frame=True, data=bytes(8), is_rx=False)

        _add_source(effects, "error_frames", episode, episode.grown(0.0, self.value), frame)


class BusOff(FaultTable):
    """No frame goes out or comes in."""

    acts_on = "bus"
    words = (FailureWord("bus", "off"),)

    kind: Literal["bus_off"]
    target: Annotated[str, named("all")] = "all"

    def apply(self, effects: Effects, episode: Episode) -> None:
        """Cut the bus."""
        del episode
        effects.is_bus_off = True


def _add_source(
    effects: Effects, name: str, episode: Episode, rate_per_s: float, frame: Callable[[int, int], Message]
) -> None:
    """Add the sender of an episode, which keeps its place in time when its rate changes; none at a rate of 0."""
    if rate_per_s <= 0.0:
        return
    period_ns = round(NS_PER_S / rate_per_s)
    source = episode.memory(lambda: Source(period_ns, episode.begin_ns, frame))
    if source.period_ns != period_ns:
        source.set_period(period_ns)
    effects.sources[name] = source
