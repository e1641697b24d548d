"""Logs of others, and damaged ones: steps as far as they can be told, and a clear message for the rest."""

from __future__ import annotations

import gc
import shutil
import sys
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.bench import assembly
from hil.core.errors import HilError
from hil.edge.config.settings_file import default_config_dir
from hil.edge.record.run_folder import RunFolder
from hil.replay.folder_steps import read_folder_steps
from hil.replay.frame_log import ReplayError
from hil.replay.log_reader import mf4_module, read_log
from hil.replay.log_steps import read_log_steps
from hil.replay.replay_run import ReplayOptions, replay
from hil.wire.contract import Contract

COMMAND = 0x201
LATER_S = 1.7e9
"""Logs of others have times of today; those of a run in lockstep begin with the epoch."""


@pytest.fixture(scope="module")
def contract() -> Contract:
    return assembly.load_contract(default_config_dir() / "bench.dbc")


@pytest.fixture(scope="module")
def frames(recorded_run: Path) -> list[can.Message]:
    with can.CanutilsLogReader(recorded_run / "can.log") as reader:
        messages = list(reader)
    for message in messages:
        message.timestamp += LATER_S
    return messages


def log_of(frames: list[can.Message], path: Path) -> Path:
    """Such a log, written by python-can."""
    with mf4_module().MF4Writer(path) if path.suffix == ".mf4" else can.Logger(path) as writer:
        for message in frames:
            writer(message)
    return path


def times_and_reads(path: Path, contract: Contract) -> list[tuple[int, int]]:
    """Of each step: when it began, in ms after the first, and how many frames it had read."""
    steps = read_log_steps(path, contract, 0.1).steps
    return [(round((step.now_ns - steps[0].now_ns) * 1e-6), step.until) for step in steps]


def test_the_log_of_another_recorder_gives_the_same_commands(
    frames: list[can.Message], recorded_run: Path, tmp_path: Path
) -> None:
    """Only the scenario is named: candump's lines, without sent.log, ticks.csv and run.json."""
    log = log_of(frames, tmp_path / "bench.log")
    result = replay(log, ReplayOptions(scenario=recorded_run.parent / "replayed.toml", tolerance_V=0.0))
    assert result.comparison is not None
    assert (result.comparison.first, result.comparison.rounded) == (None, 0)
    assert result.comparison.compared > 240
    assert [one.kind for one in result.replayed_alarms] == ["pump_effectiveness"]
    assert any("neither the lateness" in doubt for doubt in result.doubts)


@pytest.mark.parametrize("suffix", [".blf", ".asc", pytest.param(".mf4", marks=pytest.mark.long)])
def test_every_format_gives_the_same_steps(
    suffix: str, frames: list[can.Message], contract: Contract, tmp_path: Path
) -> None:
    """Times within a microsecond, frames by the identifiers of the DBC."""
    other, plain = log_of(frames, tmp_path / f"bench{suffix}"), log_of(frames, tmp_path / "bench.log")
    assert times_and_reads(other, contract) == times_and_reads(plain, contract)


@pytest.mark.long
def test_a_cut_off_file_of_measurement_is_refused_without_a_traceback(
    frames: list[can.Message], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The library's half-opened file failed again when it was removed, and Python printed that."""
    whole = log_of(frames[:200], tmp_path / "whole.mf4").read_bytes()
    cut = tmp_path / "cut.mf4"
    cut.write_bytes(whole[: len(whole) // 2])
    shown: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", shown.append)
    with pytest.raises(ReplayError, match=r"cut\.mf4 can't be read as MF4"):
        read_log(cut)
    gc.collect()
    assert shown == []


def test_an_unordered_log_is_sorted_and_says_so(frames: list[can.Message], contract: Contract, tmp_path: Path) -> None:
    """Two recorders that were put together."""
    mixed = frames[:50] + frames[100:150] + frames[50:100] + frames[150:]
    log = log_of(mixed, tmp_path / "mixed.log")
    assert times_and_reads(log, contract) == times_and_reads(log_of(frames, tmp_path / "bench.log"), contract)
    assert any("not in the order of time (1 frame" in doubt for doubt in read_log_steps(log, contract, 0.1).doubts)


def test_a_gap_in_a_log_is_found(frames: list[can.Message], contract: Contract, tmp_path: Path) -> None:
    """By the commands' counters and times; the steps after it keep their times."""
    at = [number for number, one in enumerate(frames) if one.arbitration_id == COMMAND]
    log = log_of(frames[: at[40] + 1] + frames[at[43] + 1 :], tmp_path / "gap.log")
    steps = read_log_steps(log, contract, 0.1)
    assert steps.missing == {41}
    assert any("are missing before these times of the log: 4.4" in doubt for doubt in steps.doubts), steps.doubts
    assert steps.steps[41].now_ns - steps.steps[40].now_ns == pytest.approx(400_000_000, abs=1000)


@pytest.mark.parametrize(
    ("keep", "message"),
    [
        (lambda one: one.arbitration_id != COMMAND, "no command of a controller in this log"),
        (lambda one: one.timestamp > LATER_S + 5.0, "begins within a run"),
        (lambda one: one.timestamp < LATER_S, "there is no frame in this log"),
    ],
)
def test_a_log_that_can_not_be_replayed_says_why(
    keep: Any, message: str, frames: list[can.Message], contract: Contract, tmp_path: Path
) -> None:
    """One line that names the file."""
    log = log_of([one for one in frames if keep(one)], tmp_path / "part.log")
    with pytest.raises(ReplayError, match=message) as error:
        read_log_steps(log, contract, 0.1)
    assert str(log) in str(error.value)


def test_a_log_of_another_bench_says_what_is_in_it(contract: Contract, tmp_path: Path) -> None:
    """Of a bus with other nodes; of another rig, whose controller steps at another rate; and none at all."""
    foreign = [can.Message(timestamp=LATER_S + t, arbitration_id=0x7E8, data=b"\0") for t in range(9)]
    with pytest.raises(ReplayError, match=r"no frame of the bench in this log: .* the log has 7E8"):
        read_log_steps(log_of(foreign, tmp_path / "foreign.log"), contract, 0.1)
    with pytest.raises(ReplayError, match="no such run folder or log"):
        replay(tmp_path / "none.log", ReplayOptions())
    with pytest.raises(ReplayError, match="name the scenario that ran with --scenario"):
        replay(tmp_path / "foreign.log", ReplayOptions())
    (tmp_path / "notes.txt").write_text("no log")
    with pytest.raises(ReplayError, match=r"\.txt is no log that can be read"):
        read_log_steps(tmp_path / "notes.txt", contract, 0.1)


def test_another_period_is_no_log_of_this_rig(frames: list[can.Message], contract: Contract, tmp_path: Path) -> None:
    """It used to look like a controller that skips steps."""
    with pytest.raises(ReplayError, match=r"commands come every 0\.1 s, but control\.period_s of the rig is 0\.05 s"):
        read_log_steps(log_of(frames[:900], tmp_path / "bench.log"), contract, 0.05)


@pytest.fixture(scope="module")
def scratch(recorded_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy whose files are cut off again and again."""
    return shutil.copytree(recorded_run, tmp_path_factory.mktemp("cut") / "run")


@settings(max_examples=40, derandomize=True)
@given(
    name=st.sampled_from(["can.log", "sent.log", "ticks.csv", "events.jsonl", "run.json"]), share=st.floats(0.0, 1.0)
)
def test_a_file_that_is_cut_off_anywhere_is_read_or_refused(
    recorded_run: Path, scratch: Path, name: str, share: float
) -> None:
    """No traceback at any byte; what is left is replayed up to there, and said."""
    whole = (recorded_run / name).read_bytes()
    (scratch / name).write_bytes(whole[: int(share * len(whole))])
    try:
        steps = read_folder_steps(RunFolder.open(scratch), COMMAND)
    except HilError as error:
        said = str(error)
    else:
        said = ""
        read = [step.until for step in steps.steps]
        assert read == sorted(read)
        assert read[-1] <= len(steps.received)
        if name == "can.log" and share < 0.99:
            assert any("can.log ends before the step at" in doubt for doubt in steps.doubts)
    finally:
        (scratch / name).write_bytes(whole)
    assert "\n" not in said


@settings(max_examples=15, derandomize=True)
@given(share=st.floats(0.0, 1.0), suffix=st.sampled_from([".log", ".blf", ".asc"]))
def test_a_foreign_log_that_is_cut_off_anywhere_is_read_or_refused(
    frames: list[can.Message], contract: Contract, tmp_path_factory: pytest.TempPathFactory, share: float, suffix: str
) -> None:
    """As above."""
    place = tmp_path_factory.mktemp("logs")
    whole = log_of(frames[:900], place / f"whole{suffix}").read_bytes()
    cut = place / f"cut{suffix}"
    cut.write_bytes(whole[: int(share * len(whole))])
    try:
        steps = read_log_steps(cut, contract, 0.1)
    except HilError as error:
        said = str(error)
    else:
        said = str(cut)
        assert steps.steps
    assert str(cut) in said


@pytest.mark.parametrize("mode", ["lockstep", "live"])
def test_a_record_of_the_first_format_is_refused_in_a_line(mode: str) -> None:
    """Its contract is another one. A record without the name of a law used to be a traceback."""
    with pytest.raises(HilError, match=r"run\.json.*(no signal StartPhase$|copies)"):
        replay(Path(__file__).parents[1] / "review/format1" / mode, ReplayOptions())


def test_a_record_cut_off_in_the_middle_is_replayed_up_to_there(recorded_run: Path, tmp_path: Path) -> None:
    """The same commands as far as there are frames; the alarms after that are not missed."""
    run = shutil.copytree(recorded_run, tmp_path / "run")
    text = (run / "can.log").read_text()
    (run / "can.log").write_text(text[: len(text) // 4])
    result = replay(run, ReplayOptions(tolerance_V=0.0))
    assert result.is_same, result.summary
    assert result.comparison is not None
    assert 40 < result.comparison.compared < 80
    assert any("can.log ends before the step at" in doubt for doubt in result.doubts)


def test_missing_and_shuffled_lines_of_a_run_folder_are_found(recorded_run: Path, tmp_path: Path) -> None:
    """A gap is named by its time, as the counts of ticks.csv show it; an order that is not the run's is refused."""
    run = shutil.copytree(recorded_run, tmp_path / "run")
    lines = (run / "can.log").read_text().splitlines(keepends=True)
    level, command = (
        next(number for number, line in enumerate(lines) if number > 900 and name in line)
        for name in (" 182#", " 201#")
    )
    (run / "can.log").write_text("".join(lines[:command] + lines[command + 1 :]))
    result = replay(run, ReplayOptions(tolerance_V=0.0))
    assert result.is_same
    assert any("can.log lacks 1 command that sent.log has" in doubt for doubt in result.doubts), result.doubts
    (run / "can.log").write_text("".join(lines[:level] + lines[level + 1 :]))
    steps = read_folder_steps(RunFolder.open(run), COMMAND)
    assert len(steps.missing) == 1
    assert any("can.log has gaps: 1 frame missing before" in doubt for doubt in steps.doubts), steps.doubts
    (run / "can.log").write_text("".join(lines[:700] + lines[800:900] + lines[700:800] + lines[900:]))
    with pytest.raises(ReplayError, match=r"can\.log, line \d+ is earlier than the frame of its identifier before it"):
        read_folder_steps(RunFolder.open(run), COMMAND)
