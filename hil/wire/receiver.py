"""From frames to the inputs of a control step: newest levels with their age, the pump node's feedback, heartbeats.

See docs/decisions/0001-wire.md.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf, nan

from hil.core.sensors import LevelSensors
from hil.core.types import BusHealth, Measurement, NodeHealth, NodeState, Pair, PumpFeedback
from hil.wire.command_sender import CommandSender
from hil.wire.contract import Contract, Decoded
from hil.wire.frame_check import Frame, FrameCheck, Rejection
from hil.wire.rejections import RejectedFrames

CHANNEL_OK = 0
UNKNOWN = (nan, nan)
SECOND_NS = 1_000_000_000
LOSSY_NS = 2 * SECOND_NS
"""After a lost frame the bus counts as lossy for so long; with 5 % loss that is nearly always."""
MAX_ERRORS = 1000
"""At most so many error frames within a second are counted."""


@dataclass(slots=True)
class LevelPair:
    """Readings of one level frame: the newest ones, runs up to them, and sums since the last step.

    Only valid readings are summed. moved_V2, jumped_V2 : sum and maximum of the squared differences between consecutive
    readings.
    """

    names: tuple[str, str, str, str]
    range_V: Pair
    received_ns: int = -1
    newest_V: Pair = UNKNOWN
    sum_V: Pair = (0.0, 0.0)
    sum_V2: Pair = (0.0, 0.0)
    frames: int = 0
    counts: tuple[int, int] = (0, 0)
    moved_V2: Pair = (0.0, 0.0)
    jumped_V2: Pair = (0.0, 0.0)
    repeats: tuple[int, int] = (0, 0)
    invalid_run: tuple[int, int] = (1, 1)

    def take(self, values: Decoded, received_ns: int) -> None:
        """Add one accepted frame."""
        first, second, status1, status2 = self.names
        a, b = values[first], values[second]
        low, high = self.range_V
        (last_a, last_b), (same_a, same_b), (bad_a, bad_b) = self.newest_V, self.repeats, self.invalid_run
        self.repeats = (same_a + 1 if a == last_a else 0, same_b + 1 if b == last_b else 0)
        self.invalid_run = (
            0 if values[status1] == CHANNEL_OK and low <= a <= high else bad_a + 1,
            0 if values[status2] == CHANNEL_OK and low <= b <= high else bad_b + 1,
        )
        self.newest_V = (a, b)
        da, db = (a - last_a) ** 2, (b - last_b) ** 2
        (sum_a, sum_b), (top_a, top_b) = self.moved_V2, self.jumped_V2
        self.moved_V2 = (sum_a + da, sum_b + db)
        self.jumped_V2 = (da if da > top_a else top_a, db if db > top_b else top_b)
        self.frames += 1
        self.received_ns = received_ns
        if self.invalid_run != (0, 0):
            first_counts, second_counts = (bad == 0 for bad in self.invalid_run)
            self._add(a * first_counts, b * second_counts, int(first_counts), int(second_counts))
            return
        self._add(a, b, 1, 1)

    def _add(self, a: float, b: float, first: int, second: int) -> None:
        self.sum_V = (self.sum_V[0] + a, self.sum_V[1] + b)
        self.sum_V2 = (self.sum_V2[0] + a * a, self.sum_V2[1] + b * b)
        self.counts = (self.counts[0] + first, self.counts[1] + second)

    def summary(self) -> tuple[Pair, Pair, Pair]:
        """Mean and variance of the valid readings since the last call, and their jitter. Resets the sums.

        Without valid readings the mean is the newest reading; with too few, variance and jitter are NaN.
        """
        (m1, s1), (m2, s2) = (self._channel(0), self._channel(1))
        n = self.frames
        jitter = UNKNOWN
        if n > 1:
            (sum1, sum2), (top1, top2) = self.moved_V2, self.jumped_V2
            jitter = ((sum1 - top1) / (2 * n - 2), (sum2 - top2) / (2 * n - 2))
        self.sum_V = self.sum_V2 = self.moved_V2 = self.jumped_V2 = (0.0, 0.0)
        self.frames = 0
        self.counts = (0, 0)
        return (m1, m2), (s1, s2), jitter

    def _channel(self, which: int) -> tuple[float, float]:
        """Mean in V and variance in V^2 of one channel."""
        n = self.counts[which]
        if n == 0:
            return self.newest_V[which], nan
        mean = self.sum_V[which] / n
        return mean, max(self.sum_V2[which] - n * mean * mean, 0.0) / (n - 1) if n > 1 else nan


@dataclass(slots=True)
class Beat:
    """One node's heartbeat: its last time, its boot count, and whether it rebooted or has another contract."""

    received_ns: int = -1
    boot_count: int = -1
    rebooted: bool = False
    contract_matches: bool = True


class Receiver:
    """Checks and decodes the bench's frames; holds the inputs of the next control step."""

    def __init__(
        self, contract: Contract, sender: CommandSender, sensor_range_V: Pair, sensors: LevelSensors | None = None
    ) -> None:
        """sensor_range_V : readings outside it are not valid, even if the node reports them as valid.

        sensors : what the readings mean; None: level signals are the readings.
        """
        self._sensors = sensors or LevelSensors()
        self._checks = tuple(FrameCheck(spec) for spec in contract.frames.values())
        self._fingerprint = contract.fingerprint
        self._sender = sender
        self._lower = LevelPair(("Level1", "Level2", "Status1", "Status2"), sensor_range_V)
        self._upper = LevelPair(("Level3", "Level4", "Status3", "Status4"), sensor_range_V)
        self._pump_beat, self._level_beat = Beat(), Beat()
        self._status_ns = -1
        self._applied_V: Pair = UNKNOWN
        self._shortfall_V: Pair = (0.0, 0.0)
        self._state = NodeState.BOOT
        self._trip_cause = 0
        take: dict[str, Callable[[Decoded, int], None]] = {
            "LowerLevels": self._lower.take,
            "UpperLevels": self._upper.take,
            "PumpStatus": self._take_status,
            "PumpCommand": self._take_command,
            "PumpHeartbeat": partial(self._take_heartbeat, self._pump_beat),
            "LevelHeartbeat": partial(self._take_heartbeat, self._level_beat),
        }
        self._routes = {check.spec.frame_id: (check, take[check.spec.name]) for check in self._checks}
        self._worst_run = 0
        self._errors_ns: deque[int] = deque(maxlen=MAX_ERRORS)
        self._lost_before = 0
        self._lossy_until_ns = -1
        self.rejections: Counter[Rejection] = Counter()
        self._rejected_frames = RejectedFrames(contract)
        self.accepted = 0
        self.foreign_commands = 0

    def take(self, frame: Frame, received_ns: int) -> Rejection | None:
        """Take one frame with its monotonic time of arrival; return why it was refused, or None."""
        rejection = self._take(frame, received_ns)
        if rejection is None:
            self.accepted += 1
        else:
            self.rejections[rejection] += 1
            self._rejected_frames.add(frame, rejection)
        return rejection

    @property
    def lost(self) -> int:
        """Number of frames missing by their counters."""
        return sum(check.lost for check in self._checks)

    def _take(self, frame: Frame, received_ns: int) -> Rejection | None:
        if frame.is_error_frame:
            self._errors_ns.append(received_ns)
            return Rejection.ERROR_FRAME
        known = self._routes.get(frame.arbitration_id)
        if known is None:
            return Rejection.UNKNOWN_ID
        check, take = known
        values = check.admit(frame, received_ns)
        if check.refused_run > self._worst_run:
            self._worst_run = check.refused_run
        if isinstance(values, Rejection):
            return values
        take(values, received_ns)
        return None

    def _take_command(self, values: Decoded, received_ns: int) -> None:  # noqa: ARG002 - signature of the routes
        self.foreign_commands += 1

    def _take_status(self, values: Decoded, received_ns: int) -> None:
        self._status_ns = received_ns
        self._applied_V = (values["Applied1"], values["Applied2"])
        self._state = NodeState(int(values["State"]))
        self._trip_cause = int(values["TripCause"])
        echoed = self._sender.echo(int(values["Echo"]), int(values["Accepted"]))
        if echoed is not None:
            asked = echoed.voltage_V if echoed.enable else (0.0, 0.0)
            self._shortfall_V = (asked[0] - self._applied_V[0], asked[1] - self._applied_V[1])

    def _take_heartbeat(self, beat: Beat, values: Decoded, received_ns: int) -> None:
        boot_count = int(values["BootCount"])
        beat.rebooted |= beat.boot_count not in (-1, boot_count)
        beat.boot_count = boot_count
        beat.contract_matches = int(values["Contract"]) == self._fingerprint
        beat.received_ns = received_ns

    def measurement(self, now_ns: int) -> Measurement:
        """The level signals for the step at now_ns; resets the sums. All checks are those of the readings."""
        lower, upper = self._lower, self._upper
        readings = min(lower.frames, upper.frames)
        (y1, y2), (s1, s2), (j1, j2) = lower.summary()
        (y3, y4), (s3, s4), (j3, j4) = upper.summary()
        (bad1, bad2), (bad3, bad4) = lower.invalid_run, upper.invalid_run
        measurement = Measurement(
            (y1, y2, y3, y4),
            (bad1 == 0, bad2 == 0, bad3 == 0, bad4 == 0),
            _age_s(now_ns, lower, upper),
            readings,
            (s1, s2, s3, s4),
            (j1, j2, j3, j4),
            (*lower.repeats, *upper.repeats),
            (bad1, bad2, bad3, bad4),
        )
        return self._sensors.level_signals(measurement)

    def pumps(self, now_ns: int) -> PumpFeedback:
        """The pump node's newest status."""
        age_s = (now_ns - self._status_ns) * 1e-9 if self._status_ns >= 0 else inf
        unechoed_s = self._sender.unechoed_s(now_ns)
        return PumpFeedback(self._applied_V, self._shortfall_V, self._state, self._trip_cause, age_s, unechoed_s)

    def nodes(self, now_ns: int) -> NodeHealth:
        """State of both nodes by their heartbeats."""
        pump, level = self._pump_beat, self._level_beat
        lost = self.lost
        if lost != self._lost_before:
            self._lost_before, self._lossy_until_ns = lost, now_ns + LOSSY_NS
        return NodeHealth(
            _age_s(now_ns, pump, level),
            pump.rebooted or level.rebooted,
            pump.contract_matches and level.contract_matches,
            now_ns <= self._lossy_until_ns,
        )

    def bus(
        self, now_ns: int, send_failures: int, is_up: bool, last_error: str = "", lines_rejected: str = ""
    ) -> BusHealth:
        """Counters since the start, and the longest run of refusals since the last call.

        lines_rejected : text of `rejections.lines_rejected`.
        """
        worst_run, self._worst_run = self._worst_run, 0
        while self._errors_ns and now_ns - self._errors_ns[0] > SECOND_NS:
            self._errors_ns.popleft()
        summary = self._rejected_frames.summary()
        return BusHealth(
            accepted=self.accepted,
            rejected=self.rejections.total(),
            send_failures=send_failures,
            foreign_commands=self.foreign_commands,
            is_up=is_up,
            refused_run=worst_run,
            errors_per_s=len(self._errors_ns),
            last_error=last_error,
            rejection_summary=f"{lines_rejected}; {summary}"
            if lines_rejected and summary
            else lines_rejected or summary,
        )


def _age_s(now_ns: int, first: LevelPair | Beat, second: LevelPair | Beat) -> float:
    """Age of the older one in s; inf before both have arrived."""
    oldest = min(first.received_ns, second.received_ns)
    return (now_ns - oldest) * 1e-9 if oldest >= 0 else inf
