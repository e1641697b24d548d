"""An operator's session on a run over slcan: what they ask for happens, is answered, and is in the record with who."""

from __future__ import annotations

import os
import signal
import socket
import time
from pathlib import Path
from typing import Any

import pytest

from hil.edge.control.client import ControlClient
from hil.edge.record.run_folder import RunFolder
from hil.review.ticks import LoggedEvent, read
from tests.live.live_bench import PLAIN, child, controller, emulator, hil, lone_adapter
from tests.waiting import wait_for

pytestmark = pytest.mark.live


def state_with(client: ControlClient, key: str, value: object, timeout_s: float = 30.0) -> dict[str, Any]:
    """The first state that has this value."""
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        state = client.state()
        if state[key] == value:
            return state
        time.sleep(0.1)
    raise AssertionError(f"{key} is {state[key]}, not {value}")


def asked(client: ControlClient, do: str, **keys: object) -> str:
    answer = client.ask(do, **keys)
    assert answer["ok"], answer
    return str(answer["text"])


def alarm_of(client: ControlClient, kind: str) -> dict[str, Any]:
    def rows() -> list[dict[str, Any]]:
        time.sleep(0.2)  # at most 20 requests in a second are taken
        return [row for row in client.state()["alarms"] if kind in row["title"]]

    wait_for(lambda: bool(rows()), 40.0)
    return rows()[0]


@pytest.mark.long
def test_a_session_of_an_operator_on_slcan(tmp_path: Path) -> None:
    """Start, reference with ramp, hold, manual and back, a loss from the console, ack, bypass, note, stop."""
    folder, console = tmp_path / "run", tmp_path / "console"
    with (
        emulator(tmp_path / "node.jsonl", "--control", console) as rig,
        controller(Path("hold"), rig.channel, folder, *PLAIN) as run,
    ):
        wait_for((folder / "control.sock").exists, 40.0)
        with ControlClient.connect(folder / "control.sock", 20.0) as operator:
            assert operator.hello["duration_s"] is None
            before = state_with(operator, "mode", "RUNNING")
            assert asked(operator, "reference", change_V=[0.25, None], ramp_s=2.0).endswith("within 2 s")
            assert asked(operator, "hold").startswith("hold")
            assert operator.ask("hold")["reason"] == "no_change"
            asked(operator, "resume")
            time.sleep(7.0)  # the ramp, and until the pumps move no more: what is compared below is half a second apart
            moved = operator.state()
            assert moved["reference_cm"][0] == pytest.approx(before["reference_cm"][0] + 0.5, abs=0.01)
            assert moved["measured_cm"][0] > before["measured_cm"][0] + 0.1
            asked(operator, "manual")
            by_hand = state_with(operator, "mode", "MANUAL")
            asked(operator, "auto")
            back = operator.state()
            assert back["command_V"] == pytest.approx(by_hand["command_V"], abs=0.4), "bumpless"
            with socket.socket(socket.AF_UNIX) as line:
                line.connect(str(console))
                line.sendall(b"failure pump wrong -i 1 -v 0.5\n")
                assert line.recv(200).startswith(b"ok")
            row = alarm_of(operator, "pump_effectiveness 1")
            asked(operator, "ack", alarm=row["key"])
            acknowledged = next(r for r in operator.state()["alarms"] if r["key"] == row["key"])
            assert acknowledged["state"] == "acknowledged"
            asked(operator, "bypass", interlock="dry_run", for_s=1.0)
            assert 0.0 < operator.state()["bypassed"]["dry_run"] <= 1.0
            state_with(operator, "bypassed", {})
            asked(operator, "note", text="loss injected")
        assert hil("ctl", "note", "from", "a", "shell", "--run", folder).returncode == 0
        assert '"mode": "DEGRADED"' in hil("ctl", "status", "--json", "--run", folder).stdout
        refused = hil("ctl", "clear", "--run", folder)
        assert (refused.returncode, refused.stderr) == (4, "hil: clear refused: not while DEGRADED\n")
        assert hil("ctl", "stop", "--run", folder).returncode == 0
        assert run.wait(40.0) == 0, (run.out, run.err)
        last = rig.pump()[-1]
    assert (last["state"], last["applied_V"]) == ("ready", [0.0, 0.0])
    assert not (folder / "control.sock").exists()
    ticks, events = read(RunFolder.open(folder))
    assert ticks["mode"].max() <= 6
    check_record(events)


def check_record(events: tuple[LoggedEvent, ...]) -> None:
    """Each request is there, with who has sent it."""
    done = [event.data["request"]["do"] for event in events if event.code == "operator"]
    assert done == [
        "reference", "hold", "resume", "manual", "auto", "ack", "bypass", "note", "note", "stop",
    ]  # fmt: skip
    assert [event.data["action"] for event in events if event.code == "refused"] == ["hold", "clear"]
    people = [event for event in events if event.code in ("operator", "refused")]
    assert {event.data["user"] for event in people} == {people[0].data["user"]}
    assert len({event.data["pid"] for event in people}) == 4, "this process, and three of hil ctl"
    assert any(event.code == "bypass_end" for event in events)


def test_a_killed_channel_and_a_killed_run(tmp_path: Path) -> None:
    """The run goes on without its channel; a killed run leaves 0 V and a socket that the next one does not mind."""
    place = tmp_path / "here.sock"
    with emulator(tmp_path / "node.jsonl") as rig:
        with controller(Path("hold"), rig.channel, tmp_path / "run", *PLAIN, "--control", str(place)) as run:
            wait_for(place.exists, 40.0)
            rig.wait_until_it_runs()
            os.kill(child(run, "control.server"), signal.SIGKILL)
            wait_for(lambda: '"control_lost"' in (tmp_path / "run/events.jsonl").read_text(), 10.0)
            count = len(rig.commanded())
            wait_for(lambda: len(rig.commanded()) > count, 10.0)
            assert place.exists(), "left behind"
            run.process.kill()
            wait_for(lambda: rig.pump()[-1]["applied_V"] == [0.0, 0.0], 10.0)
        with controller(
            Path("hold"), rig.channel, tmp_path / "next", *PLAIN, "--control", str(place), "--clear-trip"
        ) as run:
            wait_for(lambda: hil("ctl", "status", "--socket", place).returncode == 0, 40.0)
            with lone_adapter() as (address, _):
                command = ("run", "hold", "-i", "slcan", "-c", address, "--out", tmp_path / "o", "--control", place)
                other = hil(*command)
            assert (other.returncode, "another run listens there" in other.stderr) == (2, True), other.stderr
            assert not (tmp_path / "o").exists()
            assert hil("ctl", "stop", "--socket", place).returncode == 0
            assert run.wait(40.0) == 0, (run.out, run.err)
