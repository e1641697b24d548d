"""The rig in real time: one thread, one port, absolute deadlines on the monotonic clock.

`serve` ends, by `stop` or by an exception, with the outputs at 0 V and a report of that.
"""

import selectors
import time
from collections.abc import Callable

from firmware_sim.command_server import CommandServer
from firmware_sim.faults import NS_PER_S
from firmware_sim.ports import Port
from firmware_sim.rig import Rig

MAX_WAIT_S = 0.02
POLL_S = 0.001
STALE_NS = 100_000_000
MAX_FAILING_NS = 5 * NS_PER_S


class PortLostError(RuntimeError):
    """The port has failed for longer than 5 s."""


class Service:
    """Runs a rig on a port until `stop`. The rig's time 0 is the time of construction.

    commands : the source of commands for the rig; closed with the port.
    """

    def __init__(
        self,
        rig: Rig,
        port: Port,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        commands: CommandServer | None = None,
    ) -> None:
        self._rig = rig
        self._port = port
        self._commands = CommandServer(rig) if commands is None else commands
        self._monotonic_ns = monotonic_ns
        self._power_up_ns = monotonic_ns()
        self._failing_since_ns: int | None = None
        self._is_stopping = False
        self.stale_frames = 0

    def stop(self) -> None:
        """Make `serve` return soon; may be called from a signal handler."""
        self._is_stopping = True

    def serve(self) -> None:
        """Run until stopped. Raises PortLostError, and whatever the rig's observer raises."""
        try:
            with selectors.SelectSelector() as selector:
                while not self._is_stopping:
                    self._wait(selector)
                    self._turn(self._now_ns())
        finally:
            try:
                self._rig.power_off(self._now_ns())
            finally:
                self._port.close()
                self._commands.close()

    def _now_ns(self) -> int:
        return self._monotonic_ns() - self._power_up_ns

    def _turn(self, now_ns: int) -> None:
        """Read, advance, send. After a long stall only what is still fresh is sent, not a burst."""
        self._note_health(self._port.read(now_ns), now_ns)
        self._commands.read(now_ns)
        frames = self._rig.advance(now_ns)
        oldest_s = (now_ns - STALE_NS) / NS_PER_S
        fresh = [frame for frame in frames if frame.timestamp >= oldest_s]
        self.stale_frames += len(frames) - len(fresh)
        self._port.send(fresh)

    def _note_health(self, is_healthy: bool, now_ns: int) -> None:
        if is_healthy:
            self._failing_since_ns = None
        elif self._failing_since_ns is None:
            self._failing_since_ns = now_ns
        elif now_ns - self._failing_since_ns > MAX_FAILING_NS:
            raise PortLostError(f"the port has failed for {MAX_FAILING_NS // NS_PER_S} s")

    def _wait(self, selector: selectors.BaseSelector) -> None:
        """Sleep until the rig's next event or until there is something to read."""
        is_failing = self._failing_since_ns is not None
        of_port = [] if is_failing else self._port.filenos()
        wanted = {*of_port, *self._commands.filenos()}
        watched = set(selector.get_map())
        for fd in watched - wanted:
            selector.unregister(fd)
        for fd in wanted - watched:
            selector.register(fd, selectors.EVENT_READ)
        longest_s = MAX_WAIT_S if of_port or is_failing else POLL_S
        due_s = (self._rig.next_event_ns - self._now_ns()) / NS_PER_S
        selector.select(min(max(due_s, 0.0), longest_s))
