"""`hil conformance`: test the nodes of a bench."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.cli.complaint import interrupted
from hil.cli.options import Bitrate, Channel, ConfigDir, Interface, WithPumps

EXAMPLE = "hil conformance --node pump --json pump.json"


class Node(StrEnum):
    """What `hil conformance` tests."""

    PUMP = "pump"
    LEVEL = "level"
    BOTH = "both"


def conformance(
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    node: Annotated[Node, typer.Option("--node", help="Which node to test.")] = Node.BOTH,
    with_pumps: WithPumps = False,
    power_cycle: Annotated[
        float,
        typer.Option(
            "--power-cycle",
            metavar="S",
            min=0.0,
            max=600.0,
            help="Wait up to S seconds for you to switch the node's power off and on.",
        ),
    ] = 0.0,
    json_file: Annotated[
        Optional[Path],
        typer.Option("--json", metavar="FILE", help="Also write the results into this file; it must not exist."),
    ] = None,
    config: ConfigDir = None,
) -> None:
    """Test the nodes on a bench against docs/reference/firmware.md. Moves no pump without --with-pumps."""
    from hil.cli import conformance_command as examination
    from hil.probe.bus_probe import InterruptedByUserError

    options = examination.ConformanceOptions(
        interface, channel, bitrate, node.value, with_pumps, json_file, power_cycle, config
    )
    try:
        raise typer.Exit(examination.run(Console(), options))
    except InterruptedByUserError as error:
        raise typer.Exit(interrupted(str(error))) from None
