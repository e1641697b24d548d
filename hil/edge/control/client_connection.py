"""One client of the control channel, as the process that serves it sees it: what was read, what waits to be sent."""

from __future__ import annotations

import pwd
import selectors
import socket
import struct
import time
from collections import deque
from contextlib import suppress
from os import getuid

from hil.edge.control.messages import answer_line
from hil.edge.control.socket_path import MAX_LINE

MAX_BACKLOG = 256 * 1024
"""Bytes that may wait for a client; with more it is disconnected."""

MAX_STATE_BACKLOG = 64 * 1024
"""With more, it gets no states."""

MAX_REQUESTS_PER_S = 20.0
MAX_LINES = 20
STOP = b'"stop"'
REST_S = 0.1
RATE_TOLERANCE = 0.1
CREDENTIALS = struct.Struct("3i")


class ClientConnection:
    """number : of the connection. user, pid : of the process that has connected, as the system says."""

    def __init__(self, connection: socket.socket, number: int, user: str, pid: int) -> None:
        self.number, self.user, self.pid = number, user, pid
        self.wants_events = False
        self.is_lost = False
        self.backlog = 0
        self.reads_at_s = 0.0
        self._connection = connection
        self._read = b""
        self._lines: deque[bytes] = deque()
        self._out: deque[bytes] = deque()
        self._rate_hz = 0.0
        self._next_state_s = 0.0
        self._allowance, self._allowed_at_s = MAX_REQUESTS_PER_S, time.monotonic()
        self._mask = 0

    @classmethod
    def accepted(cls, connection: socket.socket, number: int) -> ClientConnection | None:
        """A connection of this user, or of root; None for another one's."""
        data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
        pid, uid, _ = CREDENTIALS.unpack(data)
        if uid not in (getuid(), 0):
            return None
        try:
            user = pwd.getpwuid(uid).pw_name
        except KeyError:
            user = str(uid)
        return cls(connection, number, user, pid)

    @property
    def has_lines(self) -> bool:
        """Whether lines wait that were read already; no selector tells of them."""
        return bool(self._lines) and not self.is_lost

    def lines(self) -> list[bytes]:
        """At most `MAX_LINES` complete lines: a round of work must be short. A stop goes before what came with it.

        A line that is too long ends the connection.
        """
        if not self._lines:
            self._lines.extend(self._read_lines())
        return [self._lines.popleft() for _ in range(min(len(self._lines), MAX_LINES))]

    def _read_lines(self) -> list[bytes]:
        """The lines of one read, at most one line's length."""
        try:
            data = self._connection.recv(MAX_LINE)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self.is_lost = True
            return []
        *lines, self._read = (self._read + data).split(b"\n")
        if any(len(line) >= MAX_LINE for line in (*lines, self._read)):
            self.put(answer_line(None, None, f"a line of more than {MAX_LINE} bytes", "too_long"))
            self.flush()
            self.is_lost = True
            return []
        return sorted((line for line in lines if line.strip()), key=lambda line: STOP not in line)

    def may_ask(self, now_s: float) -> bool:
        """Whether a request may be taken now; if not, the client is not read for a while."""
        gained = (now_s - self._allowed_at_s) * MAX_REQUESTS_PER_S
        self._allowance, self._allowed_at_s = min(self._allowance + gained, MAX_REQUESTS_PER_S), now_s
        if self._allowance < 1.0:
            self.reads_at_s = now_s + REST_S
            return False
        self._allowance -= 1.0
        return True

    def subscribe(self, rate_hz: float, events: bool) -> None:
        """States at this rate, 0 for none, and events, from now on."""
        self._rate_hz, self.wants_events = rate_hz, events
        self._next_state_s = 0.0

    def is_due(self, now_s: float) -> bool:
        """Whether a state is to be sent now; counts it as sent."""
        if self._rate_hz <= 0.0:
            return False
        period_s = 1.0 / self._rate_hz
        if now_s < self._next_state_s - RATE_TOLERANCE * period_s:
            return False
        self._next_state_s = max(self._next_state_s + period_s, now_s)
        return True

    def put(self, line: bytes) -> None:
        """Queue a line; a client for which too much waits is lost."""
        if self.is_lost:
            return
        self._out.append(line)
        self.backlog += len(line)
        if self.backlog > MAX_BACKLOG:
            self.is_lost = True

    def flush(self) -> None:
        """Send what the client takes."""
        while self._out:
            try:
                sent = self._connection.send(self._out[0])
            except BlockingIOError:
                return
            except OSError:
                self.is_lost = True
                return
            self.backlog -= sent
            if sent < len(self._out[0]):
                self._out[0] = self._out[0][sent:]
                return
            self._out.popleft()

    def select(self, selector: selectors.BaseSelector, now_s: float) -> None:
        """Wait for what is of interest: requests unless the client has sent too much, room if something waits."""
        may_read = now_s >= self.reads_at_s and not self._lines
        mask = (selectors.EVENT_READ if may_read else 0) | (selectors.EVENT_WRITE if self._out else 0)
        if mask == self._mask:
            return
        if self._mask == 0:
            selector.register(self._connection, mask, self)
        elif mask == 0:
            selector.unregister(self._connection)
        else:
            selector.modify(self._connection, mask, self)
        self._mask = mask

    def close(self, selector: selectors.BaseSelector) -> None:
        """Disconnect."""
        if self._mask:
            with suppress(KeyError, ValueError):
                selector.unregister(self._connection)
        self._connection.close()
