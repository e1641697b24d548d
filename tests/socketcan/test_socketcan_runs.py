"""Whole runs on the kernel's buses: `hil run` on one interface, `firmware-sim` on the other, a process each.

Bounds are those of docs/reference/faults.md, taken from the pump node's own record where the node must be safe.
"""

import signal
import subprocess
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import cantools
import pytest

from hil.bench import assembly
from hil.core import supervisor
from hil.edge.can.bus import BusAddress, BusPort
from hil.edge.config.settings_file import default_config_dir
from hil.wire.command_sender import CommandSender
from hil.wire.receiver import Receiver
from tests.bus.bus_bench import IDS
from tests.socketcan.kernel_links import BITRATE, Cable, Loop
from tests.socketcan.socketcan_bench import OFF, PERIOD_S, WATCHDOG_S, Rig, Run, controller, emulator
from tests.waiting import wait_for

pytestmark = pytest.mark.socketcan

DBC = default_config_dir() / "bench.dbc"
COMMAND_ID = 0x201
SLACK_S = 2.5 * PERIOD_S
"""Between the last change of the output and the last command, which may not have changed it."""
SILENT = ("stale_levels", "stale_status", "node_lost", "echo_missing")
"""Causes that a silence can have: all begin together, and which age runs out first is a matter of phases."""
AGE_MAX_S, FIVE_FRAMES_S, HEARTBEATS_S = max(3 * PERIOD_S, 0.15), 0.1, 0.75
"""What may pass before the controller trips: age of levels, five frames of 20 ms, heartbeats where frames are lost."""
FOREIGN_S = 0.5
"""An unknown sender commands the node for so long; the controller has latched and is silent."""
OUTAGE_S = 0.6
"""Longer than the age that trips: after a shorter interruption the node's own trip may be reported first."""


@pytest.fixture
def run(rig: Rig, cable: Cable, tmp_path: Path) -> Iterator[Run]:
    """A run that has begun to move pumps, and how many changes the pump node had recorded before."""
    cable.plug()
    since = len(rig.pump())
    with controller(cable.near, tmp_path) as one:
        rig.wait_until_it_runs(since)
        one.since = since
        yield one
    cable.plug()


def assert_tripped(run: Run, *causes: str) -> None:
    assert run.wait() == 3, run.out
    assert run.cause in causes, run.events()


def assert_node_safe_in_time(rig: Rig, run: Run) -> str:
    cause, after_s = rig.wait_until_safe(run.since)
    assert after_s <= WATCHDOG_S + SLACK_S, cause
    return cause


class Whole:
    """A run from start to end, and what another program saw of it."""

    def __init__(self, run: Run, seen: Path, pump: list[dict[str, Any]]) -> None:
        self.run, self.seen, self.pump = run, seen, pump


@pytest.fixture(scope="module")
def whole(rig: Rig, cable: Cable, tmp_path_factory: pytest.TempPathFactory) -> Whole:
    folder = tmp_path_factory.mktemp("whole")
    cable.plug()
    since = len(rig.pump())
    listen = ["candump", "-L", "-T", "3000", cable.far]
    with (folder / "candump.log").open("w") as log, subprocess.Popen(listen, stdout=log) as candump:
        with controller(cable.near, folder, duration=4.0) as run:
            code = run.wait(40.0)
        candump.terminate()
    assert code == 0, run.out
    return Whole(run, folder / "candump.log", rig.pump()[since:])


def test_a_whole_run_is_complete_and_loses_no_command(whole: Whole) -> None:
    kpi = whole.run.json("kpi.json")
    assert (kpi["status"], kpi["trips"], kpi["commands"]["commands_lost"]) == ("complete", [], 0)
    assert whole.run.json("run.json")["recorder"] == {"errors": [], "dropped": 0}
    last = whole.pump[-1]
    assert (last["state"], last["applied_V"], last["cause"]) == ("ready", OFF, "disabled")


def test_candump_saw_each_command_once_and_cantools_reads_them(whole: Whole) -> None:
    """Another program's log and decoder: every command is within range, with consecutive counters."""
    frames = list(can.CanutilsLogReader(whole.seen))
    database: Any = cantools.database.load_file(DBC)
    commands: list[Any]
    commands = [database.decode_message(COMMAND_ID, one.data) for one in frames if one.arbitration_id == COMMAND_ID]
    assert len(commands) == pytest.approx(whole.run.json("kpi.json")["commands"]["commands_sent"], abs=1)
    assert all(0.0 <= command["Command1"] <= 10.0 for command in commands)
    assert {(int(b["Counter"]) - int(a["Counter"])) % 16 for a, b in pairwise(commands)} == {1}
    assert {one.arbitration_id for one in frames} == set(IDS), "both nodes and the controller, and nobody else"


def test_canplayer_replays_a_recorded_run_into_the_receiver(whole: Whole, loop: Loop) -> None:
    """Every frame of the run is taken as it was then: the nodes' as accepted, ours as somebody else's commands."""
    log = whole.run.folder / "can.log"
    lines = log.read_text().splitlines()
    contract = assembly.load_contract(DBC)
    receiver = Receiver(contract, CommandSender(contract), (0.0, 10.24))
    port = BusPort(BusAddress("socketcan", loop.near, BITRATE).open(IDS))
    with subprocess.Popen(["canplayer", "-I", str(log), f"{loop.near}=can0"]) as player:
        while player.poll() is None or (more := port.waiting()):
            for message in port.waiting() if player.poll() is None else more:
                receiver.take(message, port.arrived_ns(message, time.monotonic_ns()))
            time.sleep(0.01)
    port.close()
    plain = [line for line in lines if line.split()[2].partition("#")[0] in {f"{one:03X}" for one in IDS}]
    assert receiver.accepted + receiver.rejections.total() == len(plain)
    assert receiver.foreign_commands == len((whole.run.folder / "sent.log").read_text().splitlines())
    assert receiver.accepted >= 0.98 * len(plain), receiver.rejections


@pytest.mark.parametrize(
    ("number", "words", "causes", "within_s"),
    [
        (4, "frames burst -v 16", (*SILENT, "node_tripped"), max(AGE_MAX_S + PERIOD_S, WATCHDOG_S)),
        (8, "frames delayed -v 0.6 -t 2", (*SILENT, "node_tripped"), max(AGE_MAX_S + PERIOD_S, WATCHDOG_S)),
        (9, "lower_levels garbage -v 1 -t 2", ("frames_refused",), FIVE_FRAMES_S),
        (11, "upper_levels stuck -t 2", ("frames_refused",), FIVE_FRAMES_S),
        (14, "bus command -v 2 -t 0.5", ("foreign_command", "node_tripped"), FOREIGN_S + WATCHDOG_S),
        (29, "node reboot -i 1", ("node_rebooted", "node_tripped"), PERIOD_S),
        (30, "node no_heartbeat -i 2 -t 2", ("node_lost",), HEARTBEATS_S),
    ],
    ids=lambda value: f"case_{value:02d}" if isinstance(value, int) else "",
)
def test_faults_of_frames_and_nodes_trip_on_the_kernels_bus_as_on_any(
    rig: Rig, run: Run, number: int, words: str, causes: tuple[str, ...], within_s: float
) -> None:
    del number
    began_s = time.monotonic()
    rig.fail(words)
    wait_for(lambda: rig.pump()[-1]["applied_V"] == OFF, 3.0, 0.01)
    assert time.monotonic() - began_s <= within_s + SLACK_S
    assert_tripped(run, *causes)
    time.sleep(1.0)  # until the fault is over
    assert rig.pump()[-1]["applied_V"] == OFF


def test_case_01_05_06_12_lost_doubled_swapped_and_foreign_frames_do_not_trip(rig: Rig, run: Run) -> None:
    for words in ("lower_levels burst -v 1", "upper_levels duplicate -t 0.5", "bus babble -v 100 -t 0.5"):
        rig.fail(words)
        time.sleep(0.6)
    rig.fail("pump_status reorder -t 0.3")
    time.sleep(0.5)
    run.process.signal(signal.SIGTERM)
    assert run.wait() == 143, run.out
    assert run.json("kpi.json")["trips"] == []


def test_case_14_cansend_of_our_command_id_latches(rig: Rig, run: Run, cable: Cable) -> None:
    """A valid frame of an unknown sender: trips within a step, one last 0 V, then silence until the node is safe."""
    data = CommandSender(assembly.load_contract(DBC)).encode(supervisor.OFF, 0)
    subprocess.run(["cansend", cable.far, f"{COMMAND_ID:03X}#{data.hex()}"], check=True)
    assert_tripped(run, "foreign_command", "node_tripped")
    wait_for(lambda: rig.pump()[-1]["applied_V"] == OFF, 3.0)


@pytest.mark.parametrize("end", ["near", "far"])
def test_case_22_a_link_down_and_up_mid_run_is_safe_and_comes_back_disarmed(
    rig: Rig, run: Run, cable: Cable, tmp_path: Path, end: str
) -> None:
    """Node safe within W; the run ends within 5 s; a new one is refused until somebody clears the trip."""
    name = getattr(cable, end)
    cable.down(name)
    down_s = time.monotonic()
    assert assert_node_safe_in_time(rig, run) in ("watchdog", "command")
    time.sleep(max(0.0, down_s + OUTAGE_S - time.monotonic()))
    cable.up(name)
    assert_tripped(run, "bus_failed", *(SILENT if end == "far" else ()))
    assert time.monotonic() - down_s < 5.0
    if end == "near":
        (why,) = [event["text"] for event in run.events() if event["code"] == "trip"]
        assert "down" in why
    assert_disarmed_until_cleared(rig, cable, tmp_path)


@pytest.mark.parametrize("end", ["near", "far"])
def test_case_24_an_interface_unplugged_and_plugged_again_is_safe_and_comes_back_disarmed(
    rig: Rig, run: Run, cable: Cable, tmp_path: Path, end: str
) -> None:
    cable.unplug(getattr(cable, end))
    gone_s = time.monotonic()
    assert_node_safe_in_time(rig, run)
    assert_tripped(run, "bus_failed", *(SILENT if end == "far" else ()))
    assert time.monotonic() - gone_s < 5.0
    cable.plug()
    assert_disarmed_until_cleared(rig, cable, tmp_path)


def assert_disarmed_until_cleared(rig: Rig, cable: Cable, folder: Path) -> None:
    """The link is up: without clearing no run moves a pump, with it the next one does."""
    (folder / "refused").mkdir()
    (folder / "cleared").mkdir()
    changes = len(rig.pump())
    with controller(cable.near, folder / "refused", clear=False) as refused:
        wait_for(lambda: (refused.folder / "events.jsonl").exists())
        time.sleep(1.5)
        refused.process.signal(signal.SIGTERM)
        assert refused.wait() == 143, refused.out
    assert len(rig.pump()) == changes, "the node has not even changed its state"
    with controller(cable.near, folder / "cleared", duration=0.5) as cleared:
        assert cleared.wait() == 0, cleared.out


def test_case_21_bus_off_in_a_run_trips_and_error_passive_is_only_told(loop: Loop, tmp_path: Path) -> None:
    """Injected on vcan, as a driver would report them."""
    loop.plug()
    (tmp_path / "rig").mkdir()
    with emulator(loop.near, tmp_path / "rig") as rig, controller(loop.near, tmp_path) as run:
        rig.wait_until_it_runs(0)
        subprocess.run(["cansend", loop.near, "20000004#0020000000000000"], check=True)
        time.sleep(0.5)
        assert rig.pump()[-1]["state"] == "run", "error-passive alone stops nothing"
        subprocess.run(["cansend", loop.near, "20000040#0000000000000000"], check=True)
        assert_tripped(run, "bus_failed")
        wait_for(lambda: rig.pump()[-1]["applied_V"] == OFF, 3.0)
    told = {event["data"].get("kind"): event["text"] for event in run.events() if event["code"] == "bus_error"}
    assert told["error_passive"] == "the CAN controller is error-passive"
    assert told["bus_off"] == "the CAN controller is bus-off"
    (end,) = [event for event in run.events() if event["code"] == "end"]
    assert end["data"]["bus_errors"] == {"error_passive": 1, "bus_off": 1}
    (why,) = [event["text"] for event in run.events() if event["code"] == "trip"]
    assert "bus-off" in why


def test_case_48_a_stopped_controller_leaves_the_node_safe_and_sends_no_burst_afterwards(rig: Rig, run: Run) -> None:
    run.process.signal(signal.SIGSTOP)
    assert assert_node_safe_in_time(rig, run) == "watchdog"
    time.sleep(0.5)
    changes = len(rig.pump())
    run.process.signal(signal.SIGCONT)
    assert_tripped(run, "node_tripped", *SILENT)
    assert len(rig.pump()) == changes, "nothing moves a tripped node"
    sent_s = [float(line[1 : line.index(")")]) for line in read_log(run, "sent.log")]
    gaps = [b - a for a, b in pairwise(sent_s)]
    stall = gaps.index(max(gaps))
    assert gaps[stall] > WATCHDOG_S
    assert all(gap > 0.01 for gap in gaps[stall + 1 : -1]), "the last one is the very last 0 V, at once"


def read_log(run: Run, name: str = "can.log") -> list[str]:
    return Path(run.folder / name).read_text().splitlines()


def test_case_49_a_killed_controller_leaves_the_node_safe_and_a_record_that_can_be_read(rig: Rig, run: Run) -> None:
    run.process.signal(signal.SIGKILL)
    assert assert_node_safe_in_time(rig, run) == "watchdog"
    assert run.json("run.json")["status"] == "running"
    assert len(read_log(run)) > 20


def test_case_50_asked_to_end_it_ramps_down_and_closes_its_record(rig: Rig, run: Run) -> None:
    run.process.signal(signal.SIGTERM)
    assert run.wait() == 143, run.out
    last = rig.pump()[-1]
    assert (last["state"], last["applied_V"], last["cause"]) == ("ready", OFF, "disabled")
    assert run.json("run.json")["status"] == "stopped"
