"""What happens when one of the two processes is killed, stopped or told to end in the midst of a run."""

import re
import resource
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from firmware_sim.frames import Rejection, parse_command
from hil.cli.exit_codes import INCOMPLETE
from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import read
from tests.live.live_bench import (
    HEARTBEAT_AGE_MAX_S,
    LEVELS_AGE_MAX_S,
    PERIOD_S,
    PLAIN,
    WATCHDOG_S,
    Controller,
    child,
    controller,
    emulator,
    hil,
    lone_adapter,
    sent_s,
    write_scenario,
)
from tests.waiting import wait_for

pytestmark = pytest.mark.live

OFF = [0.0, 0.0]
TCP, PTY = ("--slcan", "0"), ("--pty",)


def trip_of(run: Controller) -> dict[str, Any]:
    """The one trip in kpi.json; run.json must agree."""
    kpi, manifest = run.json("kpi.json"), run.json("run.json")
    assert (kpi["status"], manifest["status"]) == ("tripped", "tripped")
    (trip,) = kpi["trips"]
    assert manifest["reason"].startswith(trip["cause"])
    return dict(trip)


over_both = pytest.mark.parametrize("transport", [TCP, PTY], ids=["tcp", "pty"])


@over_both
def test_case_24_a_killed_emulator_ends_the_run_by_itself(tmp_path: Path, transport: tuple[str, ...]) -> None:
    scenario = write_scenario(tmp_path)
    with (
        emulator(tmp_path / "node.jsonl", transport=transport) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs()
        rig.process.kill()
        started_s = time.monotonic()
        assert run.wait(10.0) == 3, (run.out, run.err)
        assert time.monotonic() - started_s < 8.0
    assert trip_of(run)["cause"] == "bus_failed"
    assert "has not confirmed 0 V" in run.json("run.json")["reason"]
    if transport is TCP:  # once is enough
        assert hil("report", run.folder).returncode == 0
        assert "bus_failed" in (run.folder / "report.html").read_text()


def test_case_49_a_killed_controller_over_a_pseudo_terminal_is_no_different(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, arm_timeout=1.0)
    with (
        emulator(tmp_path / "node.jsonl", transport=PTY) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=10)
        run.process.kill()
        wait_for(lambda: rig.pump()[-1]["cause"] == "watchdog", timeout_s=2.0)
        *_, last, trip = rig.pump()
    assert (trip["state"], trip["applied_V"]) == ("tripped", OFF)
    assert WATCHDOG_S - 1e-6 <= trip["t_s"] - last["t_s"] <= WATCHDOG_S + 2.5 * PERIOD_S


@pytest.mark.parametrize(
    ("number", "code", "transport"),
    [(signal.SIGTERM, 143, TCP), (signal.SIGINT, 130, TCP), (signal.SIGTERM, 143, PTY)],
    ids=["SIGTERM-tcp", "SIGINT-tcp", "SIGTERM-pty"],
)
def test_case_50_asked_to_end_it_ramps_down_and_closes_its_record(
    tmp_path: Path, number: signal.Signals, code: int, transport: tuple[str, ...]
) -> None:
    scenario = write_scenario(tmp_path)
    with (
        emulator(tmp_path / "node.jsonl", transport=transport) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=10)
        before = len(rig.pump())
        run.process.send_signal(number)
        assert run.wait(10.0) == code, (run.out, run.err)
        *ramp, last = rig.pump()[before - 1 :]
    assert (last["state"], last["applied_V"], last["cause"]) == ("ready", OFF, "disabled")
    assert last["t_s"] - ramp[0]["t_s"] <= 1.0
    first_volts = [change["applied_V"][0] for change in ramp]
    steps = [a - b for a, b in pairwise([*first_volts, 0.0])]
    assert max(steps) <= 20.0 * PERIOD_S + 0.01, "stop_ramp_V_s of the rig file"
    assert len([step for step in steps if step > 0.5]) >= 2, "a ramp, not a jump"
    manifest = run.json("run.json")
    assert (manifest["status"], manifest["reason"]) == ("stopped", number.name)
    assert run.json("kpi.json")["trips"] == []
    _, events = read(RunFolder.open(run.folder))
    assert events[-1].code == "end"


def test_asked_to_end_before_it_is_armed_it_ends_at_once(tmp_path: Path) -> None:
    """Nobody speaks on the bus, so that it waits for the rig until the signal comes."""
    scenario = write_scenario(tmp_path, arm_timeout=30.0)
    with lone_adapter() as (channel, sent), controller(scenario, channel, tmp_path / "run", *PLAIN) as run:
        wait_for(lambda: len(sent) >= 5, timeout_s=40.0)
        run.process.send_signal(signal.SIGTERM)
        assert run.wait(5.0) == 143, (run.out, run.err)
        assert run.json("run.json")["status"] == "stopped"
    commands = [parse_command(frame) for frame in sent]
    assert not any(isinstance(command, Rejection) or command.enable for command in commands)


@over_both
def test_case_48_a_stopped_controller_trips_and_sends_no_burst_afterwards(
    tmp_path: Path, transport: tuple[str, ...]
) -> None:
    scenario = write_scenario(tmp_path)
    with (
        emulator(tmp_path / "node.jsonl", transport=transport) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=10)
        run.process.send_signal(signal.SIGSTOP)
        time.sleep(1.0)
        pump = rig.pump()
        assert (pump[-1]["state"], pump[-1]["applied_V"], pump[-1]["cause"]) == ("tripped", OFF, "watchdog")
        run.process.send_signal(signal.SIGCONT)
        assert run.wait(10.0) == 3, (run.out, run.err)
        assert rig.pump() == pump, "nothing moves a tripped node"
    times = sent_s(run.folder)
    gaps = [b - a for a, b in pairwise(times)]
    stall = max(range(len(gaps)), key=gaps.__getitem__)
    assert gaps[stall] > 0.9
    assert all(gap > 0.01 for gap in gaps[stall + 1 : -1]), "the last one is the very last 0 V, at once"
    assert len(gaps) - stall < 10
    assert run.json("kpi.json")["skipped"] >= 8
    assert trip_of(run)["cause"] == "node_tripped"


@over_both
def test_case_28_a_node_that_reads_nothing_trips_the_controller_and_refuses_the_backlog(
    tmp_path: Path, transport: tuple[str, ...]
) -> None:
    scenario = write_scenario(tmp_path)
    with (
        emulator(tmp_path / "node.jsonl", transport=transport) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        rig.wait_until_it_runs(changes=10)
        rig.process.send_signal(signal.SIGSTOP)
        assert run.wait(10.0) == 3, (run.out, run.err)
        rig.process.send_signal(signal.SIGCONT)
        wait_for(lambda: rig.pump()[-1]["cause"] == "watchdog")
        time.sleep(0.3)
        assert rig.pump()[-1]["cause"] == "watchdog", "the commands that waited in the line move nothing"
    trip = trip_of(run)
    assert trip["cause"] in ("stale_levels", "stale_status", "node_lost"), "all three fall silent together"
    ticks, _ = read(RunFolder.open(run.folder))
    at = ticks["t_s"].searchsorted(trip["t_s"] - 1e-6)
    # a heartbeat may have come a whole period before the stall and then runs out first
    assert HEARTBEAT_AGE_MAX_S - 0.1 - 0.02 < ticks["levels_age_s"][at] <= LEVELS_AGE_MAX_S + 2.0 * PERIOD_S
    assert ticks["v1_V"][at] == 0.0, "0 V in the very step that trips"
    assert "has not confirmed 0 V" in run.json("run.json")["reason"]


@contextmanager
def relay(port: int) -> Iterator[tuple[str, Callable[[], None]]]:
    """A cable to the emulator's adapter that can be pulled: yields its address and a way to pull it."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        ends = []

        def serve() -> None:
            with suppress(OSError):
                near, _ = server.accept()
                far = socket.create_connection(("127.0.0.1", port))
                ends.extend([near, far])
                for a, b in ((near, far), (far, near)):
                    threading.Thread(target=pump, args=(a, b), daemon=True).start()

        def pump(source: socket.socket, sink: socket.socket) -> None:
            with suppress(OSError):
                while data := source.recv(4096):
                    sink.sendall(data)

        def pull() -> None:
            for end in ends:
                with suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
                end.close()

        threading.Thread(target=serve, daemon=True).start()
        try:
            yield f"socket://127.0.0.1:{server.getsockname()[1]}", pull
        finally:
            pull()


def test_case_24_adapter_unplugged_and_plugged_again(tmp_path: Path) -> None:
    """The adapter goes: safe within W, the run ends cleanly; plugged again, nothing moves until it is cleared."""
    scenario = write_scenario(tmp_path, arm_timeout=1.0)
    with emulator(tmp_path / "node.jsonl") as rig:
        with (
            relay(int(rig.channel.rpartition(":")[2])) as (channel, pull),
            controller(scenario, channel, tmp_path / "run", *PLAIN) as run,
        ):
            wait_for(lambda: len(rig.commanded()) >= 10, 40.0)
            pull()
            assert run.wait(10.0) == 3, (run.out, run.err)
        wait_for(lambda: rig.pump()[-1]["cause"] == "watchdog", 2.0)
        before, trip = rig.pump()[-2:]
        assert trip["applied_V"] == [0.0, 0.0]
        assert trip["t_s"] - before["t_s"] <= WATCHDOG_S + 2.5 * PERIOD_S
        assert run.json("kpi.json")["trips"][0]["cause"] in ("bus_failed", "stale_levels", "node_lost")
        changes = len(rig.pump())
        with controller(scenario, rig.channel, tmp_path / "again", *PLAIN) as again:
            assert again.wait() == 4
        assert len(rig.pump()) == changes, "still latched at 0 V"


def test_case_52_disk_full_in_the_run(tmp_path: Path) -> None:
    """No file may grow any more: control goes on, the event is there within two flushes, run.json keeps it.

    The pumps are off, confirmed, before the record is closed; one line and exit code 5 say that it is incomplete.
    """
    scenario, room = write_scenario(tmp_path, duration=8.0), 20_000
    with (
        emulator(tmp_path / "node.jsonl") as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        wait_for(lambda: (tmp_path / "run/events.jsonl").exists(), 40.0)
        recorder = child(run, "recorder_process")
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, (room, room))
        assert run.wait(40.0) == INCOMPLETE, (run.out, run.err)
        commands, last = rig.commanded(), rig.pump()[-1]
    assert (last["state"], last["applied_V"], last["cause"]) == ("ready", OFF, "disabled")
    assert re.fullmatch(rf"hil: {run.folder}: the record is incomplete: can\.log.+", run.err.splitlines()[-1]), run.err
    gaps = [b["t_s"] - a["t_s"] for a, b in pairwise(commands)]
    assert commands[-1]["t_s"] - commands[0]["t_s"] > 7.0
    assert max(gaps) < LEVELS_AGE_MAX_S, "control is unaffected"
    manifest = run.json("run.json")
    assert manifest["status"] == "complete"
    assert any("can.log is lost" in error for error in manifest["recorder"]["errors"])
    _, events = read(RunFolder.open(run.folder))
    lost = next(event for event in events if event.code == "recorder_failed")
    logged = commands_s_of_whole_lines(run.folder / "can.log")
    assert lost.t_s - (logged[-1] - logged[0]) <= 2 * 0.1 + 8192 / 5000, "two flushes, and what the file's buffer held"


def commands_s_of_whole_lines(log: Path) -> list[float]:
    """Times of the commands in a can.log that may end in the middle of a line."""
    lines = log.read_text().split("\n")[:-1]
    return [float(line[1 : line.index(")")]) for line in lines if " 201#" in line]


GLR = '[scenario]\nname = "glr"\nduration_s = 60.0\n[diagnosis]\nmethod = "glr"\n[control]\ndesign = "rig"\n'


@pytest.mark.parametrize("stopped_s", [0.1, 0.3, 1.0, pytest.param(10.0, marks=pytest.mark.long)])
def test_case_48_the_time_of_a_stop_is_no_fault_of_a_pump(tmp_path: Path, stopped_s: float) -> None:
    """Stopped for 0.3 s, the controller reported a pump stuck on beside the node's trip.

    The node's watchdog bites after 0.25 s; a shorter stop goes by without a trip.
    """
    scenario = tmp_path / "glr.toml"
    scenario.write_text(GLR)
    with emulator(tmp_path / "node.jsonl") as rig, controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run:
        rig.wait_until_it_runs(changes=40)
        run.process.send_signal(signal.SIGSTOP)
        time.sleep(stopped_s)
        run.process.send_signal(signal.SIGCONT)
        if stopped_s < WATCHDOG_S:
            time.sleep(1.5)
            run.process.send_signal(signal.SIGTERM)
            assert run.wait(10.0) == 143, (run.out, run.err)
            assert run.json("kpi.json")["trips"] == []
        else:
            assert run.wait(10.0) == 3, (run.out, run.err)
            assert trip_of(run)["cause"] == "node_tripped"
    assert run.json("kpi.json")["alarms"] == []
