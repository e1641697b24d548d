"""An experiment in lockstep: whatever aborts a phase, the pumps end at 0 V and the next call goes on with the rest."""

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import pytest

from firmware_sim.faults.base import Fault
from firmware_sim.faults.catalogue import KINDS
from firmware_sim.rig import Rig as Emulator
from firmware_sim.settings import load, load_fingerprint
from hil.bench.experiment_folder import ExperimentFolder, ExperimentFolderError
from hil.bench.experiment_run import Aborted, EmulatedStage, ExperimentOptions, phases_of, run_experiment
from hil.bench.identify_inputs import load_bench
from hil.bench.ruler import EmulatedRuler, GivenRuler, read_readings
from hil.core.experiment import Phase
from hil.core.types import Quad
from hil.edge.config.settings_file import default_config_dir
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from tests.cli.failing_disk import FailingDisk

CONFIG = default_config_dir()
BENCH = load_bench(None, None)
SHORT = ExperimentOptions(minutes=0.4, rerun=False)
PHASES = [phase.name for phase in phases_of(BENCH, SHORT)]


class Rig(Emulator):
    """An emulator that does something once, in the first step of a phase in which a pump runs."""

    on_moving: Callable[["Rig"], None] | None = None

    @property
    def levels_cm(self) -> Quad:
        if self.on_moving is not None and max(self.pump.applied_V) > 0.0:
            action, self.on_moving = self.on_moving, None
            action(self)
        return super().levels_cm


def rig() -> Rig:
    settings, _ = load(CONFIG / "emulator.toml", is_empty=True)
    return Rig(settings, (), 1, load_fingerprint(CONFIG / "bench.dbc"))


@dataclass
class Asked:
    """Confirms everything, and knows what was asked for; before `phase` it prepares the abort."""

    emulator: Rig
    phase: str = ""
    action: Callable[[Rig], None] | None = None
    begun: list[str] = field(default_factory=list)

    def __call__(self, index: int, phases: tuple[Phase, ...], recorded: Path | None) -> bool:
        name = phases[index].name
        if recorded is None:
            self.begun.append(name)
            if name == self.phase:
                self.emulator.on_moving = self.action
        return True


def fault(kind: str, target: object) -> Fault:
    return cast(Fault, KINDS[kind].model_validate({"kind": kind, "target": target, "at_s": 0.0}))


def ctrl_c(_: Rig) -> None:
    os.kill(os.getpid(), signal.SIGINT)


def trip(emulator: Rig) -> None:
    emulator.inject(fault("node_reboot", "pump"), emulator.now_ns)


def silence(emulator: Rig) -> None:
    emulator.inject(fault("node_silent", "level"), emulator.now_ns)


def go(emulator: Rig, out: Path, asked: Asked) -> ExperimentFolder:
    folder = run_experiment(BENCH, SHORT, EmulatedStage(emulator, 1), out, asked)
    assert folder is not None
    return folder


@pytest.mark.parametrize(
    ("action", "status"),
    [(ctrl_c, "stopped"), (trip, "tripped"), (silence, "tripped")],
    ids=["ctrl-c", "trip", "silent"],
)
def test_an_abort_in_any_phase_stops_the_pumps_and_the_next_call_goes_on(
    action: Callable[[Rig], None], status: str, tmp_path: Path
) -> None:
    out = tmp_path / "experiment"
    for phase in PHASES:
        emulator = rig()
        with pytest.raises(Aborted) as aborted:
            go(emulator, out, asked := Asked(emulator, phase, action))
        assert emulator.pump.applied_V == (0.0, 0.0)
        assert (aborted.value.phase.name, aborted.value.outcome.status) == (phase, status)
        manifest = RunFolder.open(aborted.value.path).manifest()
        assert manifest.status == status, "the record of the aborted phase is kept, and closed"
        # the first phase begins with empty tanks each time; all others were recorded by the call before
        assert asked.begun[-1] == phase
        assert all(name not in asked.begun for name in PHASES[: max(PHASES.index(phase) - 1, 0)])
    asked = Asked(emulator := rig())
    folder = go(emulator, out, asked)
    assert asked.begun == PHASES[-1:]
    assert [path.name for path in folder.runs()] == [f"{i + 1:02d}_{name}_2" for i, name in enumerate(PHASES)]


@pytest.mark.parametrize("fails_from", [4, 30, 50, 75])
def test_a_disk_that_fills_up_stops_the_pumps_and_the_phase_is_repeated(
    fails_from: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "experiment"
    emulator = rig()
    ExperimentFolder.open(out, phases_of(BENCH, SHORT), SHORT.choices)
    with monkeypatch.context() as patch:
        FailingDisk(out / "phases", fails_from).install(patch)
        with pytest.raises((RunFolderError, Aborted)):
            go(emulator, out, Asked(emulator))
    assert emulator.pump.applied_V == (0.0, 0.0)
    second = Asked(rig())
    folder = go(second.emulator, out, second)
    assert 0 < len(second.begun) <= len(PHASES)
    assert len(folder.runs()) == len(PHASES)


def test_what_is_refused_ends_between_two_phases(tmp_path: Path) -> None:
    emulator = rig()
    stage = EmulatedStage(emulator, 1)
    assert run_experiment(BENCH, SHORT, stage, tmp_path / "x", lambda index, *_: index == 0) is None
    assert emulator.pump.applied_V == (0.0, 0.0)
    assert [path.name for path in (tmp_path / "x/phases").iterdir()] == ["01_fill"]


def test_a_folder_that_is_no_experiment_or_another_one_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    phases = phases_of(BENCH, SHORT)
    with pytest.raises(ExperimentFolderError, match=r"experiment\.json"):
        ExperimentFolder.open(tmp_path, phases, SHORT.choices)
    ExperimentFolder.open(tmp_path / "one", phases, SHORT.choices)
    with pytest.raises(ExperimentFolderError, match="other choices"):
        ExperimentFolder.open(tmp_path / "one", phases, {**SHORT.choices, "readings": 6})


def test_falling_sensors_under_the_file_of_rising_ones_are_not_filled(tmp_path: Path) -> None:
    settings, _ = load(CONFIG / "emulator.toml", None, CONFIG / "rigs/decenter2021.toml", is_empty=True)
    emulator = Rig(settings, (), 1, load_fingerprint(CONFIG / "bench.dbc"))
    with pytest.raises(Aborted, match=r"tank 1 reads 11\.70 cm.*hil calibrate"):
        go(emulator, tmp_path / "x", Asked(emulator))
    assert max(emulator.levels_cm) == 0.0


def test_the_ruler_is_read_in_its_phase_and_kept_beside_the_record(tmp_path: Path) -> None:
    emulator = rig()
    options = ExperimentOptions(minutes=0.4, rerun=False, readings=6)
    ruler = EmulatedRuler(lambda: emulator.levels_cm, 1)
    folder = run_experiment(BENCH, options, EmulatedStage(emulator, 1, ruler), tmp_path / "x", Asked(emulator))
    assert folder is not None
    path = folder.recorded("ruler")
    assert path is not None
    readings = read_readings(path)
    assert [reading.tank for reading in readings[:4]] == [0, 1, 2, 3]
    later = [reading for reading in readings if reading.time_s > readings[0].time_s]
    assert len({reading.time_s for reading in later}) == 5, "six readings in all"
    assert {reading.tank for reading in later} == {0, 1}, "the upper tanks are low: a millimetre is too much of them"
    assert all(reading.sd_cm == 0.1 and reading.level_cm > 0.0 for reading in readings)


def test_a_ruler_phase_whose_levels_were_lost_is_not_recorded(tmp_path: Path) -> None:
    emulator = rig()
    options = ExperimentOptions(minutes=0.4, rerun=False, readings=6)
    stage = EmulatedStage(emulator, 1, GivenRuler([]))
    folder = run_experiment(BENCH, options, stage, tmp_path / "x", Asked(emulator))
    assert folder is not None
    path = folder.recorded("ruler")
    assert path is not None, "nobody has read a level: that is an answer, too"
    assert read_readings(path) == ()
    (path / "ruler.csv").unlink()
    assert folder.recorded("ruler") is None


def test_given_levels_of_one_tank_belong_to_one_reading_after_the_other(tmp_path: Path) -> None:
    emulator = rig()
    options = ExperimentOptions(minutes=0.4, rerun=False, readings=6)
    stage = EmulatedStage(emulator, 1, GivenRuler([(0, 7.5, 0.2), (0, 7.0, 0.2), (3, 1.0, 0.1), (3, 1.1, 0.1)]))
    folder = run_experiment(BENCH, options, stage, tmp_path / "x", Asked(emulator))
    assert folder is not None
    path = folder.recorded("ruler")
    assert path is not None
    first, second, third = read_readings(path)
    assert [(one.tank, one.level_cm) for one in (first, second, third)] == [(0, 7.5), (3, 1.0), (0, 7.0)]
    assert first.time_s == second.time_s < third.time_s


def test_given_levels_are_those_of_the_moment_at_which_the_phase_asks(tmp_path: Path) -> None:
    emulator = rig()
    options = ExperimentOptions(minutes=0.4, rerun=False, readings=6)
    stage = EmulatedStage(emulator, 1, GivenRuler([(0, 7.5, 0.2)]))
    folder = run_experiment(BENCH, options, stage, tmp_path / "x", Asked(emulator))
    assert folder is not None
    path = folder.recorded("ruler")
    assert path is not None
    (reading,) = read_readings(path)
    assert (reading.tank, reading.level_cm, reading.sd_cm) == (0, 7.5, 0.2)
    assert reading.time_s > 0.0
