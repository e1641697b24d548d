"""`hil identify` on the terminal: announces and confirms the phases, asks for the levels, shows what was found."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from rich.console import Console

from hil.bench import identify_inputs, run_options
from hil.bench.bus_choice import chosen_bus
from hil.bench.experiment_folder import make_folder
from hil.bench.experiment_run import (
    Aborted,
    EmulatedStage,
    ExperimentBench,
    ExperimentOptions,
    LiveStage,
    Stage,
    run_experiment,
)
from hil.bench.ruler import EmulatedRuler, GivenRuler, Ruler
from hil.cli import exit_codes, identify_result
from hil.cli.complaint import complain
from hil.cli.terminal_ruler import TerminalRuler
from hil.core.counted import counted
from hil.core.experiment import Phase
from hil.core.identification.identify import identify
from hil.edge.config.points_file import load_points
from hil.edge.config.settings_file import SettingsError

REFUSALS = ("n", "no", "q", "quit")


@dataclass(frozen=True)
class IdentifyOptions:
    """Options of the command line; None: the default."""

    runs: tuple[Path, ...] = ()
    interface: str | None = None
    channel: str | None = None
    bitrate: int | None = None
    out: Path | None = None
    is_full: bool = False
    minutes: float | None = None
    readings: int = 0
    reading_sd_mm: float = 1.0
    ruler_file: Path | None = None
    is_confirmed: bool = False
    clear_trip: bool = False
    with_emulator: bool = False
    seed: int = 1
    truth: str | None = None
    rig: str | None = None
    config_dir: Path | None = None
    rerun: bool = True
    write: bool = False

    @property
    def reading_sd_cm(self) -> float:
        """Standard deviation of one reading by a ruler."""
        return 0.1 * self.reading_sd_mm

    @property
    def of_experiment(self) -> ExperimentOptions:
        """Those of the experiment."""
        return ExperimentOptions(self.is_full, self.readings, self.minutes, self.rerun, self.clear_trip)


def run(console: Console, options: IdentifyOptions) -> int:
    """An experiment if no runs are given, then the identification; returns the exit code."""
    _check(options)
    bench = identify_inputs.load_bench(options.rig, options.config_dir)
    out = options.out or run_options.default_folder("identify", datetime.now())
    if options.runs:
        return _identify(console, bench, options, options.runs, out)
    try:
        folder = run_experiment(
            bench, options.of_experiment, _stage(console, bench, options), out, Confirmation(console, options, out)
        )
    except Aborted as aborted:
        return _aborted(aborted, out)
    if folder is None:
        console.print(f"stopped between two phases; the same command goes on (--out {out})", highlight=False)
        return 0
    return _identify(console, bench, options, folder.runs(), out)


def _check(options: IdentifyOptions) -> None:
    """Refuse options that contradict each other. Raises SettingsError."""
    if options.truth is not None and not options.with_emulator:
        raise SettingsError("--truth is the emulator's rig: it needs --emulator")
    if options.with_emulator and (options.interface or options.channel):
        raise SettingsError("--emulator and -i, -c exclude each other: choose one")
    if options.runs and (options.with_emulator or options.interface or options.channel):
        raise SettingsError("recorded runs are identified without an experiment: leave -i, -c and --emulator out")


def _stage(console: Console, bench: ExperimentBench, options: IdentifyOptions) -> Stage:
    """The rig on its bus, or the emulator. Raises SettingsError."""
    given: Ruler | None = None
    if options.ruler_file is not None:
        given = GivenRuler([(one.tank - 1, one.level_cm, one.level_sd_cm) for one in load_points(options.ruler_file)])
    if options.with_emulator:
        emulator = identify_inputs.emulator(options.truth, options.rig, options.config_dir, options.seed)
        ruler = given or EmulatedRuler(lambda: emulator.levels_cm, options.seed, options.reading_sd_cm)
        return EmulatedStage(emulator, options.seed, ruler if options.readings else None)
    address = chosen_bus(bench.rig, options.interface, options.channel, options.bitrate)
    by_hand = TerminalRuler(console, sd_cm=options.reading_sd_cm) if options.readings and not given else None
    return LiveStage(address, given or by_hand)


class Confirmation:
    """Announces each phase and waits for a word, unless all are confirmed."""

    def __init__(self, console: Console, options: IdentifyOptions, out: Path) -> None:
        self._console, self._is_confirmed, self._out = console, options.is_confirmed or options.with_emulator, out
        self._is_first = True

    def __call__(self, index: int, phases: tuple[Phase, ...], recorded: Path | None) -> bool:
        """Whether the phase may begin."""
        phase = phases[index]
        if self._is_first:
            self._is_first = False
            moving_min = sum(one.moving_s for one in phases) / 60.0
            self._say(
                f"experiment of {len(phases)} phases, {moving_min:.0f} min, after the tanks are empty; "
                f"record in {self._out}"
            )
        head = f"phase {index + 1} of {len(phases)}, {phase.name}"
        if recorded is not None:
            self._say(f"{head}: is recorded in {recorded}")
            return True
        self._say(f"{head}: {phase.text}; {phase.moving_s:.0f} s")
        if self._is_confirmed:
            return True
        try:
            answer = self._console.input("Enter starts it, n ends the experiment: ")
        except EOFError:
            self._say("nobody answers; --yes begins every phase without asking")
            return False
        return answer.strip().lower() not in REFUSALS

    def _say(self, text: str) -> None:
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)


def _aborted(aborted: Aborted, out: Path) -> int:
    """The line and the exit code of an experiment that ended early."""
    outcome = aborted.outcome
    code = exit_codes.of_run(outcome.status, outcome.reason) or exit_codes.INCOMPLETE
    if aborted.has_stopped_itself:
        code = exit_codes.NOT_DONE
    clearing = ", with --clear-trip if the pump node has tripped too" if outcome.status == "tripped" else ""
    return complain(
        f"{aborted}; its record is {aborted.path}. What is recorded is kept: the same command goes on (--out {out})"
        f"{clearing}",
        code,
    )


def _identify(
    console: Console, bench: ExperimentBench, options: IdentifyOptions, runs: tuple[Path, ...], out: Path
) -> int:
    """Fit the records, write the result into the folder and show it."""
    fitted, held_out = identify_inputs.records_of(runs)
    console.print(f"fitting {counted(len(fitted), 'record')} ...", highlight=False)
    found = identify(fitted, identify_inputs.rig_model(bench.rig), held_out=held_out or None)
    make_folder(out)
    return identify_result.finish(
        console, found, bench.rig_path, out, write=options.write, now=datetime.now(), rerun=options.rerun
    )
