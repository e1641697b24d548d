"""Where a run listens, and how clients find the runs that go on."""

from __future__ import annotations

import fcntl
import json
import os
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from hil.core.errors import HilError
from hil.edge.control.run_process import RunProcess, start_time

MAX_PATH_BYTES = 107
"""Of a Unix socket on Linux: 108 with the zero at the end (man 7 unix)."""

MAX_LINE = 4096
"""Bytes of a request, with the end of the line."""

SOCKET_NAME = "control.sock"
PROBE_TIMEOUT_S = 1.0


class ControlError(HilError, ValueError):
    """The control channel can't be opened there; or there is no run to talk to."""


@dataclass(frozen=True, slots=True)
class RunningRun:
    """A run that goes on: its process, folder, socket, scenario, and when it began.

    process_start : of its process, in ticks since boot; "" where it is not known.
    """

    pid: int
    folder: str
    socket: str
    scenario: str
    started_utc: str
    process_start: str = ""

    @property
    def process(self) -> RunProcess:
        """Its process, which is never a later one with the same number."""
        process = RunProcess()
        process.note(self.pid, self.process_start)
        return process


@dataclass(frozen=True, slots=True)
class ServerSettings:
    """What the process needs to know. hello : the greeting, without version. period_s : of the control steps."""

    socket: Path
    run: RunningRun
    hello: dict[str, object]
    period_s: float = 0.0


def runtime_dir() -> Path:
    """The folder of this user where running runs are listed; it need not exist."""
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    return Path(base) / "fourtank-hil" if base else _without_session()


def _without_session() -> Path:
    """The same for a program that has no XDG_RUNTIME_DIR, such as one that cron or sudo has started."""
    return Path(f"/tmp/fourtank-hil-{os.getuid()}")  # noqa: S108


def made_runtime_dir() -> Path:
    """The same, made if it is not there; another user's, or one that others may write to, is refused."""
    path = runtime_dir()
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.lstat()
    except OSError as error:
        raise ControlError(f"{path} can't be made: {error.strerror}") from None
    if not _is_mine_alone(found):
        raise ControlError(f"{path} must be a folder of this user alone (mode 0700)")
    return path


def _is_mine_alone(found: os.stat_result) -> bool:
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not stat.S_IMODE(found.st_mode) & 0o077


def place_of(folder: Path, wanted: Path | None, pid: int) -> Path:
    """Where a run listens. Raises ControlError for a wanted path that is too long."""
    if wanted is not None:
        path = wanted.absolute()
        size = len(os.fsencode(path))
        if size > MAX_PATH_BYTES:
            raise ControlError(f"--control {wanted}: {size} bytes, a socket's path may have {MAX_PATH_BYTES}")
        return path
    path = (folder / SOCKET_NAME).absolute()
    if len(os.fsencode(path)) <= MAX_PATH_BYTES and _takes_sockets(path):
        return path
    return made_runtime_dir() / f"{pid}.sock"


def listen(path: Path) -> socket.socket:
    """A socket at the path that only this user can connect to; one that a killed run has left is replaced.

    Raises ControlError. Changes the umask for a moment: call it from a process with one thread.
    """
    server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    before = os.umask(0o177)
    try:
        with _locked(path.parent):
            _make_way(path)
            server.bind(os.fspath(path))
            server.listen(16)
    except OSError as error:
        server.close()
        raise ControlError(f"no control channel at {path}: {error.strerror or error}") from None
    except ControlError:
        server.close()
        raise
    finally:
        os.umask(before)
    return server


def running_runs() -> list[RunningRun]:
    """The runs of this user that go on, the oldest first; also those whose channel is lost. Other lists are removed."""
    runs = []
    for folder in {runtime_dir(), _without_session()}:
        with suppress(OSError):
            if not _is_mine_alone(folder.lstat()):
                continue  # whoever may write there could name a process to be stopped
            for path in folder.glob("*.json"):
                run = _read(path)
                if run is None:
                    continue
                if run.process.is_alive:
                    runs.append(run)
                else:
                    path.unlink(missing_ok=True)
    return sorted(runs, key=lambda run: run.started_utc)


def announce(run: RunningRun) -> Path:
    """Write the file by which clients find a run."""
    path = made_runtime_dir() / f"{run.pid}.json"
    path.unlink(missing_ok=True)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(json.dumps(asdict(replace(run, process_start=start_time(run.pid)))) + "\n")
    return path


def is_listening(path: Path) -> bool:
    """Whether a run answers there."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(PROBE_TIMEOUT_S)
        try:
            probe.connect(os.fspath(path))
        except (TimeoutError, BlockingIOError):
            return True  # its queue of new clients is full
        except (OSError, ValueError):
            return False
    return True


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Two runs that begin at once must not take each other's socket for a left one."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _make_way(path: Path) -> None:
    """Remove a socket on which nobody listens. Raises ControlError when somebody does, or it is no socket."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise ControlError(f"no control channel at {path}: a file is there that is no socket")
    if is_listening(path):
        raise ControlError(f"no control channel at {path}: another run listens there")
    path.unlink(missing_ok=True)


def _takes_sockets(path: Path) -> bool:
    """Whether the folder's file system has sockets: some that are shared with other systems do not."""
    probe = path.with_name(".socket")
    try:
        if len(os.fsencode(probe)) > MAX_PATH_BYTES:
            return False
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as test:
            test.bind(os.fspath(probe))
    except OSError:
        return False
    finally:
        with suppress(OSError):
            probe.unlink()
    return True


def _read(path: Path) -> RunningRun | None:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        run = RunningRun(**data)
    except (OSError, ValueError, TypeError):
        return None
    texts = (run.folder, run.socket, run.scenario, run.started_utc, run.process_start)
    return run if isinstance(run.pid, int) and all(isinstance(text, str) for text in texts) else None
