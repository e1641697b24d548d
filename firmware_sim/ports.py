"""The rig on a python-can bus."""

from collections import Counter

from can import BusABC, CanError

from firmware_sim.rig import Rig

# What python-can buses raise beside CanError, slcan above all.
BUS_ERRORS = (CanError, OSError, ValueError, IndexError)


class BusPort:
    """Ties a rig to a bus; the caller owns both, and the clock.

    Errors of the bus are counted in `errors` ("receive", "send"); a frame that could not be sent is lost, as on a
    real bus. Frames are sent with the rig's own timestamps, which a virtual bus keeps if it was opened with
    preserve_timestamps=True.
    """

    def __init__(self, rig: Rig, bus: BusABC) -> None:
        self.rig = rig
        self.bus = bus
        self.errors: Counter[str] = Counter()

    def step(self, now_ns: int) -> None:
        """Hand every waiting frame to the rig as received now, advance it to now, send what it sends."""
        self.read(now_ns)
        self.write(now_ns)

    def read(self, now_ns: int) -> bool:
        """Hand every waiting frame to the rig; False if the bus failed."""
        try:
            while (frame := self.bus.recv(0)) is not None:
                self.rig.receive(frame, now_ns)
        except BUS_ERRORS:
            self.errors["receive"] += 1
            return False
        return True

    def write(self, now_ns: int) -> None:
        """Advance the rig and send what it sends."""
        for frame in self.rig.advance(now_ns):
            try:
                self.bus.send(frame, timeout=0)
            except BUS_ERRORS:
                self.errors["send"] += 1
