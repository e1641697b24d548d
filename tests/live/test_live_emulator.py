"""The command in its own process and in real time, with python-can's slcan bus as its host."""

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import pytest

from firmware_sim.settings import load_fingerprint
from tests.firmware_sim.sim_bench import CONFIG, command
from tests.fork_server import ForkedProgram
from tests.waiting import wait_for

pytestmark = pytest.mark.live

HOST = """
import sys, time, can
bus = can.Bus(sys.argv[1], "slcan", bitrate=500000, sleep_after_open=0, ignore_config=True)
for counter, data in enumerate(sys.argv[2:]):
    bus.send(can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes.fromhex(data)))
    time.sleep(0.05)
print("sent", flush=True)
time.sleep(60)
"""


def first_line(process: ForkedProgram | subprocess.Popen[str], timeout_s: float = 10.0) -> str:
    assert process.stdout is not None
    readable, _, _ = select.select([process.stdout], [], [], timeout_s)
    assert readable, "no line in time"
    return process.stdout.readline()


@contextmanager
def emulator_process(*arguments: str | int | Path) -> Iterator[tuple[ForkedProgram, str]]:
    process = ForkedProgram(["firmware-sim", *arguments])
    try:
        line = first_line(process)
        assert line.startswith("firmware-sim ready: slcan on "), process.stderr.read()
        yield process, line.split()[-1]
    finally:
        process.kill()
        process.communicate()


@contextmanager
def host_bus(channel: str) -> Iterator[can.BusABC]:
    bus = can.Bus(channel, "slcan", bitrate=500_000, sleep_after_open=0, ignore_config=True)
    try:
        yield bus
    finally:
        bus.shutdown()


@pytest.fixture(params=["--slcan 0", "--pty"])
def transport(request: pytest.FixtureRequest) -> list[str]:
    return str(request.param).split()


def frames_for(bus: can.BusABC, duration_s: float) -> list[can.Message]:
    frames, end_s = [], time.monotonic() + duration_s
    while time.monotonic() < end_s:
        frame = bus.recv(0.01)
        if frame is not None:
            frames.append(frame)
    return frames


def changes_of(record: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in record.read_text().splitlines()]


def test_levels_arrive_and_a_command_is_echoed(transport: list[str]) -> None:
    with emulator_process(*transport) as (_, channel), host_bus(channel) as bus:
        frames_for(bus, 0.4)
        bus.send(command(3.0, 4.0, counter=11))
        frames = frames_for(bus, 0.5)
        by_id = {can_id: [f for f in frames if f.arbitration_id == can_id] for can_id in (0x181, 0x182, 0x282, 0x701)}
        assert len(by_id[0x182]) == pytest.approx(25, abs=8)
        counters = [frame.data[5] for frame in by_id[0x182]]
        assert all((b - a) % 16 == 1 for a, b in pairwise(counters))
        assert any(frame.data[5] & 0x0F == 11 and frame.data[4] == 2 for frame in by_id[0x181])
        contract = int.from_bytes(by_id[0x701][-1].data[3:7], "little")
        assert contract == load_fingerprint(CONFIG / "bench.dbc")


def test_a_host_that_vanishes_leaves_the_pumps_at_zero_volts_within_the_watchdog_time(
    transport: list[str], tmp_path: Path
) -> None:
    record = tmp_path / "changes.jsonl"
    commands = [command(3.0 + counter / 10, 3.0, counter=counter).data.hex() for counter in range(8)]
    with emulator_process(*transport, "--record", record) as (_, channel):
        wait_for(lambda: any(change["state"] == "ready" for change in changes_of(record)))
        host = subprocess.Popen([sys.executable, "-c", HOST, channel, *commands], stdout=subprocess.PIPE, text=True)
        assert first_line(host) == "sent\n"
        host.kill()
        host.communicate()
        pump = wait_for(
            lambda: [c for c in changes_of(record) if c["node"] == "pump"] if "watchdog" in record.read_text() else []
        )
        trip, last = pump[-1], pump[-2]
        assert (trip["state"], trip["applied_V"], trip["cause"]) == ("tripped", [0.0, 0.0], "watchdog")
        assert (last["state"], last["cause"]) == ("run", "command")
        assert trip["t_s"] - last["t_s"] == pytest.approx(0.25, abs=1e-6)
        with host_bus(channel) as bus:
            assert any(f.arbitration_id == 0x181 and f.data[4] == 0x13 for f in frames_for(bus, 0.5))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_every_orderly_end_puts_out_zero_volts(number: signal.Signals, tmp_path: Path) -> None:
    record = tmp_path / "changes.jsonl"
    with emulator_process("--slcan", 0, "--record", record) as (process, channel):
        wait_for(lambda: any(change["state"] == "ready" for change in changes_of(record)))
        with host_bus(channel) as bus:
            bus.send(command(3.0, 4.0))
            wait_for(lambda: any(change["cause"] == "command" for change in changes_of(record)))
            process.send_signal(number)
            assert process.wait(2.0) == 0
        last = [change for change in changes_of(record) if change["node"] == "pump"][-1]
        assert (last["cause"], last["applied_V"]) == ("shutdown", [0.0, 0.0])
        assert process.stdout.read() == ""
        assert process.stderr.read() == ""


def test_tcp_host_may_come_again_after_a_wild_end() -> None:
    with emulator_process("--slcan", 0) as (_, channel):
        for _ in range(5):
            with host_bus(channel) as bus:
                assert frames_for(bus, 0.15)


def test_garbage_does_not_stop_the_service(transport: list[str]) -> None:
    with emulator_process(*transport) as (process, channel):
        with host_bus(channel) as bus:
            vars(bus)["serialPortOrig"].write(os.urandom(2000) + b"x" * 3000 + b"\r")
            time.sleep(0.2)
        with host_bus(channel) as bus:
            assert frames_for(bus, 0.3)
        assert process.poll() is None


def line_of(process: subprocess.Popen[bytes], timeout_s: float = 10.0) -> str:
    """The next line, byte by byte: what a buffer holds back, select can't see."""
    line = b""
    while not line.endswith(b"\n"):
        assert process.stdout is not None
        assert select.select([process.stdout], [], [], timeout_s)[0], "no line in time"
        byte = os.read(process.stdout.fileno(), 1)
        assert byte, "the process has ended"
        line += byte
    return line.decode()


def test_the_process_takes_commands_on_standard_input_and_a_socket(tmp_path: Path) -> None:
    path = tmp_path / "control"
    process = subprocess.Popen(
        [sys.executable, "-m", "firmware_sim", "--slcan", "0", "--control", str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        bufsize=0,
    )
    try:
        assert line_of(process).startswith("firmware-sim ready")
        assert line_of(process) == f"firmware-sim control: {path}\n"
        assert process.stdin is not None
        process.stdin.write(b"failure level stuck -i 2\n")
        assert line_of(process) == "ok sensor_stuck 2\n"
        process.stdin.write(b"nonsense\n")
        assert line_of(process).startswith("error: unknown command 'nonsense'")
        process.stdin.close()
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(5.0)
            client.connect(str(path))
            client.sendall(b"failure level ok\n")
            assert client.recv(100) == b"ok level: 1 ended\n"
        assert process.poll() is None
        process.terminate()
        assert process.wait(5.0) == 0
        assert not path.exists()
    finally:
        process.kill()
        assert process.stdin is not None
        process.communicate() if not process.stdin.closed else process.wait()
