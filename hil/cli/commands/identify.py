"""`hil identify`: from an experiment, or from recorded runs, to the parameters of the rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.complaint import interruptible
from hil.cli.options import Bitrate, Channel, ClearTrip, ConfigDir, Interface, RerunChoice, RigFile

EXAMPLE = "hil identify -i socketcan -c can0 --out runs/my-rig"

RecordedRuns = Annotated[
    Optional[list[Path]],
    typer.Argument(metavar="[RUN]...", help="Run folders to identify from, in place of an experiment."),
]
ExperimentDir = Annotated[
    Optional[Path],
    typer.Option(
        "--out",
        metavar="DIR",
        help="The folder of the experiment. One that has a part of it already gets the rest. "
        "Default: a new one in runs/.",
    ),
]
FullExperiment = Annotated[
    bool,
    typer.Option("--full", help="For curves, dead zones, delays, datum and sensors: 20 minutes, not 12."),
]
Minutes = Annotated[
    Optional[float],
    typer.Option("--minutes", metavar="M", min=0.4, max=120.0, help="Length of the experiment. Default: 12, or 20."),
]
AskForRuler = Annotated[
    bool, typer.Option("--ruler", help="Ask for levels read by a ruler, ten times, when they stand still.")
]
RulerReadings = Annotated[
    Optional[int],
    typer.Option("--ruler-readings", metavar="N", min=1, max=24, help="As --ruler, but N times."),
]
RulerSd = Annotated[
    float,
    typer.Option(
        "--ruler-sd", metavar="MM", min=0.1, max=10.0, help="Standard deviation of one reading by the ruler, mm."
    ),
]
RulerFile = Annotated[
    Optional[Path],
    typer.Option("--ruler-file", metavar="FILE", help="Take these levels as read then: CSV with tank, level_cm."),
]
NoQuestions = Annotated[bool, typer.Option("--yes", help="Begin every phase without asking.")]
WithEmulator = Annotated[
    bool, typer.Option("--emulator", help="Experiment with the emulator, in lockstep, from empty tanks.")
]
EmulatorSeed = Annotated[int, typer.Option(min=0, help="With --emulator: seed of its noise and of the ruler's error.")]
TrueRig = Annotated[
    Optional[str],
    typer.Option(
        "--truth",
        metavar="FILE",
        help="With --emulator: the rig that it is. A rig file, an emulator file, or a scenario with an "
        "emulator table, or a shipped name. Default: that of --rig.",
    ),
]
WriteRigFile = Annotated[
    bool,
    typer.Option("--write", help="Replace the rig file, with a dated copy, if the new one predicts better by 10 %."),
]
CheckFile = Annotated[
    bool,
    typer.Option(
        "--check",
        help="Say how far the parameters have moved from the rig file (default: that of the newest run), run by "
        "run, and how fast. Exit code 5 beyond --limit. With --out: check.json, trend.png.",
    ),
]
CheckLimit = Annotated[
    float, typer.Option("--limit", metavar="SD", min=0.1, max=1000.0, help="Of --check, in standard deviations.")
]


def identify(
    runs: RecordedRuns = None,
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    out: ExperimentDir = None,
    full: FullExperiment = False,
    minutes: Minutes = None,
    ruler: AskForRuler = False,
    ruler_readings: RulerReadings = None,
    ruler_sd: RulerSd = 1.0,
    ruler_file: RulerFile = None,
    yes: NoQuestions = False,
    clear_trip: ClearTrip = False,
    emulator: WithEmulator = False,
    seed: EmulatorSeed = 1,
    truth: TrueRig = None,
    rig: RigFile = None,
    config: ConfigDir = None,
    write: WriteRigFile = False,
    check: CheckFile = False,
    limit: CheckLimit = 3.0,
    rerun: RerunChoice = True,
) -> None:
    """Identify the rig: an experiment of 12 minutes that moves the pumps, or recorded runs; then the parameters.

    The experiment goes through phases. Each is announced, waits for a word unless --yes is given, and leaves the pumps
    at 0 V. Ctrl-C ends it at any time; the same command with the same --out then goes on. Stay beside the rig.
    """
    if check:
        raise typer.Exit(_check_file(runs or [], rig, config, limit, out))
    from hil.cli import identify_command as identification
    from hil.core.experiment_plan import RULER_READINGS

    options = identification.IdentifyOptions(
        runs=tuple(runs or ()),
        interface=interface,
        channel=channel,
        bitrate=bitrate,
        out=out,
        is_full=full,
        minutes=minutes,
        readings=ruler_readings or (RULER_READINGS if ruler or ruler_file is not None else 0),
        reading_sd_mm=ruler_sd,
        ruler_file=ruler_file,
        is_confirmed=yes,
        clear_trip=clear_trip,
        with_emulator=emulator,
        seed=seed,
        truth=truth,
        rig=rig,
        config_dir=config,
        rerun=rerun,
        write=write,
    )
    with interruptible():
        raise typer.Exit(identification.run(Console(), options))


def _check_file(runs: list[Path], rig: str | None, config: Path | None, limit: float, out: Path | None) -> int:
    """Compare the rig file with recorded runs; the exit code. Without --rig and --config the newest run names it."""
    from hil.cli import file_check
    from hil.edge.config.shipped import rig_file_in_use

    rig_path = None if rig is None and config is None else rig_file_in_use(rig, config)
    with interruptible():
        return file_check.run(Console(), tuple(runs), rig_path, limit, out)
