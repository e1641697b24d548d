"""Commands for the emulator while it runs: lines on standard input and on a local socket, an answer line to each.

No call here blocks. A client that does not read its answers is disconnected, so that it can't delay the rig.
"""

import contextlib
import os
import select
import socket
import stat
import sys
from pathlib import Path

from firmware_sim.failure_command import Injector, execute

READ_SIZE = 4096
LINE_MAX = 1024
STDIN = 0


class Lines:
    """Splits bytes into lines; a line longer than LINE_MAX is cut off, so that it is refused."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Return the lines that are complete now, without their ends and without empty ones."""
        *complete, rest = (self._rest + data).split(b"\n")
        self._rest = rest[: LINE_MAX + 1]
        texts = (line[:LINE_MAX].decode("utf-8", "replace").strip() for line in complete)
        return [text for text in texts if text]


class CommandServer:
    """Reads commands from standard input (with_stdin) and from the clients of a listener, which `close` closes."""

    def __init__(self, rig: Injector, listener: socket.socket | None = None, *, with_stdin: bool = False) -> None:
        self._rig = rig
        self._listener = listener
        self._clients: dict[socket.socket, Lines] = {}
        self._stdin = Lines() if with_stdin and _is_open(STDIN) else None

    @property
    def address(self) -> str | None:
        """Address of the listener: a path, or host and port; None without one."""
        if self._listener is None:
            return None
        name = self._listener.getsockname()
        return name if isinstance(name, str) else f"{name[0]}:{name[1]}"

    def filenos(self) -> list[int]:
        """Return the descriptors to wait for."""
        sockets = [*([] if self._listener is None else [self._listener]), *self._clients]
        return [*([STDIN] if self._may_read_stdin() else []), *(one.fileno() for one in sockets)]

    def read(self, now_ns: int) -> None:
        """Carry out all waiting commands at time now_ns."""
        if self._may_read_stdin():
            self._read_stdin(now_ns)
        self._accept()
        for client in list(self._clients):
            self._read_client(client, now_ns)

    def close(self) -> None:
        """Disconnect the clients, close the listener, and remove a Unix socket's path."""
        for client in list(self._clients):
            self._drop(client)
        if self._listener is not None:
            if self._listener.family == socket.AF_UNIX:
                with contextlib.suppress(OSError):
                    Path(self._listener.getsockname()).unlink()
            self._listener.close()
            self._listener = None

    def _may_read_stdin(self) -> bool:
        """Whether reading is possible: the system would stop a background process that reads from its terminal."""
        if self._stdin is None:
            return False
        try:
            return not os.isatty(STDIN) or os.tcgetpgrp(STDIN) == os.getpgrp()
        except OSError:
            return False

    def _read_stdin(self, now_ns: int) -> None:
        while self._stdin is not None and select.select([STDIN], [], [], 0)[0]:
            try:
                data = os.read(STDIN, READ_SIZE)
            except OSError:
                data = b""
            for line in self._stdin.feed(data):
                sys.stdout.write(execute(line, self._rig, now_ns) + "\n")
                sys.stdout.flush()
            if not data:
                self._stdin = None

    def _accept(self) -> None:
        while self._listener is not None:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            client.setblocking(False)
            self._clients[client] = Lines()

    def _read_client(self, client: socket.socket, now_ns: int) -> None:
        try:
            data = client.recv(READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        answers = "".join(execute(line, self._rig, now_ns) + "\n" for line in self._clients[client].feed(data))
        answered = answers.encode()
        try:
            is_taken = client.send(answered) == len(answered) if answered else True
        except OSError:
            is_taken = False
        if not data or not is_taken:
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        del self._clients[client]
        client.close()


def listen_unix(path: Path) -> socket.socket:
    """Open a listener at a path; an abandoned socket at that path is replaced. Raises OSError."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if _is_abandoned(path):
            path.unlink()
        listener.bind(str(path))
        listener.listen(4)
        listener.setblocking(False)
    except OSError:
        listener.close()
        raise
    return listener


def _is_abandoned(path: Path) -> bool:
    if not path.exists() or not stat.S_ISSOCK(path.stat().st_mode):
        return False
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            return True
    return False


def _is_open(fd: int) -> bool:
    try:
        os.fstat(fd)
    except OSError:
        return False
    return True
