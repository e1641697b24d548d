"""`hil identify`: from an experiment, or from recorded runs, to the parameters of the rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.complaint import interruptible
from hil.cli.options import Bitrate, Channel, ConfigDir, Interface, RerunChoice, RigFile

EXAMPLE = "hil identify -i socketcan -c can0 --out runs/my-rig"


def identify(
    runs: Annotated[
        Optional[list[Path]],
        typer.Argument(metavar="[RUN]...", help="Run folders to identify from, in place of an experiment."),
    ] = None,
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    out: Annotated[
        Optional[Path],
        typer.Option(
            "--out",
            metavar="DIR",
            help="The folder of the experiment. One that has a part of it already gets the rest. "
            "Default: a new one in runs/.",
        ),
    ] = None,
    full: Annotated[
        bool,
        typer.Option("--full", help="For curves, dead zones, delays, datum and sensors: 20 minutes, not 12."),
    ] = False,
    minutes: Annotated[
        Optional[float],
        typer.Option(
            "--minutes", metavar="M", min=0.4, max=120.0, help="Length of the experiment. Default: 12, or 20."
        ),
    ] = None,
    ruler: Annotated[
        bool, typer.Option("--ruler", help="Ask for levels read by a ruler, ten times, when they stand still.")
    ] = False,
    ruler_readings: Annotated[
        Optional[int],
        typer.Option("--ruler-readings", metavar="N", min=1, max=24, help="As --ruler, but N times."),
    ] = None,
    ruler_sd: Annotated[
        float,
        typer.Option(
            "--ruler-sd", metavar="MM", min=0.1, max=10.0, help="Standard deviation of one reading by the ruler, mm."
        ),
    ] = 1.0,
    ruler_file: Annotated[
        Optional[Path],
        typer.Option("--ruler-file", metavar="FILE", help="Take these levels as read then: CSV with tank, level_cm."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Begin every phase without asking.")] = False,
    clear_trip: Annotated[
        bool, typer.Option("--clear-trip", help="First clear a trip that the pump node still has from an earlier run.")
    ] = False,
    emulator: Annotated[
        bool, typer.Option("--emulator", help="Experiment with the emulator, in lockstep, from empty tanks.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="With --emulator: seed of its noise and of the ruler's error.")] = 1,
    truth: Annotated[
        Optional[str],
        typer.Option(
            "--truth",
            metavar="FILE",
            help="With --emulator: the rig that it is. A rig file, an emulator file, or a scenario with an "
            "emulator table, or a shipped name. Default: that of --rig.",
        ),
    ] = None,
    rig: RigFile = None,
    config: ConfigDir = None,
    write: Annotated[
        bool,
        typer.Option(
            "--write", help="Replace the rig file, with a dated copy, if the new one predicts better by 10 %."
        ),
    ] = False,
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="Say how far the parameters have moved from the rig file (default: that of the newest run), run by "
            "run, and how fast. Exit code 5 beyond --limit. With --out: check.json, trend.png.",
        ),
    ] = False,
    limit: Annotated[
        float, typer.Option("--limit", metavar="SD", min=0.1, max=1000.0, help="Of --check, in standard deviations.")
    ] = 3.0,
    rerun: RerunChoice = True,
) -> None:
    """Identify the rig: an experiment of 12 minutes that moves the pumps, or recorded runs; then the parameters.

    The experiment goes through phases. Each is announced, waits for a word unless --yes is given, and leaves the pumps
    at 0 V. Ctrl-C ends it at any time; the same command with the same --out then goes on. Stay beside the rig.
    """
    if check:
        from hil.cli import file_check
        from hil.edge.config.shipped import find_rig

        rig_path = find_rig(rig, config) if rig is not None else None if config is None else config / "rig.toml"
        with interruptible():
            raise typer.Exit(file_check.run(Console(), tuple(runs or ()), rig_path, limit, out))
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
