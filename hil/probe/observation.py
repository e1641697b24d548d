"""Frames received from the bus: accepted ones with their time, checked as in a run; refused ones with the cause."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from hil.wire.contract import Contract, Decoded
from hil.wire.frame_check import Frame, FrameCheck, Rejection

COMMAND = "PumpCommand"
STATUS = "PumpStatus"
LEVEL_FRAMES = {"LowerLevels": (1, 2), "UpperLevels": (3, 4)}
HEARTBEATS = {"pump node": "PumpHeartbeat", "level node": "LevelHeartbeat"}


@dataclass(frozen=True, slots=True)
class Arrival:
    """One accepted frame. lost : number of frames of its identifier missing directly before it, by the counter.

    Also after a longer silence, when a run accepts any counter: lost heartbeats would not be counted otherwise.
    """

    name: str
    t_ns: int
    values: Decoded
    lost: int


@dataclass(frozen=True, slots=True)
class Refusal:
    """One refused frame. name : "" if the bench has no such frame. length : of its data, in bytes."""

    name: str
    t_ns: int
    why: Rejection
    length: int


@dataclass(frozen=True)
class Observation:
    """The frames of a period of time on the bus, from begin_ns to end_ns."""

    contract: Contract
    begin_ns: int
    end_ns: int
    arrivals: tuple[Arrival, ...]
    refusals: tuple[Refusal, ...]

    @property
    def duration_s(self) -> float:
        """Length of the period in s."""
        return (self.end_ns - self.begin_ns) * 1e-9

    def of(self, name: str) -> list[Arrival]:
        """Accepted frames of this name, in order of arrival."""
        return [arrival for arrival in self.arrivals if arrival.name == name]

    def last(self, name: str) -> Arrival | None:
        """The newest accepted frame of this name, or None."""
        return next((arrival for arrival in reversed(self.arrivals) if arrival.name == name), None)

    def lost(self, name: str) -> int:
        """Number of frames of this name missing by their counters."""
        return sum(arrival.lost for arrival in self.of(name))

    def refused(self, name: str) -> Counter[Rejection]:
        """Refused frames of this name, by cause."""
        return Counter(refusal.why for refusal in self.refusals if refusal.name == name)

    def wrong_lengths(self, name: str) -> Counter[int]:
        """Refused frames of this name whose length is wrong, by their length in bytes."""
        return Counter(
            refusal.length for refusal in self.refusals if refusal.name == name and refusal.why is Rejection.LENGTH
        )


class Listener:
    """Checks frames as `hil.wire.receiver` does, and keeps all of them with their monotonic times of arrival."""

    def __init__(self, contract: Contract) -> None:
        self._contract = contract
        self._checks = {spec.frame_id: FrameCheck(spec) for spec in contract.frames.values()}
        self._arrivals: list[Arrival] = []
        self._refusals: list[Refusal] = []
        self._newest: dict[str, Arrival] = {}

    def take(self, frame: Frame, received_ns: int) -> Arrival | None:
        """Take one frame from the bus; return None if it is refused."""
        check = self._checks.get(frame.arbitration_id)
        if frame.is_error_frame or check is None:
            why = Rejection.ERROR_FRAME if frame.is_error_frame else Rejection.UNKNOWN_ID
            self._refusals.append(Refusal("", received_ns, why, len(frame.data)))
            return None
        values = check.admit(frame, received_ns)
        if isinstance(values, Rejection):
            self._refusals.append(Refusal(check.spec.name, received_ns, values, len(frame.data)))
            return None
        before = self._newest.get(check.spec.name)
        step = (int(values["Counter"]) - int(before.values["Counter"])) % 16 if before is not None else 1
        arrival = Arrival(check.spec.name, received_ns, values, max(step - 1, 0))
        self._arrivals.append(arrival)
        self._newest[arrival.name] = arrival
        return arrival

    def newest(self, name: str) -> Arrival | None:
        """The newest accepted frame of this name."""
        return self._newest.get(name)

    def observed(self, begin_ns: int, end_ns: int) -> Observation:
        """The frames from begin_ns to end_ns, both included."""
        return Observation(
            self._contract,
            begin_ns,
            end_ns,
            tuple(arrival for arrival in self._arrivals if begin_ns <= arrival.t_ns <= end_ns),
            tuple(refusal for refusal in self._refusals if begin_ns <= refusal.t_ns <= end_ns),
        )
