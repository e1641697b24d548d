"""Starts `hil` and `firmware-sim` without paying for their imports each time.

    test -> ForkedProgram -> fork server (has imported the libraries once) -> fork -> main() of the console script

What runs is a real process: it has its own descriptors, folder, environment and signals, it can be killed, and it ends
as the console script does. Only the loading of libraries is not repeated. Where the start itself is tested, use the
console script. One server serves one test process and ends with it.
"""

from __future__ import annotations

import atexit
import gc
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

ROOT = Path(__file__).resolve().parents[1]
MAX_REQUEST = 1 << 20
DESCRIPTORS = 4
"""That come with each request: standard input, output and error of the program, and the socket for its exit code."""


class ForkedProgram:
    """A running program of ours, with the methods of `subprocess.Popen` that tests use.

    command : its name, `hil` or `firmware-sim`, and its arguments. stdin : a descriptor; default: that of this process.
    """

    def __init__(self, command: Sequence[object], *, stdin: int = 0) -> None:
        self.args = [str(word) for word in command]
        self.returncode: int | None = None
        request = {"command": self.args, "folder": str(Path.cwd()), "environment": dict(os.environ)}
        self._status, their_status = socket.socketpair()
        (out_read, out_write), (err_read, err_write) = os.pipe(), os.pipe()
        socket.send_fds(_server(), [json.dumps(request).encode()], [stdin, out_write, err_write, their_status.fileno()])
        their_status.close()
        os.close(out_write)
        os.close(err_write)
        self.stdout: IO[str] = open(out_read, encoding="utf-8")  # noqa: SIM115, PTH123 - closed by `communicate`
        self.stderr: IO[str] = open(err_read, encoding="utf-8")  # noqa: SIM115, PTH123
        self.pid = self._next_number()

    def poll(self) -> int | None:
        """Exit code, negative after a signal; None while it runs."""
        if self.returncode is None and select.select([self._status], [], [], 0.0)[0]:
            self.returncode = self._next_number()
            self._status.close()
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """The exit code, once there is one. Raises subprocess.TimeoutExpired."""
        if self.returncode is None:
            select.select([self._status], [], [], timeout)
        if self.poll() is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        assert self.returncode is not None
        return self.returncode

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Read both outputs to their end, then wait. Raises subprocess.TimeoutExpired."""
        end_s = time.monotonic() + (1e6 if timeout is None else timeout)
        read: dict[int, bytes] = {file.fileno(): b"" for file in (self.stdout, self.stderr) if not file.closed}
        texts = list(read)
        is_open = set(texts)
        while is_open:
            ready, _, _ = select.select(is_open, [], [], max(end_s - time.monotonic(), 0.0))
            if not ready:
                raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
            for descriptor in ready:
                data = os.read(descriptor, 65536)
                read[descriptor] += data
                if not data:
                    is_open.discard(descriptor)
        self.wait(max(end_s - time.monotonic(), 0.0))
        self.stdout.close()
        self.stderr.close()
        out, err = (read[text].decode() for text in texts) if texts else ("", "")
        return out, err

    def send_signal(self, number: int) -> None:
        """Send it, unless the program has ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def terminate(self) -> None:
        """SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def _next_number(self) -> int:
        line = b""
        while not line.endswith(b"\n"):
            byte = self._status.recv(1)
            assert byte, "the fork server has ended"
            line += byte
        return int(line)


def run(command: Sequence[object], *, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
    """Run a program of ours to its end, as `subprocess.run` does."""
    program = ForkedProgram(command)
    try:
        out, err = program.communicate(timeout)
    finally:
        program.kill()
    return subprocess.CompletedProcess(program.args, program.wait(), out, err)


@cache
def _server() -> socket.socket:
    """The line to this process's server, which is started by its first use."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        server = subprocess.Popen(
            [sys.executable, "-m", "tests.fork_server", str(theirs.fileno())],
            cwd=ROOT,
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # a process with threads should not be forked
        )

    def end() -> None:
        ours.close()
        server.wait(10.0)

    atexit.register(end)
    return ours


# --- the server ---


def _mains() -> dict[str, Callable[[], None]]:
    """The entry points; all that their commands use is imported, and what is compiled is loaded."""
    import firmware_sim.change_record
    import firmware_sim.cli
    import firmware_sim.command_server
    import firmware_sim.links
    import firmware_sim.ports
    import firmware_sim.rig
    import firmware_sim.serve
    import firmware_sim.settings
    import hil.bench.live_run
    import hil.bench.user_errors
    import hil.cli.app
    import hil.cli.conformance_command
    import hil.cli.doctor_command
    import hil.cli.run_display
    import hil.core.identification.estimate
    import hil.edge.can.slcan_bus
    import hil.review.run_report
    from hil.core.diagnosis.glr.__main__ import compile_ahead

    compile_ahead()
    return {"hil": hil.cli.app.main, "firmware-sim": firmware_sim.cli.main}


class _Server:
    """Forks on request, and reports how each child has ended."""

    def __init__(self, requests: socket.socket) -> None:
        self._requests = requests
        self._children: dict[int, tuple[int, socket.socket]] = {}  # by pidfd: pid, where its exit code goes

    def serve(self) -> list[str]:
        """Until the tests have ended: an empty list. In each child: its command, to be run."""
        poller = select.poll()
        poller.register(self._requests, select.POLLIN)
        while True:
            for descriptor, _ in poller.poll():
                if descriptor in self._children:
                    poller.unregister(descriptor)
                    self._report(descriptor)
                    continue
                message, descriptors, _, _ = socket.recv_fds(self._requests, MAX_REQUEST, DESCRIPTORS)
                if not message:
                    self._end()
                    return []
                request = json.loads(message)
                pid = os.fork()
                if pid == 0:
                    self._become(request, descriptors)
                    return list(request["command"])
                poller.register(self._keep(pid, descriptors), select.POLLIN)

    def _keep(self, pid: int, descriptors: list[int]) -> int:
        *streams, status = descriptors
        for stream in streams:
            os.close(stream)
        line = socket.socket(fileno=status)
        line.send(b"%d\n" % pid)
        pidfd = os.pidfd_open(pid)
        self._children[pidfd] = (pid, line)
        return pidfd

    def _report(self, pidfd: int) -> None:
        pid, line = self._children.pop(pidfd)
        _, status = os.waitpid(pid, 0)
        os.close(pidfd)
        with line, suppress(OSError):
            line.send(b"%d\n" % os.waitstatus_to_exitcode(status))

    def _end(self) -> None:
        for pid, _ in self._children.values():
            os.kill(pid, signal.SIGKILL)
        for pidfd in list(self._children):
            self._report(pidfd)

    def _become(self, request: dict[str, Any], descriptors: list[int]) -> None:
        """In the child: take on its descriptors, folder, environment and arguments."""
        for pidfd, (_, line) in self._children.items():
            os.close(pidfd)
            line.close()
        self._requests.close()
        for number, descriptor in enumerate(descriptors[:3]):
            os.dup2(descriptor, number)
        for descriptor in descriptors:
            os.close(descriptor)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.chdir(str(request["folder"]))
        os.environ.clear()
        os.environ.update(request["environment"])
        sys.argv = list(request["command"])


def main(descriptor: int) -> None:
    """The server, and then, in each child, the program."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the tests, and they end the server
    with ExitStack() as stack:
        requests = stack.enter_context(socket.socket(fileno=descriptor))
        mains = _mains()
        threads = [entry.name for entry in Path("/proc/self/task").iterdir()]
        assert len(threads) == 1, "a process with threads should not be forked"
        gc.collect()
        gc.freeze()
        command = _Server(requests).serve()
    if command:
        mains[Path(command[0]).name]()


if __name__ == "__main__":
    main(int(sys.argv[1]))
