"""Doctor and conformance check as commands, against the emulator in a process of its own."""

import json
import signal
import socket
import time
from pathlib import Path

import pytest

from tests import fork_server
from tests.fork_server import ForkedProgram
from tests.live.live_bench import emulator, hil, row
from tests.waiting import wait_for

pytestmark = pytest.mark.live
LONG_S = 120.0


def test_the_emulator_is_found_fit_without_moving_a_pump_and_left_as_it_was(tmp_path: Path) -> None:
    with emulator(tmp_path / "node.jsonl") as node:
        done = hil("doctor", "-i", "slcan", "-c", node.channel, "--seconds", "2")
        assert done.returncode == 0, done.stdout + done.stderr
        for check in ("bus opens", "pump node contract", "pump node at rest", "sensor 1 range"):
            assert " pass " in row(done.stdout, check), done.stdout
        for check in ("watchdog", "echo latency"):  # a busy machine may make them warn
            assert row(done.stdout, check).split("│")[2].strip() in ("pass", "warn"), done.stdout
        assert " not checked " in row(done.stdout, "link state")
        assert not node.has_ever_applied()
        causes = [change["cause"] for change in node.pump()]
        assert causes.count("watchdog") == causes.count("cleared") >= 5
        assert node.pump()[-1]["state"] == "ready"
        trips_s = [
            (b["t_s"] - a["t_s"])
            for a, b in zip(node.pump(), node.pump()[1:], strict=False)
            if b["cause"] == "watchdog"
        ]
        assert all(trip_s >= 0.25 for trip_s in trips_s)


def test_a_bench_that_is_not_fit_is_told_and_why(tmp_path: Path) -> None:
    with emulator(tmp_path / "node.jsonl", "--control", tmp_path / "control") as node:
        assert node.process.stdout is not None
        node.process.stdout.readline()

        with socket.socket(socket.AF_UNIX) as control:
            control.connect(str(tmp_path / "control"))
            control.sendall(b"failure level off -i 2\n")
            assert control.recv(100).startswith(b"ok")
        done = hil("doctor", "-i", "slcan", "-c", node.channel, "--seconds", "2")
        assert done.returncode == 4, done.stdout + done.stderr
        assert " fail " in row(done.stdout, "sensor 2 range")
        assert "open or short" in done.stdout


def test_ctrl_c_ends_the_doctor_with_the_node_ready_at_zero(tmp_path: Path) -> None:
    with emulator(tmp_path / "node.jsonl") as node:
        process = ForkedProgram(["hil", "doctor", "-i", "slcan", "-c", node.channel, "--seconds", "1", "--with-pumps"])
        try:
            wait_for(node.has_ever_applied, timeout_s=60.0)
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=10.0)
        finally:
            process.kill()
        assert process.returncode == 130
        assert err == "hil: stopped by SIGINT; the pump node was told 0 V\n"
        wait_for(lambda: node.pump()[-1]["applied_V"] == [0.0, 0.0])
        time.sleep(0.4)
        assert (node.pump()[-1]["state"], node.pump()[-1]["cause"]) == ("ready", "disabled")


def test_the_emulator_conforms_as_a_process(tmp_path: Path) -> None:
    file = tmp_path / "told.json"
    with emulator(tmp_path / "node.jsonl") as node:
        done = fork_server.run(
            ["hil", "conformance", "-i", "slcan", "-c", node.channel, "--json", file], timeout=LONG_S
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert not node.has_ever_applied()
        assert node.pump()[-1]["state"] == "ready"
    told = json.loads(file.read_text())
    assert told["conforms"] is True
    assert {result["verdict"] for result in told["results"]} <= {"pass", "warn"}
