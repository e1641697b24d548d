"""CAN interfaces of the kernel: made, taken down, unplugged and plugged in again by tests.

On a host only interfaces made here are touched: its can0 may be a rig.
"""

import socket
import subprocess
import time
from pathlib import Path

import can

from hil.edge.can.bus import BusAddress, BusPort
from tests.waiting import wait_for

BITRATE = 500_000
GUEST = Path("/run/job/command.sh")
"""There only in the guest, where nobody's rig is."""


def ip(*words: str | int) -> str:
    done = subprocess.run(["ip", *map(str, words)], check=False, capture_output=True, text=True)
    assert done.returncode == 0, (words, done.stderr)
    return done.stdout


def is_there(name: str) -> bool:
    return name in (one for _, one in socket.if_nameindex())


def is_up(name: str) -> int:
    """By its flags; the state that `ip` shows follows later."""
    return int(Path(f"/sys/class/net/{name}/flags").read_text(), 16) & 1


class Loop:
    """A vcan: what one socket sends all others receive."""

    near = far = "vhil0"
    frame_s = 0.0
    remote_length = 7

    def __init__(self) -> None:
        self.plug()

    def down(self, end: str | None = None) -> None:
        ip("link", "set", end or self.near, "down")

    def up(self, end: str | None = None) -> None:
        ip("link", "set", end or self.near, "up")

    def unplug(self, end: str | None = None) -> None:
        ip("link", "del", end or self.near)

    def plug(self) -> None:
        """Back again and up."""
        if not is_there(self.near):
            ip("link", "add", self.near, "type", "vcan")
        self.up()

    def remove(self) -> None:
        if is_there(self.near):
            self.unplug()


class Cable:
    """Two ends: a vxcan, or in the guest can0 and can1, which are PCI cards."""

    def __init__(self) -> None:
        self.is_real = GUEST.exists()
        self.frame_s = 0.003 * self.is_real  # the emulated wire takes no time, and the receiver holds five frames
        self.near, self.far = ("can0", "can1") if self.is_real else ("vhil1", "vhil2")
        self.remote_length = 0 if self.is_real else 7  # the emulated card stores the data that a remote frame has not
        self._cards = {}
        if self.is_real:
            self._cards = {end: Path(f"/sys/class/net/{end}/device").resolve() for end in (self.near, self.far)}
        self.plug()

    def down(self, end: str) -> None:
        ip("link", "set", end, "down")

    def up(self, end: str) -> None:
        ip("link", "set", end, "up", *(("type", "can", "bitrate", BITRATE) if self.is_real else ()))

    def unplug(self, end: str) -> None:
        if self.is_real:
            (self._cards[end] / "remove").write_text("1")
        else:
            ip("link", "del", end)

    def plug(self) -> None:
        """Both ends back and up."""
        if self.is_real and not all(map(is_there, (self.near, self.far))):
            Path("/sys/bus/pci/rescan").write_text("1")
            wait_for(lambda: all(map(is_there, (self.near, self.far))))
        elif not self.is_real and not is_there(self.near):
            ip("link", "add", self.near, "type", "vxcan", "peer", "name", self.far)
        for end in (self.near, self.far):
            if not is_up(end):
                self.up(end)

    def remove(self) -> None:
        for end in (self.near, self.far):
            if is_there(end):
                self.down(end) if self.is_real else self.unplug(end)


class KernelFar:
    """A second node on interfaces of the kernel, for what every bus has to do."""

    def __init__(self, links: Loop | Cable, ids: tuple[int, int, int, int, int, int]) -> None:
        self._links = links
        self.remote_length = links.remote_length
        links.plug()
        self.port = BusPort(BusAddress("socketcan", links.near, BITRATE).open(ids))
        self._bus = can.Bus(links.far, "socketcan", ignore_config=True)

    def send(self, *frames: can.Message) -> None:
        for one in frames:
            self._bus.send(one, timeout=1.0)
            time.sleep(self._links.frame_s)

    def received(self, count: int) -> list[can.Message | None]:
        frames = [self._bus.recv(1.0) for _ in range(count)]
        assert self._bus.recv(0.02) is None
        return frames

    def vanish(self) -> None:
        self._links.unplug(self._links.near)

    def close(self) -> None:
        self.port.close()
        self._bus.shutdown()
        self._links.plug()
