"""`kill -9`, SIGSTOP, SIGTERM and Ctrl-C of the controller in every phase of a run, judged by the node's own record."""

import json
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from hil.core.types import Mode
from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import Ticks, read
from tests.live.live_bench import CONFIG, PLAIN, WATCHDOG_S, Controller, Emulator, controller, emulator
from tests.waiting import wait_for

pytestmark = pytest.mark.live

OFF = [0.0, 0.0]
PERIOD_S = 0.02
LOST_S = 0.3
KILL, STOP, TERM, CTRL_C = signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM, signal.SIGINT
SUDDEN = (KILL, STOP)

SCENARIO = """
[scenario]
name = "killed"
duration_s = 100.0
[diagnosis]
method = "ideal"
[rig]
safety.arm_timeout_s = 30.0
safety.stop_ramp_V_s = {ramp_V_s}
control.period_s = {period_s}
{more}
"""
LOSES_A_PUMP = '[[fault]]\nat_s = 0.5\nkind = "pump_effectiveness"\ntarget = 1\nvalue = 0.7\n'
TRIPS_AND_WAITS = (
    '[[fault]]\nat_s = 1.0\nkind = "sensor_open"\ntarget = 1\n[[request]]\nat_s = 90.0\naction = "clear"\n'
)


@dataclass(frozen=True)
class Phase:
    """How a run is brought there: what its scenario has, and which event says that it has arrived."""

    mode: Mode
    more: str = ""
    ramp_V_s: float = 20.0
    period_s: float = PERIOD_S


READY = Phase(Mode.READY, "safety.heartbeat_age_max_s = 0.3", period_s=0.2)
"""It lasts one step, and no step may be longer."""
MAX_TRIES = 10
PHASES = {
    "running": Phase(Mode.RUNNING),
    "degraded": Phase(Mode.DEGRADED, LOSES_A_PUMP),
    "stopping": Phase(Mode.STOPPING, ramp_V_s=0.5),
    "tripped": Phase(Mode.TRIPPED, TRIPS_AND_WAITS),
}


class Killed:
    """A run that has been brought to a phase, and the rig that it runs on."""

    def __init__(self, run: Controller, rig: Emulator) -> None:
        self.run, self.rig = run, rig

    def events(self) -> list[dict[str, Any]]:
        path = self.run.folder / "events.jsonl"
        return [json.loads(line) for line in path.read_text().split("\n")[:-1]] if path.exists() else []

    def modes(self) -> list[str]:
        """Names of all modes that it has been in, oldest first."""
        return [event["data"]["mode"] for event in self.events() if event["code"] == "mode"]

    def wait_for(self, condition: Callable[[], bool]) -> None:
        """Until it holds, or the run has ended, which fails."""
        wait_for(lambda: condition() or self.run.process.poll() is not None, timeout_s=40.0)
        assert condition(), self.run.process.communicate()

    def is_in(self, mode: Mode) -> bool:
        said = [event for event in self.events() if event["code"] in ("mode", "trip")]
        if not said:
            return False
        return mode is Mode.TRIPPED if said[-1]["code"] == "trip" else bool(said[-1]["data"]["mode"] == mode.name)

    def send(self, number: signal.Signals) -> int | None:
        """A stopped process is killed in the end, when it can no longer do anything else."""
        self.run.process.send_signal(number)
        if number is STOP:
            time.sleep(WATCHDOG_S + 0.3)
            self.rig_after_stop = self.rig.pump()
            self.run.process.kill()
        return self.run.wait(20.0)


@contextmanager
def brought_to(phase: Phase, folder: Path) -> Iterator[Killed]:
    scenario = folder / "killed.toml"
    tables = "" if phase.more == "" else phase.more
    scenario.write_text(SCENARIO.format(ramp_V_s=phase.ramp_V_s, period_s=phase.period_s, more=tables))
    with (
        emulator(folder / "node.jsonl", scenario=scenario) as rig,
        controller(scenario, rig.channel, folder / "run", *PLAIN) as run,
    ):
        killed = Killed(run, rig)
        if phase.mode is Mode.STOPPING:
            killed.wait_for(lambda: killed.is_in(Mode.RUNNING))
            rig.wait_until_it_runs(changes=20)
            run.process.send_signal(TERM)
        killed.wait_for(lambda: READY.mode.name in killed.modes() if phase is READY else killed.is_in(phase.mode))
        if phase.mode is Mode.RUNNING:
            rig.wait_until_it_runs(changes=50)
        yield killed


def assert_readable(folder: Path) -> Ticks:
    """The folder can be read, its steps and frames up to 0.3 s before the last command."""
    run = RunFolder.open(folder)
    ticks, events = read(run)
    assert run.manifest().plan.scenario == "killed"
    assert [event.t_s for event in events] == sorted(event.t_s for event in events)
    return ticks


def assert_off_in_time(pump: list[dict[str, Any]], *, since_V: float = 0.0) -> dict[str, Any]:
    """From the last command that the node applied to its 0 V; then nothing moves."""
    last = max(i for i, change in enumerate(pump) if max(change["applied_V"]) > since_V)
    off = next(change for change in pump[last:] if change["applied_V"] == OFF)
    assert off["t_s"] - pump[last]["t_s"] <= WATCHDOG_S + 2.5 * PERIOD_S
    assert pump[-1]["applied_V"] == OFF
    return off


@pytest.mark.parametrize("number", [KILL, STOP, TERM, CTRL_C], ids=["kill", "stop", "term", "ctrl_c"])
@pytest.mark.parametrize("name", PHASES)
def test_cases_48_to_50_in_every_phase_the_node_is_at_zero_volts_in_time(
    tmp_path: Path, name: str, number: signal.Signals
) -> None:
    phase = PHASES[name]
    with brought_to(phase, tmp_path) as killed:
        code = killed.send(number)
        if number in SUDDEN:
            time.sleep(WATCHDOG_S)
        pump = killed.rig.pump()
        ticks = assert_readable(killed.run.folder)
        assert code == _exit_code(name, number), (killed.run.out, killed.run.err)
        ran_s = _ran_s(pump)
        if number in SUDDEN:
            off = assert_off_in_time(pump)
            assert off["cause"] == ("disabled" if name == "tripped" else "watchdog")
            if number is STOP:
                assert killed.rig_after_stop == pump, "0 V while it was stopped, not when it was killed"
            if name != "tripped":
                assert ran_s - WATCHDOG_S - ticks["t_s"][-1] <= LOST_S
            assert killed.run.json("run.json")["status"] == "running"
            return
        off = assert_off_in_time(pump, since_V=0.0 if name in ("tripped", "stopping") else 2.0)
        assert off["cause"] == "disabled"
        assert killed.run.json("run.json")["status"] == ("tripped" if name == "tripped" else "stopped")


@pytest.mark.parametrize("number", [KILL, STOP, TERM, CTRL_C], ids=["kill", "stop", "term", "ctrl_c"])
def test_cases_48_to_50_while_it_is_ready_nothing_has_moved_and_nothing_does(
    tmp_path: Path, number: signal.Signals
) -> None:
    """A signal that comes too late for the one step is sent again, to another run."""
    for attempt in range(MAX_TRIES):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        with brought_to(READY, folder) as killed:
            code = killed.send(number)
            if number in SUDDEN:
                time.sleep(WATCHDOG_S)
            if Mode.RUNNING.name in killed.modes():
                continue
            assert_readable(killed.run.folder)
            assert code == _exit_code("ready", number), (killed.run.out, killed.run.err)
            assert not killed.rig.has_ever_applied()
            return
    pytest.fail(f"it was never ready when the signal came, in {MAX_TRIES} runs")


def _exit_code(name: str, number: signal.Signals) -> int:
    if number in SUDDEN:
        return -9
    if name == "tripped":
        return 3  # what ended the run is the trip
    if name == "stopping":
        return 130  # the second signal interrupts
    return {TERM: 143, CTRL_C: 130}[number]


def _ran_s(pump: list[dict[str, Any]]) -> float:
    """From the first command that ran the pumps to the last change."""
    first_s = next(change["t_s"] for change in pump if change["cause"] == "command")
    return float(pump[-1]["t_s"] - first_s)


@pytest.mark.parametrize("number", [KILL, STOP, TERM, CTRL_C], ids=["kill", "stop", "term", "ctrl_c"])
def test_while_it_is_disarmed_it_moves_nothing_and_leaves_a_readable_folder(
    tmp_path: Path, number: signal.Signals
) -> None:
    """The nodes were built for another DBC, so that it waits for them for as long as it may."""
    scenario = tmp_path / "killed.toml"
    scenario.write_text(SCENARIO.format(ramp_V_s=20.0, period_s=PERIOD_S, more=""))
    config = tmp_path / "config"
    config.mkdir()
    for name in ("rig.toml", "emulator.toml", "bench.dbc"):
        (config / name).write_text((CONFIG / name).read_text().replace("Voltage of pump 1", "Volts, pump 1"))
    with (
        emulator(tmp_path / "node.jsonl", "--config", config) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN) as run,
    ):
        wait_for(lambda: "201#" in _text(tmp_path / "run/can.log"), timeout_s=40.0)
        code = Killed(run, rig).send(number)
        assert code == {KILL: -9, STOP: -9, TERM: 143, CTRL_C: 130}[number], (run.out, run.err)
        assert_readable(run.folder)
        assert not rig.has_ever_applied()


def _text(path: Path) -> str:
    return path.read_text() if path.exists() else ""


@pytest.mark.parametrize("number", [KILL, STOP, TERM, CTRL_C], ids=["kill", "stop", "term", "ctrl_c"])
def test_while_it_connects_it_ends_at_once_and_leaves_no_folder(tmp_path: Path, number: signal.Signals) -> None:
    """A listener whose backlog is full lets nobody in."""
    scenario = tmp_path / "killed.toml"
    scenario.write_text(SCENARIO.format(ramp_V_s=20.0, period_s=PERIOD_S, more=""))
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        address = listener.getsockname()
        guests = [socket.socket() for _ in range(4)]
        for guest in guests:
            guest.setblocking(False)
            with suppress(BlockingIOError):
                guest.connect(address)
        with controller(scenario, f"socket://127.0.0.1:{address[1]}", tmp_path / "run", *PLAIN) as run:
            wait_for(lambda: _is_connecting(address[1]), timeout_s=40.0)
            started_s = time.monotonic()
            run.process.send_signal(number)
            if number is STOP:
                run.process.kill()
            code = run.wait(20.0)
            assert code == {KILL: -9, STOP: -9, TERM: 143, CTRL_C: 130}[number], (run.out, run.err)
            assert time.monotonic() - started_s < 4.0
        for guest in guests:
            guest.close()
    assert not (tmp_path / "run").exists()


def _is_connecting(port: int, guests: int = 4) -> bool:
    """Whether one more than our guests waits to be let in (their requests stay in SYN_SENT, or are in the backlog).

    The kernel may list a socket twice while others come and go beside it.
    """
    asking = f":{port:04X}"
    with open("/proc/net/tcp", encoding="ascii") as table:  # noqa: PTH123 - not a file of ours
        rows = [line.split() for line in table.readlines()[1:]]
    return len({row[1] for row in rows if row[2].endswith(asking) and row[3] in ("01", "02")}) > guests
