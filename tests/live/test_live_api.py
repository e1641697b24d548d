"""`hil.run`: a live run from a script, over slcan to an emulator in another process."""

from pathlib import Path

import numpy as np
import pytest

import hil
from tests.live.live_bench import emulator, write_scenario

pytestmark = pytest.mark.live


def test_a_script_runs_live_and_gets_figures_series_and_a_folder(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, duration=1.0)
    modes = []
    with emulator(tmp_path / "node.jsonl") as rig:
        result = hil.run(
            scenario,
            out=tmp_path / "run",
            detector="none",
            interface="slcan",
            channel=rig.channel,
            rerun=False,
            on_tick=lambda _inputs, _output, mode: modes.append(mode.name),
        )
        assert rig.pump()[-1]["applied_V"] == [0.0, 0.0]
    assert (result.status, result.reason) == ("complete", "duration over")
    assert result.folder == tmp_path / "run"
    assert result.series["v1_applied_V"].max() > 1.0
    assert np.all(np.diff(result.series["t_s"]) > 0.0)
    assert "RUNNING" in modes


def test_a_bus_that_cannot_be_opened_is_an_error_of_hil(tmp_path: Path) -> None:
    with pytest.raises(hil.BusError, match="can't be opened"):
        hil.run("steps", out=tmp_path / "run", interface="slcan", channel="socket://127.0.0.1:1")
    assert not (tmp_path / "run").exists()
