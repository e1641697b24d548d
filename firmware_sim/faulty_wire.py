"""The wire between nodes and bus while frame or bus faults are active.

The rig sends frames through here only while `is_active`; a healthy bus costs no time.
"""

import heapq
from collections.abc import Callable
from itertools import count

from can import Message

from firmware_sim.faults.effects import NS_PER_S, Effects, Source, Stage
from firmware_sim.frames import COMMAND_ID, remade

FOREIGN = -1


class FaultyWire:
    """Stages, delays and unknown senders, in the order of their times on the emulator's clock.

    send : puts a frame on the bus. receive : gives a frame to the pump node at a time in ns. next_counter : the
    counter that the pump node would accept next.
    """

    def __init__(
        self,
        send: Callable[[Message], None],
        receive: Callable[[Message, int], object],
        next_counter: Callable[[], int],
    ) -> None:
        self._send = send
        self._receive = receive
        self._next_counter = next_counter
        self._effects = Effects()
        self._stages: dict[int, list[Stage]] = {}
        self._sources: list[Source] = []
        self._delayed: list[tuple[int, int, int, Message]] = []
        self._number = count()
        self.is_active = False

    @property
    def next_ns(self) -> int | None:
        """When the next delayed or foreign frame is due, or None."""
        if not self._sources and not self._delayed:
            return None
        due_ns = [source.next_ns for source in self._sources]
        if self._delayed:
            due_ns.append(self._delayed[0][0])
        return min(due_ns, default=None)

    def apply_effects(self, effects: Effects, now_ns: int) -> None:
        """Use these effects from now on; a stage that ends passes on the frames that it held back."""
        before, self._effects = self._stages, effects
        self._stages = {
            can_id: [stage for _, stage in sorted(stages.items())] for can_id, stages in effects.stages.items()
        }
        for can_id, stages in before.items():
            for stage in stages:
                if stage not in self._stages.get(can_id, []):
                    for frame in stage.rest():
                        self._deliver(can_id, frame, now_ns)
        self._sources = list(effects.sources.values())
        for source in self._sources:
            source.skip_to(now_ns)
        self.is_active = bool(
            effects.stages or effects.delay_ns or effects.muted or effects.is_bus_off or effects.is_jammed
        )

    def carry(self, can_id: int, frame: Message, now_ns: int) -> None:
        """Take a frame from its sender: a node, or the bus for PumpCommand and FOREIGN."""
        if self._is_cut(can_id):
            return
        frames = [frame]
        for stage in self._stages.get(can_id, ()):
            frames = [after for before in frames for after in stage(before)]
        delay_ns = self._effects.delay_ns.get(can_id, 0)
        for passed in frames:
            if delay_ns:
                heapq.heappush(self._delayed, (now_ns + delay_ns, next(self._number), can_id, passed))
            else:
                self._deliver(can_id, passed, now_ns)

    def run_due(self, now_ns: int) -> None:
        """Deliver the delayed frames and send the foreign ones that are due."""
        while self._delayed and self._delayed[0][0] <= now_ns:
            _, _, can_id, frame = heapq.heappop(self._delayed)
            if not self._is_cut(can_id):
                self._deliver(can_id, frame, now_ns)
        for source in self._sources:
            while source.next_ns <= now_ns:
                source.next_ns += source.period_ns
                self._send_foreign(source.frame(now_ns, self._next_counter()), now_ns)

    def _is_cut(self, can_id: int) -> bool:
        effects = self._effects
        return effects.is_bus_off or effects.is_jammed or can_id in effects.muted

    def _deliver(self, can_id: int, frame: Message, now_ns: int) -> None:
        if can_id in (COMMAND_ID, FOREIGN):
            self._receive(frame, now_ns)
        else:
            time_s = now_ns / NS_PER_S
            self._send(frame if frame.timestamp == time_s else remade(frame, timestamp_s=time_s))

    def _send_foreign(self, frame: Message, now_ns: int) -> None:
        """Send an unknown sender's frame unless the bus is off; a command also goes to the pump node."""
        is_command = frame.arbitration_id == COMMAND_ID and not frame.is_error_frame
        if self._effects.is_bus_off or (is_command and self._effects.is_jammed):
            return
        self._send(frame)
        if is_command:
            self.carry(COMMAND_ID, frame, now_ns)
