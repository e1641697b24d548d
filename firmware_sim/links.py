"""Byte links to an slcan host, over a TCP socket or a pseudo-terminal. No call here blocks.

Output waits in a bounded queue of whole lines; when a host does not read, the oldest lines are dropped and counted.
"""

import contextlib
import os
import socket
import termios
import tty
from collections import deque

from can import Message

from firmware_sim.slcan_port import SlcanPort

READ_SIZE = 4096
OUTPUT_MAX_BYTES = 16_384
SOCKET_BUFFER_BYTES = 16_384


class LineQueue:
    """Lines that wait for a host, at most OUTPUT_MAX_BYTES of them."""

    def __init__(self) -> None:
        self._lines: deque[bytes] = deque()
        self._size = 0
        self._is_partly_written = False
        self.dropped = 0

    def __len__(self) -> int:
        return self._size

    def put(self, line: bytes) -> None:
        """Append a line; drop the oldest ones that no longer fit, but never one that was written in part."""
        if not line:
            return
        self._lines.append(line)
        self._size += len(line)
        while self._size > OUTPUT_MAX_BYTES and len(self._lines) > 1 + self._is_partly_written:
            oldest = 1 if self._is_partly_written else 0
            self._size -= len(self._lines[oldest])
            del self._lines[oldest]
            self.dropped += 1

    def waiting(self) -> bytes:
        """Return all waiting bytes."""
        return b"".join(self._lines)

    def discard(self, count: int) -> None:
        """Remove the first `count` bytes: they were written."""
        self._size -= count
        while count and count >= len(self._lines[0]):
            count -= len(self._lines.popleft())
            self._is_partly_written = False
        if count:
            self._lines[0] = self._lines[0][count:]
            self._is_partly_written = True


class SlcanLink:
    """An adapter behind a non-blocking file descriptor that the caller owns."""

    def __init__(self, fd: int) -> None:
        os.set_blocking(fd, False)
        self.fd = fd
        self.port = SlcanPort()
        self.queue = LineQueue()

    @property
    def is_stuck(self) -> bool:
        """Whether the host has stopped reading."""
        return self.queue.dropped > 0

    def read(self) -> list[Message] | None:
        """Return frames that the host sends to the bus; None if the host is gone. Answers are queued."""
        try:
            data = os.read(self.fd, READ_SIZE)
        except BlockingIOError:
            return []
        except OSError:
            return None
        if not data:
            return None
        reply, frames = self.port.feed(data)
        self.queue.put(reply)
        return frames

    def send(self, frame: Message) -> None:
        """Queue a frame of the bus for the host."""
        self.queue.put(self.port.frame_line(frame))

    def flush(self) -> bool:
        """Write as much as the host accepts now; False if the host is gone."""
        if not self.queue:
            return True
        try:
            self.queue.discard(os.write(self.fd, self.queue.waiting()))
        except BlockingIOError:
            return True
        except OSError:
            return False
        return True


def listen(port: int) -> socket.socket:
    """Open a TCP listener on 127.0.0.1 (port 0: a free one). Raises OSError."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER_BYTES)
        listener.bind(("127.0.0.1", port))
        listener.listen(4)
        listener.setblocking(False)
    except OSError:
        listener.close()
        raise
    return listener


def open_pty() -> tuple[int, str]:
    """Open a raw pseudo-terminal; return the master's descriptor and the path that a host opens. Raises OSError."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        return master, os.ttyname(slave)
    finally:
        os.close(slave)


def discard_unread(master: int) -> None:
    """Discard the bytes that the last host of a pseudo-terminal left unread, in both directions."""
    with contextlib.suppress(termios.error):
        termios.tcflush(master, termios.TCIOFLUSH)
