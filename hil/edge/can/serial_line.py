"""A serial line to an adapter, opened by pyserial: a device, or a TCP port as socket://HOST:PORT. It never blocks.

pyserial opens and configures the line. Bytes are then read and written through its file descriptor, because pyserial's
own write never returns when the line is full, whatever its timeout. See docs/decisions/0012-slcan-of-our-own.md.
"""

from __future__ import annotations

import errno
import io
import os
import select
import socket
import termios
from urllib.parse import urlsplit

import serial

READ_SIZE = 1024
BAUD = 115_200


class SerialLine:
    """An open line. Raises OSError if it can't be opened, and when the other end has closed it."""

    def __init__(self, channel: str) -> None:
        """A device is /dev/ttyACM0, or /dev/ttyUSB0@57600 where its baud rate is not 115200."""
        url, baud = _split(channel)
        _check_port(url)
        try:
            self._port = serial.serial_for_url(url, baudrate=baud, timeout=0, exclusive=True)
        except (termios.error, ValueError) as error:
            raise OSError(errno.EINVAL, f"not a serial line: {error}") from None
        except serial.SerialException as error:
            if error.errno is None and isinstance(error.__context__, (OSError, termios.error)):
                error.errno = error.__context__.args[0]  # pyserial leaves it out for a TCP port and for a device
            raise
        try:
            self._fd: int = self._port.fileno()
        except (AttributeError, io.UnsupportedOperation):
            raise OSError(errno.ENOTSUP, "it has no file descriptor: use a device or socket://HOST:PORT") from None
        if url.startswith("socket://"):
            _send_at_once(self._fd)

    def read(self, timeout_s: float | None) -> bytes:
        """Bytes that have arrived, at most READ_SIZE; b"" after timeout_s (None: no limit). Raises OSError."""
        self._require_open()
        if not select.select([self._fd], [], [], timeout_s)[0]:
            return b""
        try:
            data = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError(errno.ENODEV, "the other end has closed the line")
        return data

    def write(self, data: bytes, timeout_s: float) -> int:
        """Write bytes; return how many the line accepted within timeout_s, 0 if it is full. Raises OSError."""
        self._require_open()
        if not select.select([], [self._fd], [], timeout_s)[1]:
            return 0
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Close the line; bytes still in it are left to the system. Raises OSError."""
        self._fd = -1  # the system may give its number to another file
        self._port.close()

    def _require_open(self) -> None:
        if self._fd < 0:
            raise OSError(errno.EBADF, "the line is closed")


def _send_at_once(fd: int) -> None:
    """Switch Nagle's algorithm off: a command must not wait for the TCP acknowledgement of the one before."""
    connection = socket.socket(fileno=fd)
    try:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    finally:
        connection.detach()


def _check_port(url: str) -> None:
    """Refuse a TCP address without a port, for which pyserial has no message of its own. Raises OSError."""
    if not url.startswith("socket://"):
        return
    try:
        port = urlsplit(url).port
    except ValueError:
        port = None
    if not port:
        raise OSError(errno.EINVAL, "the TCP port must be a number from 1 to 65535: socket://HOST:PORT")


def _split(channel: str) -> tuple[str, int]:
    url, at, baud = channel.rpartition("@")
    return (url, int(baud)) if at and baud.isdecimal() else (channel, BAUD)
