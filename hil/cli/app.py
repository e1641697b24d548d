"""`hil`: the commands. Bad input ends with one line and exit code 2, before anything moves."""

from __future__ import annotations

import sys
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from hil.edge.can import adapters
from hil.version import __version__

EXIT_BAD_INPUT = 2
EXIT_CODES = {"complete": 0, "stopped": 0, "tripped": 3, "failed": 4}
SIGNAL_EXIT_CODES = {"SIGHUP": 129, "SIGINT": 130, "SIGTERM": 143}


class Node(StrEnum):
    """What `hil conformance` tests."""

    PUMP = "pump"
    LEVEL = "level"
    BOTH = "both"


app = typer.Typer(
    name="hil",
    help="Fault-tolerant control of the four-tank laboratory process over CAN.",
    epilog="Exit codes: 0 done, 2 bad input (nothing moved), 3 tripped, 4 not ready or failed, 130 and 143 by signal.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)

Interface = Annotated[
    Optional[str],
    typer.Option(
        "-i",
        "--interface",
        help=f"CAN interface: {adapters.known()}; or another of python-can. Default: the rig file's.",
    ),
]
Channel = Annotated[
    Optional[str],
    typer.Option("-c", "--channel", help=f"For {adapters.channels()}. Default: the rig file's."),
]
Bitrate = Annotated[
    Optional[int],
    typer.Option("-b", "--bitrate", min=10_000, max=1_000_000, help="bit/s. Default: the rig file's."),
]
WithPumps = Annotated[bool, typer.Option("--with-pumps", help="Move pumps, too, a little. Stand by the rig.")]
ScenarioFile = Annotated[Path, typer.Argument(metavar="SCENARIO.toml", help="The experiment; see config/scenarios.")]
ConfigDir = Annotated[
    Optional[Path],
    typer.Option("--config", metavar="DIR", help="Folder with rig.toml, emulator.toml and bench.dbc."),
]
OutDir = Annotated[
    Optional[Path],
    typer.Option(
        "--out", metavar="DIR", help="The run folder to make; refused if it exists. Default: runs/<time>_<name>."
    ),
]
Duration = Annotated[
    Optional[float],
    typer.Option(
        "--duration", metavar="S", min=0.0, max=1e7, help="Stop after S seconds of the run instead of the scenario's."
    ),
]
RerunChoice = Annotated[bool, typer.Option("--rerun/--no-rerun", help="Whether to write run.rrd.")]
ReportChoice = Annotated[bool, typer.Option("--report/--no-report", help="Whether to write report.html.")]


def main() -> None:
    """Entry point of the console script: turns errors the user can fix into one line."""
    try:
        code = app(standalone_mode=False)
    except typer.TyperException as error:  # a wrong option or argument
        code = _complain(str(getattr(error, "format_message", error.__str__)()))
    except (typer.Abort, KeyboardInterrupt):
        _complain("interrupted")
        code = SIGNAL_EXIT_CODES["SIGINT"]
    except Exception as error:
        from hil.bench.user_errors import USER_ERRORS  # only now: it brings in all that can raise them

        if not isinstance(error, USER_ERRORS):
            raise
        code = _complain(str(error))
    sys.exit(code if isinstance(code, int) else 0)


def _complain(what: str) -> int:
    line = " ".join(what.split())
    if line:  # nothing is left to say when the help was shown instead
        print(f"hil: {line}", file=sys.stderr)  # noqa: T201 - plain text, never reflowed
    return EXIT_BAD_INPUT


def _interrupted(signal_name: str) -> int:
    _complain(f"stopped by {signal_name}; the pump node was told 0 V")
    return SIGNAL_EXIT_CODES[signal_name]


def _version(value: bool) -> None:
    if value:
        typer.echo(f"hil {__version__}")
        raise typer.Exit


@app.callback()
def _about(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show and exit.")
    ] = False,
) -> None:
    del version


@app.command()
def simulate(
    scenario: ScenarioFile,
    out: OutDir = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the emulator's sensor noise.")] = 1,
    duration: Duration = None,
    config: ConfigDir = None,
    rerun: RerunChoice = True,
    report: ReportChoice = True,
) -> None:
    """Run a scenario in lockstep with the emulator, every frame on a virtual CAN bus, much faster than real time."""
    from hil.bench import assembly, lockstep_run, run_options
    from hil.cli import run_display

    bench = assembly.load(scenario, config)
    folder = out or run_options.default_folder(bench.scenario.scenario.name, datetime.now())
    options = run_options.RunOptions(folder, seed, duration, rerun)
    console = Console()
    with run_display.progress(console, bench, duration) as advance:
        figures = lockstep_run.simulate(bench, options, advance)
    run_display.finish(console, folder, figures, with_report=report)
    raise typer.Exit(EXIT_CODES[figures.status])


@app.command()
def run(
    scenario: ScenarioFile,
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    out: OutDir = None,
    duration: Duration = None,
    clear_trip: Annotated[
        bool, typer.Option("--clear-trip", help="Clear a trip that an earlier run left latched at the pump node.")
    ] = False,
    config: ConfigDir = None,
    rerun: RerunChoice = True,
    report: ReportChoice = True,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="SCHED_FIFO, memory locked, no live table; what is refused is said.")
    ] = False,
    priority: Annotated[Optional[int], typer.Option(metavar="1..99", help="Of SCHED_FIFO. Default: 80.")] = None,
    cpu: Annotated[Optional[int], typer.Option(metavar="N", help="Stay on this processor. Default: any.")] = None,
) -> None:
    """Run a scenario in real time on a CAN bus: the rig's, or the emulator's (firmware-sim). Moves pumps."""
    from hil.edge.host.realtime import wish

    wanted = wish(realtime, priority, cpu)  # before numpy is loaded: it may be told to start no threads
    from hil.bench import assembly, live_run, run_options
    from hil.cli import run_display
    from hil.edge.can.bus import BusAddress

    bench = assembly.load(scenario, config)
    bus = bench.rig.bus
    address = BusAddress(interface or bus.interface, channel or bus.channel, bitrate or bus.bitrate)
    folder = out or run_options.default_folder(bench.scenario.scenario.name, datetime.now())
    options = run_options.RunOptions(folder, duration_s=duration, rerun=rerun, clear_trip=clear_trip, realtime=wanted)
    console = Console()
    with run_display.live_status(console, with_table=not realtime) as watch:
        figures, outcome = live_run.run_live(bench, options, address, watch)
    run_display.finish(console, folder, figures, with_report=report)
    raise typer.Exit(SIGNAL_EXIT_CODES.get(outcome.reason.partition(";")[0], EXIT_CODES[outcome.status]))


@app.command()
def doctor(
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    seconds: Annotated[
        float, typer.Option("--seconds", metavar="S", min=1.0, max=600.0, help="How long to listen first.")
    ] = 5.0,
    with_pumps: WithPumps = False,
    config: ConfigDir = None,
) -> None:
    """Check bus, nodes, sensors, watchdog and host before a run: what was found, what to do. Moves no pump unasked."""
    from hil.cli import doctor_command as examination
    from hil.probe.bus_probe import InterruptedByUserError

    options = examination.DoctorOptions(interface, channel, bitrate, seconds, with_pumps, config)
    try:
        raise typer.Exit(examination.run(Console(), options))
    except InterruptedByUserError as error:
        raise typer.Exit(_interrupted(str(error))) from None


@app.command()
def conformance(
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    node: Annotated[Node, typer.Option("--node", help="Which node to test.")] = Node.BOTH,
    with_pumps: WithPumps = False,
    power_cycle: Annotated[
        float,
        typer.Option(
            "--power-cycle", metavar="S", min=0.0, max=600.0, help="Wait S seconds for a power cycle by hand."
        ),
    ] = 0.0,
    json_file: Annotated[
        Optional[Path],
        typer.Option("--json", metavar="FILE", help="Write the results there, too; refused if it exists."),
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
        raise typer.Exit(_interrupted(str(error))) from None


@app.command()
def campaign(
    spec: Annotated[
        Path, typer.Argument(metavar="DIR|SPEC.toml", help="A campaign file, a scenario, or a folder of scenarios.")
    ],
    seeds: Annotated[Optional[int], typer.Option(min=1, help="Seeds a case. Default: the file's, else 10.")] = None,
    first_seed: Annotated[Optional[int], typer.Option(min=0, help="Default: the file's, else 1.")] = None,
    out: Annotated[
        Optional[Path],
        typer.Option("--out", metavar="DIR", help="Its folder; runs that are in it are not made again."),
    ] = None,
    duration: Duration = None,
    config: ConfigDir = None,
    processes: Annotated[Optional[int], typer.Option(min=1, help="Default: one a core; 1 needs no Dask.")] = None,
    scheduler: Annotated[
        Optional[str], typer.Option(metavar="ADDRESS", help="A Dask cluster's scheduler: tcp://host:8786.")
    ] = None,
    report: ReportChoice = True,
) -> None:
    """Run scenarios times faults times seeds over all cores; table of outcomes, report. 3: an invariant was broken."""
    from hil.bench.campaign_run import CampaignOptions
    from hil.cli import campaign_command as campaigns

    options = CampaignOptions(out, config, seeds, first_seed, duration or None, processes, scheduler, report)
    raise typer.Exit(campaigns.run(Console(), spec, options))


@app.command()
def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the runs.")] = Path("runs"),
    config: ConfigDir = None,
) -> None:
    """Run the paper's experiment: its table 3 beside the paper's, and its fault once more with nobody to tell of it."""
    from hil.cli import demo_command as demonstration

    demonstration.run(Console(), out, config)


@app.command()
def design(
    config: ConfigDir = None,
    out: Annotated[
        Optional[Path],
        typer.Option("--out", metavar="DIR", help="Write step responses and the sigma plot there."),
    ] = None,
) -> None:
    """Show both designs: gains, poles, zeros, RGA, noise gain, and what one pump's loss does to them."""
    from hil.cli import design_command as designs

    designs.run(Console(), config, out)


@app.command()
def view(folder: Annotated[Path, typer.Argument(metavar="DIR", help="A run folder.")]) -> None:
    """Open a run's recording in the Rerun viewer."""
    from hil.edge.record.run_folder import RunFolder
    from hil.review.view import view as open_viewer

    open_viewer(RunFolder.open(folder))


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A run folder.")],
    compare: Annotated[
        Optional[Path],
        typer.Option("--compare", metavar="DIR", help="A second run to lay beside it."),
    ] = None,
) -> None:
    """Write a run's key figures and report.html anew, beside another run's if wanted."""
    from hil.edge.record.run_folder import RunFolder, RunFolderError
    from hil.review import kpi
    from hil.review.run_report import write_report

    first = RunFolder.open(folder)
    second = RunFolder.open(compare) if compare else None
    try:
        for one in (first, second):
            if one is not None:
                kpi.compute(one)
        typer.echo(write_report(first, second))
    except (OSError, UnicodeDecodeError) as error:
        raise RunFolderError(f"no report of {folder} can be made: {error}") from None
