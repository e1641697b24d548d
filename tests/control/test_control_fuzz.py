"""Whatever is sent to the socket: the process and the control steps go on, and each answer is a message.

`CONTROL_FUZZ_EXAMPLES=20000 pytest -m long tests/control/test_control_fuzz.py` takes some ten minutes.
"""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil.core.types import Mode
from tests.control.control_bench import Bench
from tests.control.test_control_messages import MESSAGES

EXAMPLES = int(os.environ.get("CONTROL_FUZZ_EXAMPLES", "60"))
MAX_MEMORY_KB = 200_000

GOOD = st.sampled_from(
    [
        b'{"do": "reference", "change_V": [0.1, null], "ramp_s": 3}',
        b'{"do": "reference", "levels_cm": [12, 12.5]}',
        b'{"do": "manual", "voltage_V": [3, null]}',
        b'{"do": "auto"}',
        b'{"do": "hold"}',
        b'{"do": "resume"}',
        b'{"do": "ack", "alarm": "all"}',
        b'{"do": "bypass", "interlock": "dry_run", "for_s": 1}',
        b'{"do": "subscribe", "rate_hz": 20}',
        b'{"do": "state"}',
        b'{"do": "clear"}',
    ]
)
LINES = st.lists(MESSAGES | GOOD | st.binary(max_size=300), max_size=6).map(b"\n".join)


@pytest.mark.long
@settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck))
@given(data=LINES, ends=st.booleans())
def test_whatever_a_client_sends_the_run_goes_on(bench: Bench, data: bytes, ends: bool) -> None:
    connection = bench.raw()
    connection.setblocking(False)
    received = b""
    with connection, suppress(BlockingIOError, ConnectionError):
        connection.sendall(data + (b"\n" if ends else b""))
        for _ in range(3):
            bench.step()
            assert bench.state.supervision.cause is None, "no request trips the rig"
            with suppress(BlockingIOError):
                received += connection.recv(1 << 20)
    for line in received.split(b"\n")[:-1]:
        assert json.loads(line)["v"] == 1
    assert bench.channel._process.poll() is None
    assert memory_kb(bench.channel._process.pid) < MAX_MEMORY_KB
    assert "control_lost" not in bench.codes()
    bench.events.clear()
    if bench.state.supervision.mode not in (Mode.RUNNING, Mode.MANUAL):
        assert b"stop" in data
        bench.restart()


def memory_kb(pid: int) -> int:
    """Resident memory of a process."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))
