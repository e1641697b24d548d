"""The process that serves the clients of a run's control channel, and never the control thread.

    clients <- Unix socket -> this process <- socket pair -> ControlChannel in the control thread

Whatever clients do ends here: lines that are too long or wrong, too many of them, clients that do not read. Of what
they ask, only checked requests reach the control thread, a few at a time, a stop before all others. The limits are
those of docs/reference/control-channel.md.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import selectors
import signal
import socket
import sys
import time
from collections import deque

from hil.core.live_request import Author
from hil.edge.control.client_connection import MAX_STATE_BACKLOG, ClientConnection
from hil.edge.control.handed_request import packed
from hil.edge.control.listening_place import ListeningPlace
from hil.edge.control.messages import (
    VERSION,
    ClientRequest,
    MessageError,
    SubscribeRequest,
    answer_line,
    live_request,
    parse,
    to_line,
)
from hil.edge.control.socket_path import ServerSettings
from hil.edge.control.step_rhythm import StepRhythm
from hil.edge.host.background import step_back

MAX_CLIENTS = 32
STOP_PLACES = 8
"""Clients beyond that: a stop is all that they can ask for. The oldest of them makes room for the next."""

MAX_WAITING = 20
"""Requests that the control thread has not answered yet. A stop is taken beyond that, up to twice as many: then there
are others among them."""

MAX_MESSAGE = 1 << 18
ROUND_S = 0.25
RENEW_S = 1.0
"""How often the server looks whether clients can still find it."""

REST_S = 0.1
"""A client that has sent too much is not read for so long; nobody is let in for so long after one too many."""

Answer = tuple[int, float | None, str, str]
"""number, run time, text, reason."""

Update = tuple[tuple[Answer, ...], tuple[dict[str, object], ...], dict[str, object] | None]
"""What the control thread hands over after a step: answers, events, and the state."""


class ControlServer:
    """line : to the control thread. place : where clients connect. period_s : of the control steps; 0: unknown."""

    def __init__(
        self, line: socket.socket, place: ListeningPlace, hello: dict[str, object], period_s: float = 0.0
    ) -> None:
        self._line, self._place, self._listener = line, place, place.listener
        self._renew_at_s = time.monotonic() + RENEW_S
        self._rhythm = StepRhythm(period_s)
        self._hello = to_line({"v": VERSION, "hello": hello})
        self._clients: dict[int, ClientConnection] = {}
        self._waiting: dict[int, tuple[ClientConnection, object]] = {}
        self._outbox: deque[bytes] = deque()
        self._number = self._client_number = 0
        self._state: dict[str, object] | None = None
        self._t_s: float | None = None
        self._is_over = False
        self._accepts_at_s = 0.0
        self._selector = selectors.DefaultSelector()
        self._selector.register(line, selectors.EVENT_READ)
        self._selector.register(self._listener, selectors.EVENT_READ)

    def work(self) -> None:
        """Until the control thread is gone."""
        while not self._is_over:
            self._pause()
            for key, mask in self._selector.select(self._timeout_s()):
                if key.fileobj is self._line:
                    self._read_updates()
                elif self._rhythm.pause_s(time.monotonic()) > 0.0:
                    continue  # the selector says it again after the step
                elif key.fileobj is self._listener:
                    self._accept()
                else:
                    self._serve(key.data, mask)
            self._serve_rest()
            self._flush()
            self._renew()
        for client in list(self._clients.values()):
            client.flush()
            self._drop(client)

    def _pause(self) -> None:
        """Shortly before a control step, wait for it."""
        while not self._is_over and (pause_s := self._rhythm.pause_s(time.monotonic())) > 0.0:
            if select.select([self._line], [], [], pause_s)[0]:
                self._read_updates()

    def _timeout_s(self) -> float:
        now_s = time.monotonic()
        resting = [c.reads_at_s for c in self._clients.values() if c.reads_at_s > now_s]
        if self._accepts_at_s > now_s:
            resting.append(self._accepts_at_s)
        if any(c.has_lines and c.reads_at_s <= now_s for c in self._clients.values()):
            return 0.0
        free_s = self._rhythm.free_s(now_s)
        return min([ROUND_S, *(at_s - now_s for at_s in resting), *([] if free_s is None else [free_s])])

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # it has gone again, or there are too many files
            self._accepts_at_s = time.monotonic() + REST_S
            return
        connection.setblocking(False)
        self._client_number += 1
        client = ClientConnection.accepted(connection, self._client_number)
        if client is None:
            connection.close()
            return
        client.put(self._hello)
        self._clients[client.number] = client
        beyond = self._beyond()
        if beyond:
            self._accepts_at_s = time.monotonic() + REST_S
        if len(beyond) > STOP_PLACES:
            has_asked = {one.number for one, _ in self._waiting.values()}
            self._drop(next((one for one in beyond if one.number not in has_asked), beyond[0]))

    def _beyond(self) -> list[ClientConnection]:
        """The clients that are too many, the oldest first: those that have come last."""
        return list(self._clients.values())[MAX_CLIENTS:]

    def _renew(self) -> None:
        """Listen elsewhere when the socket was removed, as with its run folder."""
        now_s = time.monotonic()
        if now_s < self._renew_at_s:
            return
        self._renew_at_s = now_s + RENEW_S
        listener = self._place.renew()
        if listener is not None:
            if self._listener in self._selector.get_map():
                self._selector.unregister(self._listener)
            self._listener.close()
            self._listener = listener

    def _serve(self, client: ClientConnection, mask: int) -> None:
        if mask & selectors.EVENT_WRITE:
            client.flush()
        if mask & selectors.EVENT_READ and client.number in self._clients:
            for line in client.lines():
                self._take(client, line)

    def _serve_rest(self) -> None:
        """Clients of which lines were left over, as far as there is time."""
        for client in list(self._clients.values()):
            now_s = time.monotonic()
            if self._rhythm.pause_s(now_s) > 0.0:
                return
            if client.has_lines and client.reads_at_s <= now_s:
                self._serve(client, selectors.EVENT_READ)

    def _take(self, client: ClientConnection, line: bytes) -> None:
        now_s = time.monotonic()
        try:
            message = parse(line)
        except MessageError as error:
            client.may_ask(now_s)
            client.put(answer_line(error.request_id, self._t_s, str(error), "bad_request"))
            return
        is_stop = message.do == "stop"
        if not client.may_ask(now_s) and not is_stop:
            client.put(answer_line(message.id, self._t_s, "more than 20 requests in a second", "too_many"))
        elif not is_stop and client in self._beyond():
            text = f"{MAX_CLIENTS} clients are served already; one more can only stop the run"
            client.put(answer_line(message.id, self._t_s, text, "too_many"))
            client.flush()
            client.is_lost = True
        elif isinstance(message, SubscribeRequest):
            client.subscribe(message.rate_hz, message.events)
            client.put(answer_line(message.id, self._t_s, f"states at {message.rate_hz:g} Hz"))
        elif message.do == "state":
            self._send_state(client, message.id)
        else:
            self._forward(client, message)

    def _send_state(self, client: ClientConnection, request_id: object) -> None:
        if self._state is None:
            client.put(answer_line(request_id, None, "no control step was made yet", "not_while"))
            return
        client.put(answer_line(request_id, self._t_s, "state"))
        client.put(to_line({"v": VERSION, "state": self._state}))

    def _forward(self, client: ClientConnection, message: ClientRequest) -> None:
        is_stop = message.do == "stop"
        if len(self._waiting) >= (2 * MAX_WAITING if is_stop else MAX_WAITING):
            text = f"{MAX_WAITING} requests wait for the next control steps"
            client.put(answer_line(message.id, self._t_s, text, "too_many"))
            return
        self._number += 1
        request = live_request(message, self._number, Author(client.user, client.pid, client.number))
        self._waiting[self._number] = (client, message.id)
        data = packed(request)
        if is_stop:
            self._outbox.appendleft(data)
        else:
            self._outbox.append(data)

    def _read_updates(self) -> None:
        """All that the control thread has handed over; only the newest state counts."""
        with contextlib.suppress(BlockingIOError):
            try:
                while data := self._line.recv(MAX_MESSAGE):
                    self._update(pickle.loads(data))  # noqa: S301 - from our own parent
            except ConnectionError:
                pass
            self._is_over = True

    def _update(self, update: Update) -> None:
        answers, events, state = update
        for number, t_s, text, reason in answers:
            client, request_id = self._waiting.pop(number, (None, None))
            if client is not None:
                client.put(answer_line(request_id, t_s, text, reason))
        lines = [to_line({"v": VERSION, "event": event}) for event in events]
        for client in self._clients.values():
            if client.wants_events:
                for line in lines:
                    client.put(line)
        if state is None:
            return
        self._rhythm.stepped(time.monotonic())
        self._state, run_s = state, state.get("t_s")
        self._t_s = run_s if isinstance(run_s, float) else None
        now_s = time.monotonic()
        due = [c for c in self._clients.values() if c.backlog < MAX_STATE_BACKLOG and c.is_due(now_s)]
        if due:
            line = to_line({"v": VERSION, "state": state})
            for client in due:
                client.put(line)

    def _flush(self) -> None:
        """Hand over what waits, and tell the selector what to wait for."""
        while self._outbox:
            try:
                self._line.send(self._outbox[0])
            except BlockingIOError:
                break
            except OSError:
                self._is_over = True
                break
            self._outbox.popleft()
        now_s = time.monotonic()
        for client in list(self._clients.values()):
            client.flush()
            if client.is_lost:
                self._drop(client)
            else:
                client.select(self._selector, now_s)
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if self._outbox else 0)
        self._selector.modify(self._line, events)
        is_open, may_accept = self._listener in self._selector.get_map(), now_s >= self._accepts_at_s
        if may_accept and not is_open:
            self._selector.register(self._listener, selectors.EVENT_READ)
        elif is_open and not may_accept:
            self._selector.unregister(self._listener)

    def _drop(self, client: ClientConnection) -> None:
        client.close(self._selector)
        del self._clients[client.number]


def main(descriptor: int) -> int:
    """Serve one run, on the socket that its control thread has handed to this process."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)  # it ends when the run does
    with socket.socket(fileno=descriptor) as line:
        data = line.recv(MAX_MESSAGE)
        if not data:
            return 0
        settings: ServerSettings = pickle.loads(data)  # noqa: S301 - from our own parent
        try:
            place = ListeningPlace(settings.socket, settings.run)
        except Exception as error:  # noqa: BLE001 - whatever it is, the run says it in one line
            line.send(pickle.dumps(f"{error}"))
            return 1
        try:
            step_back()
            line.send(pickle.dumps(None))
            line.setblocking(False)
            ControlServer(line, place, settings.hello, settings.period_s).work()
        finally:
            place.remove()
    return 0


if __name__ == "__main__":
    os._exit(main(int(sys.argv[1])))
