"""What a client sends at once, and what a run says at once, is handled in small pieces."""

from __future__ import annotations

import os
import signal
import socket

from hil.edge.control.client_connection import MAX_LINES, ClientConnection
from tests.control.control_bench import Bench
from tests.waiting import wait_for


def test_many_lines_in_one_read_are_taken_a_few_at_a_time_and_a_stop_first() -> None:
    """2000 lines of two bytes were one round of work: 50 ms in which the pause before a step was missed."""
    near, far = socket.socketpair()
    with near, far:
        near.setblocking(False)
        client = ClientConnection(near, 1, "me", 1)
        far.sendall(b"x\n" * 1000 + b'{"do": "stop"}\n' + b"x\n" * 500)
        rounds = [client.lines()]
        while client.has_lines:
            rounds.append(client.lines())
    assert rounds[0][0] == b'{"do": "stop"}'
    assert max(len(lines) for lines in rounds) == MAX_LINES
    assert sum(len(lines) for lines in rounds) == 1501


def test_a_run_that_says_much_while_nobody_takes_it_keeps_its_channel(bench: Bench) -> None:
    """More than a socket takes in one piece ended the channel: its process was said to be lost."""
    os.kill(bench.channel._process.pid, signal.SIGSTOP)
    try:
        text = "x" * 3000
        bench.step(200)  # until the socket is full
        bench.channel._events.extend({"t_s": 1.0, "code": "alarm", "text": text} for _ in range(300))
        bench.step(5)
    finally:
        os.kill(bench.channel._process.pid, signal.SIGCONT)
    bench.step(5)
    with bench.connect() as client:
        client.send("note", text="still there")
        wait_for(lambda: "operator" in codes_after_a_step(bench), 5.0)
    assert "control_lost" not in bench.codes()


def codes_after_a_step(bench: Bench) -> list[str]:
    """Of all events so far."""
    bench.step()
    return bench.codes()
