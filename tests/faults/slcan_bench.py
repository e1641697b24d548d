"""A run in lockstep through a real slcan line, pty or TCP: both ends in one thread, every byte waited for.

The emulator's end is its own adapter; ours is the bus that `hil run -i slcan` opens, without filters. As a line brings
no time of sending, the frames that our end gets are stamped with that of the emulator's.
"""

import os
import select
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import TypeVar

import can

from firmware_sim.links import SlcanLink, listen, open_pty
from firmware_sim.slcan_port import SlcanPort
from hil.edge.can.slcan_bus import SlcanBus
from hil.edge.can.slcan_lines import LineReader
from tests.bus.bus_bench import BITRATE, answer_opening
from tests.faults.faults_bench import TIME_TOLERANCE_S, play

PATIENCE_S = 5.0
T = TypeVar("T")


class Host(SlcanBus):
    """Our end. It takes in all that the far end has said, and stamps it, before it says that there is nothing more.

    sent : lines that went out, so that the far end can wait for them.
    """

    far: "Far | None" = None
    sent = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        super().send(msg, timeout)
        self.sent += 1

    def recv(self, timeout: float | None = None) -> can.Message | None:
        assert timeout == 0.0, "lockstep never waits"
        assert self.far is not None
        self.far.deliver(self)
        return super().recv(0.0)

    def listen_to(self, far: "Far") -> None:
        feed = self.lines.feed

        def stamped(data: bytes, timestamp_s: float) -> list[can.Message]:
            del timestamp_s
            far.delivered += len(data)
            frames = feed(data)
            for frame in frames:
                frame.timestamp = far.stamps.popleft()
            return frames

        self.far = far
        vars(self.lines)["feed"] = stamped


class Far(can.BusABC):
    """The emulator's end, as the bus of its port.

    garble : what becomes of each frame's line on its way to us; answer_end : of each answer. refuses : whether the
    adapter answers commands with BELL. is_deaf : whether it has stopped to read. heard : commands that reached it.
    unplug : pulls the cable.
    """

    def __init__(self, fd: int, unplug: Callable[[], None], host: Host) -> None:
        super().__init__(channel="far")
        self._unplug, self._is_gone = unplug, False
        self._link = SlcanLink(fd)
        self._link.port.feed(b"O\r")
        self._host = host
        self._inbox: deque[can.Message] = deque()
        self._written = 0
        self._shadow = LineReader()
        self.stamps: deque[float] = deque()
        self.delivered = 0
        self.garble: Callable[[bytes], bytes] = lambda line: line
        self.answer_end: Callable[[bytes], bytes] = lambda line: line
        self.refuses = self.is_deaf = False
        self.heard = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        del timeout
        self.say(self.garble(self._link.port.frame_line(msg)), msg.timestamp)

    def say(self, data: bytes, timestamp_s: float = 0.0) -> None:
        """Bytes to us, whatever they are."""
        if self._is_gone:
            return
        self.stamps.extend([timestamp_s] * len(self._shadow.feed(data)))
        self._link.queue.put(data)
        self._written += len(data)
        self._link.flush()

    def unplug(self) -> None:
        self._is_gone = True
        self._unplug()

    def boot(self) -> None:
        """The adapter forgets that it was open."""
        self._link.port = SlcanPort()

    def recv(self, timeout: float | None = None) -> can.Message | None:
        del timeout
        while not (self.is_deaf or self._is_gone) and select.select([self._link.fd], [], [], self._wait_s())[0]:
            self._read()
        return self._inbox.popleft() if self._inbox else None

    def deliver(self, host: Host) -> None:
        """See that all that was said has arrived."""
        while not self._is_gone and self.delivered < self._written:
            self._link.flush()
            assert host._take_in(PATIENCE_S), "bytes got lost"
        assert self._link.queue.dropped == 0

    def _wait_s(self) -> float:
        """Whether anything is on its way: what a line takes is there at once over TCP, and soon after on a pty."""
        is_due = self._host.sent > self.heard
        return PATIENCE_S if is_due else 0.0

    def _read(self) -> None:
        data = os.read(self._link.fd, 4096)
        self.heard += data.count(b"\r")
        if self.refuses:
            self.say(b"\a" * data.count(b"\r"))
            return
        reply, frames = self._link.port.feed(data)
        self._inbox.extend(frames)
        self.say(self.answer_end(reply))


@contextmanager
def over_pty() -> Iterator[tuple[str, Callable[[], int], Callable[[], None]]]:
    """What our end opens; what gives the far end's descriptor once that is done; what closes it."""
    master, path = open_pty()
    held = os.open(path, os.O_RDWR | os.O_NOCTTY)  # without anybody the master would hang up
    try:
        with _closing_once(master, os.close) as close:
            yield path, lambda: master, close
    finally:
        os.close(held)


@contextmanager
def over_tcp() -> Iterator[tuple[str, Callable[[], int], Callable[[], None]]]:
    """The same."""
    with listen(0) as listener:
        listener.setblocking(True)
        clients: list[socket.socket] = []

        def accepted() -> int:
            client, _ = listener.accept()
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            clients.append(client)
            return client.fileno()

        with _closing_once(clients, lambda them: them[0].close()) as close:
            yield f"socket://127.0.0.1:{listener.getsockname()[1]}", accepted, close


@contextmanager
def _closing_once(what: T, how: Callable[[T], None]) -> Iterator[Callable[[], None]]:
    left = [what]

    def close() -> None:
        if left:
            how(left.pop())

    try:
        yield close
    finally:
        close()


class Line:
    """A pty or a TCP port to play on. host, far : the ends of the line that is open, or was last.

    opened : how often a line was opened. commands : lines that reached the far end. delivered : bytes that came back.
    """

    def __init__(
        self,
        line: Callable[[], AbstractContextManager[tuple[str, Callable[[], int], Callable[[], None]]]],
    ) -> None:
        self._line = line
        self.opened = self.commands = self.delivered = 0
        self.play = partial(play, ends=self.ends)

    @contextmanager
    def ends(self) -> Iterator[tuple[Host, Far]]:
        with self._line() as (channel, far_fd, unplug):
            found: list[int] = []

            def open_far() -> None:
                fd = far_fd()
                os.set_blocking(fd, True)
                answer_opening(lambda: os.read(fd, 4096), lambda data: os.write(fd, data))
                found.append(fd)

            opening = threading.Thread(target=open_far, daemon=True)
            opening.start()
            self.host = Host(channel, BITRATE)
            opening.join()
            try:
                self.far = Far(found[0], unplug, self.host)
                self.host.listen_to(self.far)
                self.opened += 1
                yield self.host, self.far
            finally:
                self.commands += self.far.heard
                self.delivered += self.far.delivered
                self.far.shutdown()
                self.host.shutdown()

    def at(self, at_s: float, act: Callable[[Far], object]) -> Callable[[float], None]:
        """What calls act(far) before the first step from at_s on."""
        due = [act]

        def on_step(t_s: float) -> None:
            if due and t_s >= at_s - TIME_TOLERANCE_S:
                due.pop()(self.far)

        return on_step
