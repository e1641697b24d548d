"""Command firmware-sim: serve the emulated rig on a CAN bus, a TCP port or a pseudo-terminal, or export its plant.

Exit codes: 0 after SIGTERM, SIGINT or SIGHUP, and after an export; 1 if the service or the export failed; 2 for bad
input. Errors are one line on stderr. One line on stdout says that the rig is ready and where, with --control a second
one where it accepts commands; then come the answers to commands on standard input.
"""

import errno
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from firmware_sim.change_record import ChangeRecord
    from firmware_sim.command_server import CommandServer
    from firmware_sim.ports import Port
    from firmware_sim.rig import Rig

BAD_INPUT = 2
FAILED = 1

HELP = """
Example: firmware-sim --slcan 29536 --scenario paper

Emulate the four-tank rig in real time: pump node, level node and tanks. Give one of --slcan, --pty and -i. While it
runs, it reads commands such as "failure pump off -i 1" on standard input; "failure help" lists them.

With --fmu it writes the plant for other simulators instead, and ends: firmware-sim --fmu rig.fmu --rig johansson_minus
"""

app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


class UsageError(ValueError):
    """The command line asks for something that can't be done."""


def _list_faults(is_wanted: bool) -> None:
    if is_wanted:
        from firmware_sim.faults.catalogue import as_text

        sys.stdout.write(as_text())
        raise typer.Exit


def _show_version(is_wanted: bool) -> None:
    if is_wanted:
        from importlib.metadata import version

        sys.stdout.write(f"firmware-sim {version('fourtank-hil')}\n")
        raise typer.Exit


RigChoice = Annotated[
    str | None,
    typer.Option(help="Be this rig: a rig file, or the name of a shipped one. Default: the rig of emulator.toml."),
]
ControlPlace = Annotated[
    str | None, typer.Option(metavar="PATH|PORT", help="Accept failure commands here too: Unix socket or TCP port.")
]
FmuFile = Annotated[
    Path | None,
    typer.Option(metavar="FILE.fmu", help="Write the plant, with faults as inputs, as an FMI 2.0 co-simulation unit."),
]
FaultList = Annotated[
    bool, typer.Option("--faults", is_eager=True, callback=_list_faults, help="List the fault kinds and exit.")
]
VersionChoice = Annotated[
    bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version and exit.")
]


@app.command(help=HELP)
def serve(
    slcan: Annotated[int | None, typer.Option(min=0, max=65535, help="TCP port on 127.0.0.1; 0: a free one.")] = None,
    pty: Annotated[bool, typer.Option("--pty", help="Serve slcan on a pseudo-terminal.")] = False,
    interface: Annotated[str | None, typer.Option("-i", "--interface", help="python-can interface.")] = None,
    channel: Annotated[str | None, typer.Option("-c", "--channel", help="Channel of the interface.")] = None,
    bitrate: Annotated[int | None, typer.Option("-b", "--bitrate", min=1, help="Bit rate in bit/s.")] = None,
    scenario: Annotated[str | None, typer.Option(help="Scenario: a file, or the name of a shipped one.")] = None,
    rig: RigChoice = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the sensor noise and of drawn parameters.")] = 0,
    record: Annotated[Path | None, typer.Option(help="New file for state and voltage changes (JSON lines).")] = None,
    control: ControlPlace = None,
    fmu: FmuFile = None,
    config: Annotated[Path | None, typer.Option(help="Directory with bench.dbc and emulator.toml.")] = None,
    faults: FaultList = False,
    version: VersionChoice = False,
) -> None:
    """Emulate the four-tank rig: pump node, level node and tanks, in real time."""
    del faults, version
    from firmware_sim.rig import Rig
    from firmware_sim.rig_file import find_rig
    from firmware_sim.settings import default_config_dir, load, load_fingerprint

    if fmu is None:
        _check_transport(slcan, pty, interface, channel, bitrate)
    elif slcan is not None or pty or interface or channel or bitrate or record or control:
        raise UsageError("--fmu serves nothing: leave out --slcan, --pty, -i, -c, -b, --record and --control")
    folder = config if config is not None else default_config_dir()
    rig_file = None if rig is None else find_rig(rig, folder, default_config_dir())
    settings, scheduled = load(folder / "emulator.toml", _scenario_file(folder, scenario), rig_file)
    if fmu is not None:
        from firmware_sim.fmu.export import export

        sys.stdout.write(export(fmu, settings, scheduled, seed))
        return
    fingerprint = load_fingerprint(folder / "bench.dbc")
    observer = None if record is None else _change_record(record)
    emulated = Rig(settings, scheduled, seed, fingerprint, observer)
    commands = _command_server(emulated, control)
    try:
        if interface is not None:
            _serve_bus(emulated, commands, interface, channel, bitrate)
        else:
            _serve_slcan(emulated, commands, slcan)
    finally:
        commands.close()
        if observer is not None:
            observer.close()


def _check_transport(
    slcan: int | None, pty: bool, interface: str | None, channel: str | None, bitrate: int | None
) -> None:
    if (slcan is not None) + pty + (interface is not None) != 1:
        raise UsageError("give exactly one of --slcan, --pty and -i, or --fmu")
    if interface is None and (channel is not None or bitrate is not None):
        raise UsageError("-c and -b belong to -i")
    if interface is not None and channel is None:
        raise UsageError(f"-i {interface} needs a channel, -c")


def _change_record(path: Path) -> "ChangeRecord":
    from firmware_sim.change_record import ChangeRecord

    try:
        return ChangeRecord(path)
    except OSError as error:
        raise UsageError(f"--record {path}: {error.strerror}") from None


def _scenario_file(folder: Path, scenario: str | None) -> Path | None:
    if scenario is None:
        return None
    named = folder / "scenarios" / f"{scenario}.toml"
    if Path(scenario).exists() or not named.parent.is_dir() or Path(scenario).name != scenario or "." in scenario:
        return Path(scenario)
    if not named.is_file():
        shipped = ", ".join(sorted(file.stem for file in named.parent.glob("*.toml")))
        raise UsageError(f"--scenario {scenario}: no such file, and no shipped name; shipped scenarios: {shipped}")
    return named


def _why_no_port(error: OSError | OverflowError) -> str:
    """Why nothing can be served there, and what to do."""
    if getattr(error, "errno", None) == errno.EADDRINUSE:
        return "another program uses it, perhaps an earlier firmware-sim: end that one, or choose another"
    return getattr(error, "strerror", None) or str(error)


def _command_server(rig: "Rig", where: str | None) -> "CommandServer":
    from firmware_sim.command_server import CommandServer, listen_unix
    from firmware_sim.links import listen

    if where is None:
        return CommandServer(rig, with_stdin=True)
    try:
        listener = listen(int(where)) if where.isdecimal() else listen_unix(Path(where))
    except (OSError, OverflowError) as error:
        raise UsageError(f"--control {where}: {_why_no_port(error)}") from None
    return CommandServer(rig, listener, with_stdin=True)


def _serve_slcan(rig: "Rig", commands: "CommandServer", tcp_port: int | None) -> None:
    from firmware_sim.links import listen
    from firmware_sim.ports import PtyPort, TcpPort

    if tcp_port is None:
        pty_port = PtyPort(rig)
        _run(rig, commands, pty_port, f"slcan on {pty_port.path}")
        return
    try:
        listener = listen(tcp_port)
    except OSError as error:
        raise UsageError(f"--slcan {tcp_port}: {_why_no_port(error)}") from None
    address = f"socket://127.0.0.1:{listener.getsockname()[1]}"
    _run(rig, commands, TcpPort(rig, listener), f"slcan on {address}")


def _serve_bus(rig: "Rig", commands: "CommandServer", interface: str, channel: str | None, bitrate: int | None) -> None:
    import can

    from firmware_sim.kernel_port import InterfacePort, is_there
    from firmware_sim.ports import BUS_ERRORS, BusPort

    is_kernel = interface == "socketcan"
    if is_kernel and not _has_socketcan():
        raise UsageError("-i socketcan: this system has no SocketCAN (AF_CAN sockets)")
    if is_kernel and not is_there(str(channel)):
        raise UsageError(f"-i socketcan -c {channel}: there is no such interface")
    options: dict[str, Any] = {} if bitrate is None else {"bitrate": bitrate}

    def open_bus() -> can.BusABC:
        return can.Bus(channel, interface, ignore_config=True, **options)

    try:
        bus = open_bus()
    except (NotImplementedError, TypeError, ImportError, *BUS_ERRORS) as error:
        what = " ".join(str(error).split()) or type(error).__name__
        raise UsageError(f"-i {interface} -c {channel}: cannot open the bus: {what}") from None
    with bus:
        port = InterfacePort(rig, bus, lambda: is_there(str(channel)), open_bus) if is_kernel else BusPort(rig, bus)
        _run(rig, commands, port, f"{interface} on {channel}")


def _has_socketcan() -> bool:
    import socket

    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except AttributeError:
        return False
    except OSError as error:
        return error.errno != errno.EAFNOSUPPORT
    return True


def _run(rig: "Rig", commands: "CommandServer", port: "Port", where: str) -> None:
    import signal

    from firmware_sim.serve import Service

    service = Service(rig, port, commands=commands)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda _number, _frame: service.stop())
    sys.stdout.write(f"firmware-sim ready: {where}\n")
    if commands.address is not None:
        sys.stdout.write(f"firmware-sim control: {commands.address}\n")
    sys.stdout.flush()
    service.serve()


def main() -> None:
    """Run the command and turn its errors into one line and an exit code."""
    try:
        code = app(standalone_mode=False)
    except (typer.Exit, typer.Abort, KeyboardInterrupt):
        code = FAILED
    except typer.TyperException as error:
        code = _complain(_wording(error), BAD_INPUT)
    except ValueError as error:
        code = _complain(str(error), BAD_INPUT)
    except (OSError, RuntimeError) as error:
        code = _complain(str(error), FAILED)
    sys.exit(code if isinstance(code, int) else 0)


def _wording(error: typer.TyperException) -> str:
    """What is wrong on the command line; of a number: the value, and what it may be."""
    formatted = getattr(error, "format_message", None)
    message = str(formatted()) if callable(formatted) else str(error)
    option, errors = getattr(error, "param", None), getattr(error.__cause__, "errors", None)
    low, high = getattr(option, "min", None), getattr(option, "max", None)
    if low is None or errors is None:
        return message
    given = errors(include_url=False)[0]["input"]
    limits = f"{low} or more" if high is None else f"{low} to {high}"
    return f"{message.rpartition(': ')[0]}: {given}: must be a whole number, {limits}"


def _complain(what: str, code: int) -> int:
    sys.stderr.write(f"firmware-sim: {' '.join(what.split())}\n")
    return code
