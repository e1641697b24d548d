"""An slcan adapter as a python-can bus: a serial device or a TCP port, opened with its answers checked.

Against python-can's own: no line can make it raise or stop it (`slcan_lines`); a refusal is counted; opening waits for
the adapter's answers instead of two seconds; sending never blocks and leaves nothing behind to be sent later.
"""

from __future__ import annotations

import errno
import time
from collections import deque
from contextlib import suppress
from itertools import count

import can
from can.typechecking import CanFilters

from hil.edge.can.serial_line import SerialLine
from hil.edge.can.slcan_lines import BIT_RATES, CR, LineReader, frame_line

OPEN_TIMEOUT_S = 5.0
"""How long an adapter may take to boot."""
ANSWER_S = 0.3
"""How long it may take to answer a command while it is opened."""
QUIET_S = 0.05
"""A line that has been quiet for so long has nothing more to say to what it was told."""
SETTLE_S = 1.0
"""An adapter that goes on talking after it was closed is asked again after this long."""
MOST_REFUSALS = 3
STALE_S = 0.25
"""Commands that have gone unanswered for so long may still wait in the line, where nobody can take them back."""
MOST_WAITING = 1000
MOST_LATE_READS = 64
"""Reads of a babbling line after the time is over: 64 kB."""
SPOILT = b"!\r"
"""Ends a line of which only a part could be written, so that no adapter takes it for whole."""


class SlcanBus(can.BusABC):
    """One adapter with its channel open. One thread uses it.

    channel : /dev/ttyACM0, /dev/ttyUSB0@57600, socket://127.0.0.1:29536; see `SerialLine`.
    bitrate : bit/s, one of BIT_RATES. can_filters : as python-can's.

    Raises ValueError for another bit rate, OSError and CanInitializationError when it can't be opened.
    is_answering : whether the adapter acknowledges commands; some never do.
    dropped : commands that were not sent because the line was full or the adapter had stopped answering.
    """

    def __init__(
        self,
        channel: str,
        bitrate: int = 500_000,
        can_filters: CanFilters | None = None,
        *,
        open_timeout_s: float = OPEN_TIMEOUT_S,
    ) -> None:
        if bitrate not in BIT_RATES:
            raise ValueError(f"slcan has no {bitrate} bit/s, only {', '.join(map(str, BIT_RATES))}")
        self.channel_info = f"slcan on {channel}"
        self.lines = LineReader()
        self.dropped = 0
        self.is_answering = True
        self._frames: deque[can.Message] = deque()
        self._is_cut = False
        self._unanswered_since_s: float | None = None
        self._answers_sends = False
        self._line = SerialLine(channel)
        try:
            self._open_channel(BIT_RATES[bitrate], open_timeout_s)
        except BaseException:
            self._line.close()
            raise
        super().__init__(channel, can_filters)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame that passes the filters, or None after timeout seconds (None: waits).

        Its timestamp is the wall clock's, as of python-can's own bus. Raises CanOperationError when the link is gone.
        """
        deadline_s = None if timeout is None else time.monotonic() + timeout
        reads = 0
        while True:
            while self._frames:
                frame = self._frames.popleft()
                if self._matches_filters(frame):
                    return frame
            left_s = None if deadline_s is None else max(deadline_s - time.monotonic(), 0.0)
            is_late = left_s == 0.0
            if is_late and reads >= MOST_LATE_READS:
                return None
            if not self._take_in(left_s) and is_late:
                return None
            reads += 1

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame now, within timeout seconds, or not at all; None means 0.

        Raises CanOperationError when the adapter takes no more (ENOBUFS) or is gone, ValueError for frames that slcan
        has no words for.
        """
        line = frame_line(msg)
        if self._is_stuck():
            self._drop(f"the adapter has not answered for {STALE_S:g} s")
        data = SPOILT + line if self._is_cut else line
        try:
            taken = self._line.write(data, timeout or 0.0)
        except OSError as error:
            raise can.CanOperationError(f"no adapter: {error.strerror}", error.errno) from None
        if taken < len(data):
            self._is_cut = self._is_cut or taken > 0
            self._drop("the adapter takes no more")
        self._is_cut = False
        if self._unanswered_since_s is None:
            self._unanswered_since_s = time.monotonic()

    def shutdown(self) -> None:
        """Close the channel, if the line takes it, and the line."""
        if self._is_shutdown:
            return
        super().shutdown()
        try:
            with suppress(OSError):  # gone already
                for command in (SPOILT, b"C\r") if self._is_cut else (b"C\r",):
                    self._line.write(command, 0.0)
        finally:
            self._line.close()

    @property
    def counts(self) -> dict[str, int]:
        """Commands that the adapter has refused, commands that we dropped, lines that we rejected, by cause."""
        rejected = {f"rejected_{cause.value}": number for cause, number in sorted(self.lines.rejected.items())}
        return {"refused": self.lines.refused, "dropped": self.dropped, **rejected}

    @property
    def has_counted(self) -> bool:
        """Whether any of `counts` is above zero."""
        return bool(self.lines.refused or self.dropped or self.lines.rejected)

    def _take_in(self, timeout_s: float | None) -> bool:
        """Read what waits, or comes within timeout_s; whether there was anything."""
        try:
            data = self._line.read(timeout_s)
        except OSError as error:
            raise can.CanOperationError(f"no adapter: {error.strerror}", error.errno) from None
        if not data:
            return False
        answers = self.lines.done + self.lines.refused
        self._frames.extend(self.lines.feed(data, time.time()))
        if self.lines.done + self.lines.refused > answers and self._unanswered_since_s is not None:
            self._answers_sends = True
            self._unanswered_since_s = None
        return True

    def _is_stuck(self) -> bool:
        """Whether an adapter that answers has stopped to: what it is sent now would only wait in the line."""
        if not self._answers_sends or not self._has_waited():
            return False
        while len(self._frames) < MOST_WAITING and self._has_waited() and self._take_in(0.0):
            pass  # the answer may have come unread
        return self._has_waited()

    def _has_waited(self) -> bool:
        since_s = self._unanswered_since_s
        return since_s is not None and time.monotonic() - since_s > STALE_S

    def _drop(self, why: str) -> None:
        self.dropped += 1
        raise can.CanOperationError(why, errno.ENOBUFS)

    def _open_channel(self, bit_rate: bytes, timeout_s: float) -> None:
        """Bring the adapter to its bit rate and open it, whatever state it was in. Raises CanInitializationError."""
        give_up_s = time.monotonic() + timeout_s
        refusals = 0
        for attempt in count():
            try:
                self._try_to_open(bit_rate, is_first=attempt == 0)
                break
            except can.CanInitializationError as error:
                refusals += isinstance(error, _RefusedError)
                if refusals >= MOST_REFUSALS or time.monotonic() >= give_up_s:
                    raise
        self.lines.reset_counts()

    def _try_to_open(self, bit_rate: bytes, *, is_first: bool) -> None:
        """Close it, set its bit rate, open it. It may be booting, open or listening already, or hold half a command.

        Each command is a write of its own, sent once the one before it is answered or has had time to be: some
        adapters obey only the first command of a write, and a killed program may have left them open.
        """
        self.lines.reset_counts()
        for command in (CR, b"C\r"):
            self._say(command)
            self._await_answer(QUIET_S)
        self._say(b"V\r")
        self._settle()
        self._frames.clear()
        self.is_answering = self.lines.done + self.lines.refused > 0
        if not self.is_answering and self.lines.texts == 0:
            raise can.CanInitializationError("the adapter does not answer")
        if not self.is_answering and is_first:  # perhaps this is what it says while it boots
            raise can.CanInitializationError("the adapter says something, but answers nothing")
        self._tell(bit_rate)
        self._tell(b"O")

    def _tell(self, command: bytes) -> None:
        """One command and its answer."""
        refused = self.lines.refused
        self._say(command + CR)
        has_answered = self._await_answer(ANSWER_S if self.is_answering else QUIET_S)
        if self.lines.refused > refused:
            raise _RefusedError(f"the adapter refuses {command.decode()}")
        if self.is_answering and not has_answered:
            raise can.CanInitializationError(f"the adapter does not answer {command.decode()}")

    def _await_answer(self, timeout_s: float) -> bool:
        """Read until one more command is acknowledged or refused, for at most timeout_s; whether one was."""
        answers = self.lines.done + self.lines.refused
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0:
            self._take_in(left_s)
            if self.lines.done + self.lines.refused > answers:
                return True
        return False

    def _say(self, data: bytes) -> None:
        if self._line.write(data, ANSWER_S) < len(data):
            raise can.CanInitializationError("the adapter takes no commands")

    def _settle(self) -> None:
        """Take in what it has to say until it says no more."""
        end_s = time.monotonic() + SETTLE_S
        wait_s = ANSWER_S
        while time.monotonic() < end_s and self._take_in(wait_s):
            wait_s = QUIET_S


class _RefusedError(can.CanInitializationError):
    """A command of the opening that was answered with BELL."""
