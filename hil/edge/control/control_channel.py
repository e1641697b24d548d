"""The control thread's end of the control channel: at each step one bounded read and one write, neither of which waits.

The clients are served by a process of its own, `hil.edge.control.server`. What it does not take at once is dropped (the
state) or kept for the next step within limits (answers, events). If it dies, is stopped or hangs, the run goes on.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import socket
import subprocess
import sys
from collections import deque
from types import TracebackType
from typing import Any

from hil.core.controller import ControllerConfig, ControllerState, Output
from hil.core.live_request import MOVES_WATER, LiveAction, LiveRequest
from hil.core.live_view import view
from hil.core.types import Event, Inputs, Severity
from hil.edge.control.handed_request import unpacked
from hil.edge.control.socket_path import ControlError, ServerSettings

MAX_READS = 10
"""Requests in a step."""

MAX_MESSAGE = 1 << 16
MAX_WAITING = 40
MAX_KEPT = 200
"""Answers and events that are kept for a process that takes nothing."""

MAX_SENT = 100_000
"""Bytes in one write: the socket would refuse one of some 200 kB for ever. The oldest events are dropped."""

MAX_STATE_HZ = 20.0
START_TIMEOUT_S = 30.0
CLOSE_TIMEOUT_S = 1.0


class ControlChannel:
    """A `hil.loop.OperatorChannel`. Use as a context; the process starts at once, `open` tells it where to listen."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - ourselves
                [sys.executable, "-m", "hil.edge.control.server", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                env={**os.environ},
                start_new_session=True,  # Ctrl-C and a closed terminal are for the controller alone
            )
        self._config: ControllerConfig | None = None
        self._waiting: deque[LiveRequest] = deque()
        self._handed: tuple[int, ...] = ()
        self._answers: deque[tuple[int, float | None, str, str]] = deque(maxlen=MAX_KEPT)
        self._events: deque[dict[str, object]] = deque(maxlen=MAX_KEPT)
        self._sent_ns = -(10**18)
        self._lost = ""

    def __enter__(self) -> ControlChannel:
        """Nothing to do: the process is on its way up."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Disconnect: the process removes its socket and ends; one that does not is killed."""
        self._socket.close()
        try:
            self._process.wait(CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def open(self, settings: ServerSettings, config: ControllerConfig) -> None:
        """Listen. settings : what the process needs. Raises ControlError when it can't."""
        self._socket.settimeout(START_TIMEOUT_S)
        try:
            self._socket.send(pickle.dumps(settings))
            answer: Any = pickle.loads(self._socket.recv(MAX_MESSAGE) or pickle.dumps("its process ended"))  # noqa: S301 - our own child
        except OSError as error:
            answer = f"no control channel: {error}"
        if answer is not None:
            raise ControlError(str(answer))
        self._socket.setblocking(False)
        self._config = config

    @property
    def is_open(self) -> bool:
        """Whether requests can still come: it was opened, and its process is there as far as is known."""
        return self._config is not None and not self._lost

    def requests(self) -> tuple[LiveRequest, ...]:
        """Those for this step: at most one of them moves water; a stop goes before all others."""
        self._read()
        taken: list[LiveRequest] = []
        stops = [request for request in self._waiting if request.action is LiveAction.STOP]
        if stops:
            self._waiting.remove(stops[0])
            taken.append(stops[0])
        while self._waiting and len(taken) < MAX_READS:
            request = self._waiting[0]
            if request.action in MOVES_WATER and any(one.action in MOVES_WATER for one in taken):
                break
            taken.append(self._waiting.popleft())
        self._handed = tuple(request.number for request in taken)
        return tuple(taken)

    def show(self, inputs: Inputs, output: Output, state: ControllerState, now_ns: int) -> tuple[Event, ...]:
        """Hand over answers, events and the state of this step. Returns an event once the process is lost."""
        if self._lost or self._config is None:
            return self._loss()
        t_s = None if state.loop is None else state.loop.t_s
        answered = {answer.number for answer in output.answers}
        self._answers.extend((answer.number, t_s, answer.text, answer.reason) for answer in output.answers)
        for number in self._handed:
            if number not in answered:
                self._answers.append((number, t_s, "the control step has failed", "step_failed"))
        self._events.extend(_as_sent(event, t_s) for event in output.events)
        if (now_ns - self._sent_ns) * 1e-9 < 0.9 / MAX_STATE_HZ and not (self._answers or self._events):
            return ()
        shown = view(self._config, state, inputs, output, now_ns)
        if self._hand_over(shown):
            self._sent_ns = now_ns
        return self._loss()

    def close(self, t_s: float, text: str) -> None:
        """Tell clients how the run ended."""
        if self._lost or self._config is None:
            return
        self._events.append(_as_sent(Event(Severity.INFO, "end", text), t_s))
        self._hand_over(None)

    def _loss(self) -> tuple[Event, ...]:
        """The event of a lost process, once."""
        if not self._lost or self._config is None:
            return ()
        self._config, text = None, f"no control channel any more, the run goes on: {self._lost}"
        return (Event(Severity.WARNING, "control_lost", text),)

    def _read(self) -> None:
        for _ in range(MAX_READS):
            if self._config is None or self._lost or len(self._waiting) >= MAX_WAITING:
                return
            try:
                data = self._socket.recv(MAX_MESSAGE)
            except BlockingIOError:
                return
            except OSError as error:
                self._lost = f"its process is lost: {error.strerror}"
                return
            if not data:
                self._lost = "its process ended"
                return
            with contextlib.suppress(KeyError, TypeError, ValueError):
                self._waiting.append(unpacked(data))

    def _hand_over(self, shown: dict[str, object] | None) -> bool:
        """One write that does not wait; answers and events that were not taken stay for the next step."""
        data = self._packed(shown)
        while len(data) > MAX_SENT and self._events:
            for _ in range(-(-len(self._events) // 2)):
                self._events.popleft()
            data = self._packed(shown)
        try:
            self._socket.send(data)
        except BlockingIOError:
            return False
        except OSError as error:
            self._lost = f"its process is lost: {error.strerror}"
            return False
        self._answers.clear()
        self._events.clear()
        return True

    def _packed(self, shown: dict[str, object] | None) -> bytes:
        return pickle.dumps((tuple(self._answers), tuple(self._events), shown), pickle.HIGHEST_PROTOCOL)


def _as_sent(event: Event, t_s: float | None) -> dict[str, object]:
    return {
        "t_s": t_s,
        "severity": str(event.severity),
        "code": event.code,
        "text": event.text,
        "data": event.data,
    }
