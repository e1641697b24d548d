"""A run folder through today's controller: the same commands, or the first difference."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from hil.core.gain_design import Gains
from hil.core.tanks import Array
from hil.edge.record.run_folder import RunFolder
from hil.replay.command_difference import SENT, CommandDifference
from hil.replay.frame_log import ReplayError
from hil.replay.recorded_bench import WhatIf
from hil.replay.replay_page import replay_page
from hil.replay.replay_run import ReplayOptions, ReplayResult, replay
from hil.review.ticks import read_ticks

EXACT = ReplayOptions(tolerance_V=0.0)


def first_difference(result: ReplayResult) -> CommandDifference:
    assert result.comparison is not None
    assert result.comparison.first is not None
    return result.comparison.first


def test_a_fresh_run_is_repeated_bit_by_bit(recorded_run: Path) -> None:
    """Every command, with its counter, and every event; those of a scheduled MANUAL and AUTO, too."""
    result = replay(recorded_run, EXACT)
    assert result.comparison is not None
    assert (result.comparison.differing, result.comparison.rounded, result.comparison.first) == (0, 0, None)
    assert result.comparison.compared == len((recorded_run / "sent.log").read_text().splitlines()) > 240
    assert result.expected == result.replayed.payloads
    lines = (recorded_run / "events.jsonl").read_text().splitlines()
    assert result.replayed.event_text.splitlines() == lines[: len(lines) - 1], "all but the end of the run"
    assert result.recorded_alarms
    assert result.recorded_alarms == result.replayed_alarms
    assert result.doubts == ()


def test_one_gain_changed_by_a_per_cent_is_seen_where_it_acts_first(
    recorded_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gain from level 2 to pump 2: at the first step at which the law and not the rate limit sets that pump."""
    made = Gains.from_matrix.__func__  # type: ignore[attr-defined]

    def changed(cls: type[Gains], K: Array) -> Gains:
        return made(cls, K * np.array([[1.0] * 6, [1.0, 1.01, 1.0, 1.0, 1.0, 1.0]]))  # type: ignore[no-any-return]

    monkeypatch.setattr(Gains, "from_matrix", classmethod(changed))
    result = replay(recorded_run, ReplayOptions())
    ticks = read_ticks(RunFolder(recorded_run).ticks_path)
    is_limited = np.abs(ticks["v2_V"] - ticks["v2_raw_V"]) > 1e-4
    first = first_difference(result)
    assert first.signal == "Command2"
    assert first.t_s == ticks["t_s"][int(np.argmin(is_limited))] > 0.0
    assert abs(first.recorded - first.replayed) > first.tolerance == pytest.approx(2e-4)
    assert "Command2 at" in result.summary[0]
    assert not result.is_same


def test_a_command_that_was_changed_in_the_record_is_found(recorded_run: Path, tmp_path: Path) -> None:
    """Its time, its signal and both values."""
    run = shutil.copytree(recorded_run, tmp_path / "run")
    result = replay(run, EXACT)
    step = next(at for at, one in enumerate(result.recorded.steps) if one.t_s == pytest.approx(12.0))
    old = result.expected[step]
    layout = result.contract.frames["PumpCommand"]
    values = layout.decode(old)
    assert values is not None
    new = layout.encode(values | {"Command1": values["Command1"] + 0.5})
    for name in ("can.log", "sent.log"):
        text = (run / name).read_text()
        assert text.count(old.hex().upper()) == 1
        (run / name).write_text(text.replace(old.hex().upper(), new.hex().upper()))
    first = first_difference(replay(run, ReplayOptions()))
    assert (first.step, first.signal) == (step, "Command1")
    assert first.t_s == pytest.approx(12.0)
    assert first.recorded - first.replayed == pytest.approx(0.5, abs=1e-3)


def test_a_what_if_has_alarms_and_no_verdict(recorded_run: Path) -> None:
    """Another law asks for other voltages: the replay must not take the recorded rig for one that disobeys."""
    result = replay(recorded_run, ReplayOptions(WhatIf(law="pi", detector="sliding_mode")))
    assert result.comparison is None
    assert result.is_same
    assert result.summary == ("what if: detector sliding_mode, law pi; there is no verdict on the commands",)
    assert [one.kind for one in result.recorded_alarms or ()] == ["pump_effectiveness"]
    assert [one.kind for one in result.replayed_alarms] == ["pump_effectiveness"]
    assert '"trip"' not in result.replayed.event_text
    assert result.expected != result.replayed.payloads
    assert "what if" in replay_page(result)


def test_a_reference_says_from_then_on_what_is_right(recorded_run: Path, tmp_path: Path) -> None:
    """--update: a wanted change is the new reference; without it the next replay differs, with alarms as well."""
    run = shutil.copytree(recorded_run, tmp_path / "run")
    assert replay(run, ReplayOptions(update=True)).is_same
    again = replay(run, EXACT)
    assert (again.is_same, again.reference_version != "") == (True, True)
    reference = json.loads((run / "reference.json").read_text())
    reference["alarms"][0]["kind"] = "pump_stuck"
    reference["commands"][100][0] += 0.1
    (run / "reference.json").write_text(json.dumps(reference))
    other = replay(run, ReplayOptions())
    assert other.comparison is not None
    assert other.comparison.first is not None
    assert (other.comparison.first.step, other.comparison.differing) == (100, 1)
    assert "recorded" in other.alarm_difference
    (run / "reference.json").write_text('{"format": 1}')
    with pytest.raises(ReplayError, match=r"reference\.json is no reference of a replay"):
        replay(run, ReplayOptions())
    with pytest.raises(ReplayError, match="--update is of what was recorded"):
        replay(run, ReplayOptions(WhatIf(law="pi"), update=True))


def test_the_page_shows_both_and_the_first_difference(recorded_run: Path) -> None:
    """One file that needs no other."""
    text = replay_page(replay(recorded_run, EXACT))
    assert "same commands as recorded" in text
    assert text.count("<svg") == 1
    assert "http" not in text


def test_a_step_that_is_missing_on_one_side_is_a_difference() -> None:
    """Its words."""
    assert (
        str(CommandDifference(SENT, 7, None, 1.0, 0.0, 0.0)) == "at step 7: a command was recorded, none is sent today"
    )
