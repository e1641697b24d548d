"""A blocking client of a run's control channel, for `hil ctl`, `hil panel` and programs of your own.

with ControlClient.connect("runs/20260101-120000_steps/control.sock") as run:
answer = run.ask("reference", levels_cm=[12.5, 12.7], ramp_s=20.0)
print(answer["text"], run.state()["measured_cm"])
"""

from __future__ import annotations

import itertools
import json
import os
import select
import socket
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from hil.edge.control.socket_path import MAX_LINE, SOCKET_NAME, ControlError, RunningRun, running_runs

Message = dict[str, Any]

MAX_MESSAGE = 1 << 20
RETRIES, RETRY_S = 3, 0.1
"""For a socket on which nobody listens yet."""


class RequestError(ControlError):
    """A request that is not sent, because no run would read it."""


class ControlClient:
    """A connection. hello : the greeting, see docs/reference/control-channel.md. Use as a context, from one thread."""

    def __init__(self, connection: socket.socket, timeout_s: float = 5.0) -> None:
        self._socket, self._timeout_s = connection, timeout_s
        self._read = b""
        self._kept: deque[Message] = deque(maxlen=1000)
        self._ids = itertools.count(1)
        self.hello: Message = {}

    @classmethod
    def connect(cls, path: str | os.PathLike[str], timeout_s: float = 5.0) -> ControlClient:
        """Connect to a run's socket and read its greeting. Raises ControlError."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.settimeout(timeout_s)
        try:
            _connect(connection, os.fspath(path), timeout_s)
            client = cls(connection, timeout_s)
            first = client._next(time.monotonic() + timeout_s)
        except (OSError, ValueError) as error:
            connection.close()
            cause = getattr(error, "strerror", None) or error
            raise ControlError(f"no run listens at {path}: {cause}") from None
        if first is None or "hello" not in first:
            connection.close()
            said = "it does not answer" if first is None else first.get("text", "it is no run")
            raise ControlError(f"no run listens at {path}: {said}")
        client.hello = first["hello"]
        return client

    def __enter__(self) -> ControlClient:
        """The connection is open."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Disconnect."""
        self.close()

    def close(self) -> None:
        """Disconnect."""
        self._socket.close()

    def fileno(self) -> int:
        """For `select`: readable when `messages(0.0)` has something."""
        return self._socket.fileno()

    def send(self, do: str, **keys: object) -> int:
        """Send a request and return its id, without waiting for the answer.

        Raises ControlError; RequestError for one that no run would read.
        """
        request_id = next(self._ids)
        line = _as_line({"v": 1, "id": request_id, "do": do, **keys})
        try:
            self._socket.sendall(line)
        except OSError as error:
            raise ControlError(f"the run is gone: {error.strerror or error}") from None
        return request_id

    def ask(self, do: str, **keys: object) -> Message:
        """Send a request and wait for its answer; states and events that come meanwhile are kept for `messages`.

        Raises ControlError when the run is gone or does not answer in time.
        """
        request_id = self.send(do, **keys)
        end_s = time.monotonic() + self._timeout_s
        while (message := self._next(end_s)) is not None:
            if "ok" in message and message.get("id") == request_id:
                return message
            self._kept.append(message)
        raise ControlError(f"the run does not answer within {self._timeout_s:g} s")

    def state(self) -> Message:
        """The run's state; of a run that is just being started, once it has made a step. Raises ControlError."""
        end_s = time.monotonic() + self._timeout_s
        while not (answer := self.ask("state"))["ok"]:
            if answer["reason"] != "not_while" or time.monotonic() > end_s:
                raise ControlError(answer["text"])
            time.sleep(RETRY_S)
        end_s = time.monotonic() + self._timeout_s
        while (message := self._next(end_s)) is not None:
            if "state" in message:
                state: Message = message["state"]
                return state
            self._kept.append(message)
        raise ControlError(f"the run does not answer within {self._timeout_s:g} s")

    def messages(self, timeout_s: float | None = None) -> Iterator[Message]:
        """States, events and answers as they come. Ends after `timeout_s` without any; None: never.

        Raises ControlError when the run is gone.
        """
        while True:
            while self._kept:
                yield self._kept.popleft()
            message = self._next(None if timeout_s is None else time.monotonic() + timeout_s)
            if message is None:
                return
            yield message

    def _next(self, end_s: float | None) -> Message | None:
        """The next message; None when none comes until then. Raises ControlError when the run is gone."""
        while b"\n" not in self._read:
            remaining_s = None if end_s is None else max(end_s - time.monotonic(), 0.0)
            if not select.select([self._socket], [], [], remaining_s)[0]:
                return None
            try:
                data = self._socket.recv(65536)
            except OSError as error:
                raise ControlError(f"the run is gone: {error.strerror or error}") from None
            if not data or len(self._read) > MAX_MESSAGE:
                raise ControlError("the run is gone")
            self._read += data
        line, _, self._read = self._read.partition(b"\n")
        try:
            message = json.loads(line)
        except (ValueError, RecursionError):
            raise ControlError("what listens there is no run: it does not send JSON") from None
        return message if isinstance(message, dict) else {}


def _as_line(message: Message) -> bytes:
    """A request for the socket. Raises RequestError."""
    try:
        line = json.dumps(message, ensure_ascii=False, allow_nan=False).encode(errors="replace") + b"\n"
    except (TypeError, ValueError) as error:
        raise RequestError(f"{message['do']}: JSON can't say this: {error}") from None
    if len(line) > MAX_LINE:
        raise RequestError(f"{message['do']}: a request of {len(line)} bytes; it may have {MAX_LINE}")
    return line


def _connect(connection: socket.socket, path: str, timeout_s: float) -> None:
    """A run that has just made its socket may not listen yet; one that many connect to at once has a full queue.

    Raises OSError.
    """
    end_s, refused = time.monotonic() + timeout_s, 0
    while True:
        try:
            connection.connect(path)
        except (BlockingIOError, ConnectionRefusedError) as error:
            refused += isinstance(error, ConnectionRefusedError)
            if refused > RETRIES or time.monotonic() > end_s:
                raise
            time.sleep(RETRY_S)
        else:
            return


def find_run(folder: str | os.PathLike[str] | None = None, path: str | os.PathLike[str] | None = None) -> Path:
    """The socket of a run: at `path`, of the run in `folder`, or of the only run that goes on.

    Raises ControlError that lists the runs when there are several, or says that there is none.
    """
    if path is not None:
        return Path(path)
    run = listed_run(folder)
    if run is not None:
        return Path(run.socket)
    if folder is not None:
        return Path(folder).absolute() / SOCKET_NAME
    runs = running_runs()
    if runs:
        raise ControlError(f"more than one run goes on, give --run FOLDER: {listing(runs)}")
    raise ControlError("no run goes on; give --run FOLDER or --socket PATH for one that was started elsewhere")


def listed_run(
    folder: str | os.PathLike[str] | None = None, path: str | os.PathLike[str] | None = None
) -> RunningRun | None:
    """The run that `find_run` means, with its process; None where the list of running runs does not have just one."""
    runs = running_runs()
    if path is not None:
        runs = [run for run in runs if _is_same(run.socket, path)]
    elif folder is not None:
        runs = [run for run in runs if _is_same(run.folder, folder)]
    return runs[0] if len(runs) == 1 else None


def _is_same(listed: str, given: str | os.PathLike[str]) -> bool:
    """Whether both are the same place, also by links, and when it was removed."""
    return Path(listed).resolve() == Path(given).resolve()


def listing(runs: list[RunningRun]) -> str:
    """The runs in one line."""
    return ", ".join(f"{run.folder} (process {run.pid})" for run in runs)
