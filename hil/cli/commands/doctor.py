"""`hil doctor`: check a bench before a run."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console

from hil.cli.complaint import interrupted
from hil.cli.options import Bitrate, Channel, ConfigDir, Interface, RigFile, WithPumps

EXAMPLE = "hil doctor -i slcan -c /dev/ttyACM0"


def doctor(
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    seconds: Annotated[
        float, typer.Option("--seconds", metavar="S", min=1.0, max=600.0, help="How long to listen first.")
    ] = 5.0,
    with_pumps: WithPumps = False,
    rig: RigFile = None,
    config: ConfigDir = None,
) -> None:
    """Check bus, nodes, sensors, watchdog and host before a run. Moves no pump without --with-pumps."""
    from hil.cli import doctor_command as examination
    from hil.probe.bus_probe import InterruptedByUserError

    options = examination.DoctorOptions(interface, channel, bitrate, seconds, with_pumps, config, rig)
    try:
        raise typer.Exit(examination.run(Console(), options))
    except InterruptedByUserError as error:
        raise typer.Exit(interrupted(str(error))) from None
