"""A byte line to a serial adapter, by pyserial: a device, or a TCP port as socket://HOST:PORT. It never blocks.

pyserial opens and configures the line. Bytes then go through its descriptor: pyserial's own write would try for ever
once the line is full, timeout or not.
"""

from __future__ import annotations

import errno
import io
import os
import select
import socket
import termios

import serial

READ_SIZE = 1024
BAUD = 115_200


class SerialLine:
    """An open line. Raises OSError when it can't be opened, and once the other end is gone."""

    def __init__(self, channel: str) -> None:
        """A device is /dev/ttyACM0, or /dev/ttyUSB0@57600 where its baud rate is not 115200."""
        url, baud = _split(channel)
        try:
            self._port = serial.serial_for_url(url, baudrate=baud, timeout=0, exclusive=True)
        except (termios.error, ValueError) as error:
            raise OSError(errno.EINVAL, f"is no serial line: {error}") from None
        try:
            self._fd: int = self._port.fileno()
        except (AttributeError, io.UnsupportedOperation):
            raise OSError(errno.ENOTSUP, "has no descriptor: want a device or socket://HOST:PORT") from None
        if url.startswith("socket://"):
            _send_at_once(self._fd)

    def read(self, timeout_s: float | None) -> bytes:
        """What has come, at most READ_SIZE bytes; nothing after timeout_s (None: waits). Raises OSError."""
        self._require_open()
        if not select.select([self._fd], [], [], timeout_s)[0]:
            return b""
        try:
            data = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError(errno.ENODEV, "the other end of the line is gone")
        return data

    def write(self, data: bytes, timeout_s: float) -> int:
        """How many bytes the line has taken within timeout_s, none when it is full. Raises OSError."""
        self._require_open()
        if not select.select([], [self._fd], [], timeout_s)[1]:
            return 0
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Let go of it; what waits in it is the system's. Raises OSError."""
        self._fd = -1  # another file may soon have its number
        self._port.close()

    def _require_open(self) -> None:
        if self._fd < 0:
            raise OSError(errno.EBADF, "the line is closed")


def _send_at_once(fd: int) -> None:
    """Switch Nagle's algorithm off: a command must not wait for the acknowledgement of the last one."""
    connection = socket.socket(fileno=fd)
    try:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    finally:
        connection.detach()


def _split(channel: str) -> tuple[str, int]:
    url, at, baud = channel.rpartition("@")
    return (url, int(baud)) if at and baud.isdecimal() else (channel, BAUD)
