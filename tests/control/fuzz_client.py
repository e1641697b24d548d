"""A client that sends whatever hypothesis thinks of, without end: `python -m tests.control.fuzz_client SOCKET`.

After SIGUSR1 it still thinks, but sends nothing, until SIGUSR2: what it costs the computer is no affair of the run.
"""

from __future__ import annotations

import signal
import socket
import sys
import threading
import time
from contextlib import suppress

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from hil.edge.host.background import step_back
from tests.control.test_control_fuzz import LINES

REST_S = 2e-3
"""After each example, so that this program's own processor time is not what is measured."""


is_sending = threading.Event()


def send(path: str, data: bytes) -> None:
    """Send it all, and read what has come by then."""
    with socket.socket(socket.AF_UNIX) as one, suppress(OSError):
        one.settimeout(0.05)
        one.connect(path)
        one.sendall(data)
        one.recv(1 << 16)


def main(path: str) -> None:
    @settings(
        max_examples=500, database=None, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck)
    )
    @given(data=LINES, times=st.sampled_from([1, 1, 1, 1, 30, 2000]), ends=st.booleans())
    def example(data: bytes, times: int, ends: bool) -> None:
        if is_sending.is_set():
            send(path, data * times + (b"\n" if ends else b""))
        time.sleep(REST_S)

    is_sending.set()
    signal.signal(signal.SIGUSR1, lambda *_: is_sending.clear())
    signal.signal(signal.SIGUSR2, lambda *_: is_sending.set())
    step_back()
    while True:
        example()


if __name__ == "__main__":
    main(sys.argv[1])
