"""`hil calibrate`: gain and offset of the level sensors from known levels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.options import Bitrate, Channel, ConfigDir, Interface, RigFile

EXAMPLE = "hil calibrate -i slcan -c /dev/ttyACM0 --out calibration"


def calibrate(
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    points: Annotated[
        Optional[Path],
        typer.Option(
            "--points",
            metavar="FILE",
            help="Known levels, CSV or TOML: tank, level_cm and, if known, reading_V. "
            "Readings that the file does not have are taken over CAN.",
        ),
    ] = None,
    tank: Annotated[
        Optional[list[int]],
        typer.Option("--tank", metavar="N", min=1, max=4, help="Only this tank; may be repeated. Default: all four."),
    ] = None,
    out: Annotated[
        Optional[Path],
        typer.Option(
            "--out",
            metavar="DIR",
            help="The folder to write; must not exist. Default: runs/<time>_calibration.",
        ),
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Replace the rig file; a copy with the date in its name is kept.")
    ] = False,
    rig: RigFile = None,
    config: ConfigDir = None,
) -> None:
    """Calibrate the level sensors: offset and gain from two or more known levels of each tank.

    Without --points it asks for the levels and shows the reading meanwhile. It sends no command: the pumps stay at 0 V.
    """
    from hil.cli import calibrate_command as calibration

    options = calibration.CalibrateOptions(
        interface, channel, bitrate, points, tuple(tank or (1, 2, 3, 4)), out, write, config, rig
    )
    raise typer.Exit(calibration.run(Console(), options))
