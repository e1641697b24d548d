"""An slcan adapter as a python-can bus: a serial device or a TCP port.

Differences from python-can's own slcan bus: no line stops it or raises an error (`slcan_lines`); refused commands are
counted; opening checks the adapter's answers instead of waiting for two seconds; sending never blocks, and a command
that could not be sent is never sent later. See docs/decisions/0012-slcan-of-our-own.md.
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
"""Time for an adapter to boot."""
ANSWER_S = 0.3
"""Time to answer a command while it is opened."""
QUIET_S = 0.05
"""After this time without bytes the answer to a command is complete."""
SETTLE_S = 1.0
"""If an adapter still sends this long after it was closed, opening goes on."""
MAX_REFUSALS = 3
STALE_S = 0.25
"""A command without an answer for so long may still wait in the line, and can't be recalled: send no more."""
MAX_WAITING_FRAMES = 1000
MAX_LATE_READS = 64
"""Reads of a line that never pauses, after the timeout: 64 kB."""
CANCEL_LINE = b"!\r"
"""Ends a line of which only a part could be written, so that the adapter rejects it."""


class SlcanBus(can.BusABC):
    """One adapter with its channel open. To be used by one thread.

    channel : /dev/ttyACM0, /dev/ttyUSB0@57600, socket://127.0.0.1:29536; see `SerialLine`.
    bitrate : bit/s, one of BIT_RATES. can_filters : as python-can's.

    Raises ValueError for another bit rate, OSError and CanInitializationError when it can't be opened.
    is_answering : whether the adapter acknowledges commands; some never do.
    dropped : number of commands that were not sent because the line was full or the adapter no longer answered.
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

        Its time stamp is the wall clock's, as in python-can's own bus. Raises CanOperationError if the link has failed.
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
            if is_late and reads >= MAX_LATE_READS:
                return None
            if not self._take_in(left_s) and is_late:
                return None
            reads += 1

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame now, within timeout seconds, or not at all; None means 0.

        Raises CanOperationError when the line is full (ENOBUFS) or the link has failed, ValueError for kinds of frames
        that slcan does not have.
        """
        line = frame_line(msg)
        if self._is_stuck():
            self._drop(f"the adapter has not answered for {STALE_S:g} s")
        data = CANCEL_LINE + line if self._is_cut else line
        try:
            taken = self._line.write(data, timeout or 0.0)
        except OSError as error:
            raise can.CanOperationError(f"the link to the adapter has failed: {error.strerror}", error.errno) from None
        if taken < len(data):
            self._is_cut = self._is_cut or taken > 0
            self._drop("the adapter accepts no more bytes")
        self._is_cut = False
        if self._unanswered_since_s is None:
            self._unanswered_since_s = time.monotonic()

    def shutdown(self) -> None:
        """Close the channel, if the line accepts the command, and the line."""
        if self._is_shutdown:
            return
        super().shutdown()
        try:
            with suppress(OSError):  # the link has failed
                for command in (CANCEL_LINE, b"C\r") if self._is_cut else (b"C\r",):
                    self._line.write(command, 0.0)
        finally:
            self._line.close()

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of commands refused by the adapter, commands dropped here, and lines rejected here by cause."""
        rejected = {f"rejected_{cause.value}": number for cause, number in sorted(self.lines.rejected.items())}
        return {"refused": self.lines.refused, "dropped": self.dropped, **rejected}

    @property
    def has_counted(self) -> bool:
        """Whether any of `counts` is above zero."""
        return bool(self.lines.refused or self.dropped or self.lines.rejected)

    def _take_in(self, timeout_s: float | None) -> bool:
        """Read waiting bytes, or those that arrive within timeout_s; return whether there were any."""
        try:
            data = self._line.read(timeout_s)
        except OSError as error:
            raise can.CanOperationError(f"the link to the adapter has failed: {error.strerror}", error.errno) from None
        if not data:
            return False
        answers = self.lines.done + self.lines.refused
        self._frames.extend(self.lines.feed(data, time.time()))
        if self.lines.done + self.lines.refused > answers and self._unanswered_since_s is not None:
            self._answers_sends = True
            self._unanswered_since_s = None
        return True

    def _is_stuck(self) -> bool:
        """Whether an adapter that used to answer no longer does: a new command would only wait in the line."""
        if not self._answers_sends or not self._has_waited():
            return False
        while len(self._frames) < MAX_WAITING_FRAMES and self._has_waited() and self._take_in(0.0):
            pass  # the answer may have arrived but not been read yet
        return self._has_waited()

    def _has_waited(self) -> bool:
        since_s = self._unanswered_since_s
        return since_s is not None and time.monotonic() - since_s > STALE_S

    def _drop(self, why: str) -> None:
        self.dropped += 1
        raise can.CanOperationError(why, errno.ENOBUFS)

    def _open_channel(self, bit_rate: bytes, timeout_s: float) -> None:
        """Set the bit rate and open the channel, from any state of the adapter. Raises CanInitializationError."""
        give_up_s = time.monotonic() + timeout_s
        refusals = 0
        for attempt in count():
            try:
                self._try_to_open(bit_rate, is_first=attempt == 0)
                break
            except can.CanInitializationError as error:
                refusals += isinstance(error, _RefusedError)
                if refusals >= MAX_REFUSALS or time.monotonic() >= give_up_s:
                    raise
        self.lines.reset_counts()

    def _try_to_open(self, bit_rate: bytes, *, is_first: bool) -> None:
        """Close the channel, set the bit rate, open it. It may be booting, open, or hold part of a command.

        Each command is written by itself, after the answer to the one before it or a short wait: some adapters obey
        only the first command of a write, and a killed program may have left the channel open.
        """
        self.lines.reset_counts()
        for command in (CR, b"C\r"):
            self._write(command)
            self._await_answer(QUIET_S)
        self._write(b"V\r")
        self._settle()
        if self.lines.texts and not self.lines.done + self.lines.refused:  # mute, or it booted just before the V
            self._write(b"C\r")
            self._await_answer(ANSWER_S)
        self._frames.clear()
        self.is_answering = self.lines.done + self.lines.refused > 0
        if not self.is_answering and self.lines.texts == 0:
            raise can.CanInitializationError("the adapter does not answer")
        if not self.is_answering and is_first:  # perhaps a message of its boot loader
            raise can.CanInitializationError("the adapter sends text, but acknowledges no command")
        self._command(bit_rate)
        self._command(b"O")

    def _command(self, command: bytes) -> None:
        """Send one command and check its answer."""
        refused = self.lines.refused
        self._write(command + CR)
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

    def _write(self, data: bytes) -> None:
        if self._line.write(data, ANSWER_S) < len(data):
            raise can.CanInitializationError("the adapter accepts no commands")

    def _settle(self) -> None:
        """Read until the line is quiet."""
        end_s = time.monotonic() + SETTLE_S
        wait_s = ANSWER_S
        while time.monotonic() < end_s and self._take_in(wait_s):
            wait_s = QUIET_S


class _RefusedError(can.CanInitializationError):
    """The adapter answered a command of the opening with BELL."""
