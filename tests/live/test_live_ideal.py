"""The detector `ideal` on a bus: it believes faults that nobody may play, and says so before anything moves."""

import json
from pathlib import Path

import pytest

import hil
from hil.bench.live_warnings import live_warnings
from tests.live.live_bench import controller, emulator, write_scenario


@pytest.mark.live
def test_an_ideal_detector_on_a_live_rig_warns_before_arming_and_in_the_report(tmp_path: Path) -> None:
    """Commands used to jump at the scenario's fault time without a word, whether or not anybody played the fault."""
    scenario = write_scenario(tmp_path, duration=1.0)
    with (
        emulator(tmp_path / "node.jsonl") as rig,  # plays no faults
        controller(scenario, rig.channel, tmp_path / "run", "--no-rerun") as run,
    ):
        assert run.wait() == 0, (run.out, run.err)
    assert "WARNING: diagnosis.method = 'ideal' does not look at the rig" in run.err
    assert "pump 1 at 0.7 from 4 s" in run.err
    codes = [json.loads(line)["code"] for line in (tmp_path / "run" / "events.jsonl").read_text().splitlines()]
    assert codes.index("ideal_live") < codes.index("mode"), "before anything is armed"
    assert "does not look at the rig" in (tmp_path / "run" / "report.html").read_text()


def test_only_an_ideal_detector_with_faults_to_believe_warns() -> None:
    (warning,) = live_warnings(hil.load("paper"))
    assert warning.code == "ideal_live"
    assert "pump 1 at 0.4 from 200 s, pump 2 at 0.4 from 200 s" in warning.text
    assert live_warnings(hil.load("paper_glr")) == ()
    assert live_warnings(hil.load("steps", detector="ideal")) == (), "no fault to believe"
