"""A run in real time through the controller again: every command, although no step began when it should have."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from hil.edge.control.client import ControlClient
from hil.replay.replay_run import ReplayOptions, replay
from tests.live.live_bench import PLAIN, controller, emulator
from tests.live.test_live_control import asked, state_with
from tests.waiting import wait_for

pytestmark = pytest.mark.live


def test_a_live_run_with_an_operator_and_a_signal_is_repeated(tmp_path: Path) -> None:
    """Requests are taken from the events, steps' times from t_ns, what each had read from the order of can.log."""
    folder = tmp_path / "run"
    with (
        emulator(tmp_path / "node.jsonl") as rig,
        controller(Path("hold"), rig.channel, folder, *PLAIN, "--attended", "600") as run,
    ):
        wait_for((folder / "control.sock").exists, 40.0)
        with ControlClient.connect(folder / "control.sock", 20.0) as operator:
            state_with(operator, "mode", "RUNNING")
            asked(operator, "reference", change_V=[0.25, None], ramp_s=1.0)
            asked(operator, "manual", voltage_V=[3.0, None])
            state_with(operator, "mode", "MANUAL")
            asked(operator, "auto")
            asked(operator, "note", text="repeated")
        run.process.send_signal(signal.SIGINT)
        run.wait()
    result = replay(folder, ReplayOptions())
    assert result.is_same, result.summary
    assert result.comparison is not None
    assert result.comparison.compared == len((folder / "sent.log").read_text().splitlines()) > 10
    assert result.comparison.largest_V <= 2e-4
    assert [one.action for asks in result.recorded.requests.values() for one in asks] == [
        "reference",
        "manual",
        "auto",
        "note",
    ]
    assert not [doubt for doubt in result.doubts if "before control" not in doubt], result.doubts
