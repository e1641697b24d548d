"""A live run that asks for an operator."""

import json
from pathlib import Path

import pytest

from hil.edge.control.client import ControlClient
from tests.live.live_bench import PLAIN, controller, emulator, write_scenario

pytestmark = pytest.mark.live


def test_a_run_stops_when_nobody_is_there_and_not_before(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, duration=30.0)
    with (
        emulator(tmp_path / "node.jsonl", scenario=scenario) as rig,
        controller(scenario, rig.channel, tmp_path / "run", *PLAIN, "--attended", "1.5") as run,
    ):
        rig.wait_until_it_runs(changes=15)
        with ControlClient.connect(run.folder / "control.sock") as client:
            client.ask("here")
        assert run.wait(30.0) == 0, (run.out, run.err)
    events = [json.loads(line) for line in (run.folder / "events.jsonl").read_text().splitlines()]
    here = next(event for event in events if event["code"] == "operator")
    told = next(event for event in events if event["code"] == "operator_absent" and event["t_s"] > here["t_s"])
    stop = next(event for event in events if event["code"] == "stop")
    assert told["t_s"] - here["t_s"] == pytest.approx(1.5, abs=0.25)
    assert stop["t_s"] - here["t_s"] == pytest.approx(3.0, abs=0.25)
    assert stop["data"]["cause"] == "unattended"
    assert (run.json("kpi.json")["status"], run.json("kpi.json")["alarm_load"]["left"]) == ("stopped", 2)
