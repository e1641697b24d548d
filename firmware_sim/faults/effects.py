"""What the faults that are active now do to the rig. Faults write here; plant and nodes read here.

Lists are in the order pump 1, 2 or tank 1, 2, 3, 4. A new `Effects` is a healthy rig.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from can import Message

from firmware_sim.frames import ChannelStatus

NS_PER_S = 1_000_000_000

Reading = tuple[float, ChannelStatus]


@dataclass(frozen=True, slots=True)
class Codes:
    """The codes of a converter: 0 .. top, each worth step_V."""

    top: int
    step_V: float


class Override(Protocol):
    """Replaces a channel's reading."""

    def __call__(self, fresh: Reading, last: Reading | None, codes: Codes) -> Reading:
        """Return the reading to send for a fresh one and the one that was sent last."""


class Stage(Protocol):
    """A step through which a frame passes on the faulty wire."""

    def __call__(self, frame: Message) -> list[Message]:
        """Return the frames to pass on in its place, now."""

    def rest(self) -> list[Message]:
        """Return the frames that are still held back, when the fault ends."""


@dataclass(eq=False)
class Source:
    """An unknown sender: a frame every period_ns, made from the time in ns and the counter of the next command."""

    period_ns: int
    next_ns: int
    frame: Callable[[int, int], Message]

    def set_period(self, period_ns: int) -> None:
        """Send the next frames at another period, counted from the last one."""
        self.next_ns += period_ns - self.period_ns
        self.period_ns = period_ns

    def skip_to(self, now_ns: int) -> None:
        """Skip the frames that were due before now."""
        if self.next_ns < now_ns:
            self.next_ns += -((self.next_ns - now_ns) // self.period_ns) * self.period_ns


@dataclass(frozen=True, slots=True)
class Change:
    """A quantity of the rig on its way from its own value to another one. share : of the way, 0 .. 1."""

    value: float
    share: float = 1.0

    def of(self, own: float) -> float:
        """The quantity now, from its value in a healthy rig."""
        return self.value if self.share >= 1.0 else own + (self.value - own) * self.share


@dataclass
class ChannelEffects:
    """What is wrong with one level channel: an added signal in V, then what replaces the converter's reading."""

    bias_V: float = 0.0
    drift_V: Callable[[int], float] | None = None
    noise_V: Callable[[], float] | None = None
    overrides: list[Override] = field(default_factory=list)

    def signal(self, now_ns: int) -> float:
        """Signal on top of the sensor's own, in V; draws the next noise."""
        added_V = self.bias_V
        if self.drift_V is not None:
            added_V += self.drift_V(now_ns)
        if self.noise_V is not None:
            added_V += self.noise_V()
        return added_V

    def replaced(self, fresh: Reading, last: Reading | None, codes: Codes) -> Reading:
        """Reading after all overrides; each is called, the result of the last one is used."""
        reading = fresh
        for override in self.overrides:
            reading = override(fresh, last, codes)
        return reading


@dataclass
class Effects:
    """Everything that is wrong now; a healthy rig by default.

    effectiveness : share of a pump's flow that is left. stuck_on_V : what a pump gets whatever its node puts out.
    lag_s : the change of a pump's lag. valve_split : the change of a pump's gamma. is_dry : whether the pumps move air.
    leak : area of a hole as a share of the tank's outlet. blocked : share of the outlet that is shut.
    channels : level channels with faults, by index 0 .. 3. stages, delay_ns : what frames pass through, by identifier
    (stages in the order of their numbers). muted : identifiers that are blocked. is_bus_off : all are blocked.
    is_jammed : only the sources get through. sources : unknown senders. reboots : a node's last loss of power and when
    it came back, in ns. wall_ahead_ns : by how much a node's wall clock is ahead.
    """

    effectiveness: list[float] = field(default_factory=lambda: [1.0, 1.0])
    stuck_on_V: list[float | None] = field(default_factory=lambda: [None, None])
    lag_s: list[Change | None] = field(default_factory=lambda: [None, None])
    valve_split: list[Change | None] = field(default_factory=lambda: [None, None])
    is_dry: bool = False
    leak: list[float] = field(default_factory=lambda: [0.0] * 4)
    blocked: list[float] = field(default_factory=lambda: [0.0] * 4)
    channels: dict[int, ChannelEffects] = field(default_factory=dict)
    stages: dict[int, dict[int, Stage]] = field(default_factory=dict)
    delay_ns: dict[int, int] = field(default_factory=dict)
    muted: set[int] = field(default_factory=set)
    is_bus_off: bool = False
    is_jammed: bool = False
    sources: dict[str, Source] = field(default_factory=dict)
    reboots: dict[str, tuple[int, int]] = field(default_factory=dict)
    wall_ahead_ns: dict[str, int] = field(default_factory=dict)

    def channel(self, tank: int) -> ChannelEffects:
        """Effects on the level channel of tank 1 .. 4, made when first asked for."""
        return self.channels.setdefault(tank - 1, ChannelEffects())
