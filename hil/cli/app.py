"""`hil`: the table of commands. Bad input ends with one line and exit code 2, before anything moves."""

from __future__ import annotations

import os
import shutil
import sys
from inspect import getdoc
from types import ModuleType
from typing import Annotated

import typer

from hil.cli import exit_codes
from hil.cli.commands import (
    benchmark,
    calibrate,
    campaign,
    compare,
    conformance,
    ctl,
    demo,
    design,
    doctor,
    export,
    identify,
    panel,
    replay,
    report,
    run,
    runs,
    simulate,
    test,
    tune,
    view,
)
from hil.cli.complaint import complain
from hil.edge.host.standard_output import GuardedOutput
from hil.version import __version__

COMMANDS: tuple[ModuleType, ...] = (
    simulate,
    run,
    ctl,
    panel,
    doctor,
    calibrate,
    identify,
    conformance,
    campaign,
    benchmark,
    demo,
    design,
    tune,
    view,
    report,
    runs,
    compare,
    replay,
    export,
    test,
)
"""In the order of the help. Each has a function of its own name, and EXAMPLE."""

MIN_RICH_WIDTH = 80
"""Below, the help is plain text: the boxes' columns would be too narrow for long values, and cut them off."""

app = typer.Typer(
    name="hil",
    help=(
        "Example: hil simulate paper\n\n"
        "Fault-tolerant control of the four-tank laboratory process over CAN. "
        "`hil COMMAND --help` explains a command."
    ),
    epilog=(
        "Exit codes: 0 done; 2 bad input or no record possible, nothing moved; 3 tripped; 4 not ready or failed; "
        "ctl: 4 also refused, or no run; "
        "5 done, but record or output incomplete, or identify --check: beyond the limit; "
        "6 test: a limit is not kept; replay: other commands than recorded; "
        "129, 130 and 143 stopped by a signal."
    ),
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)


def _add(module: ModuleType) -> None:
    """The module's function as a command, its example at the head of its help."""
    name = module.__name__.rpartition(".")[2]
    function = getattr(module, name)
    text = getdoc(function) or ""
    summary = text.partition("\n\n")[0]
    app.command(
        name,
        help=f"Example: {module.EXAMPLE}\n\n{text}",
        short_help=" ".join(summary.split()),
        cls=getattr(module, "COMMAND", None),
        context_settings=getattr(module, "CONTEXT", None),
    )(function)


for _module in COMMANDS:
    _add(_module)


def main() -> None:
    """Entry point of the console script: turns errors the user can fix into one line."""
    output = GuardedOutput.install()
    try:
        code = _command()
    finally:
        if output is not None:
            output.flush()
            output.remove()
    if code == 0 and output is not None and output.error is not None:
        code = complain(f"standard output: {output.error.strerror}", exit_codes.INCOMPLETE)
    sys.exit(code)


def _width() -> int:
    """Columns of the terminal, or what COLUMNS or TERMINAL_WIDTH sets in their place."""
    forced = os.environ.get("TERMINAL_WIDTH", "")
    return int(forced) if forced.isdecimal() else shutil.get_terminal_size().columns


def _command() -> int:
    """Run the command and return the exit code. An error that the user can fix is one line on standard error."""
    app.rich_markup_mode = "rich" if _width() >= MIN_RICH_WIDTH else None
    try:
        code = app(standalone_mode=False, prog_name="hil", terminal_width=min(_width(), MIN_RICH_WIDTH) - 2)
    except typer.TyperException as error:  # a wrong option or argument
        return complain(_wrong_option(error), exit_codes.BAD_INPUT)
    except (typer.Abort, KeyboardInterrupt):
        return complain("interrupted", exit_codes.BY_SIGNAL["SIGINT"])
    except Exception as error:
        from hil.bench.user_errors import USER_ERRORS  # only now: it brings in all that can raise them

        if isinstance(error, USER_ERRORS):
            return complain(str(error), _exit_code(error))
        if isinstance(error, OSError) and error.filename is not None:  # a file that the system does not let us have
            return complain(f"{os.fsdecode(error.filename)}: {error.strerror or error}", exit_codes.NOT_DONE)
        raise
    return code if isinstance(code, int) else 0


def _wrong_option(error: typer.TyperException) -> str:
    """The message, with the value and the range of an option that has one."""
    message = str(getattr(error, "format_message", error.__str__)())
    option, cause = getattr(error, "param", None), error.__cause__
    low, high = getattr(option, "min", None), getattr(option, "max", None)
    if not isinstance(cause, ValueError) or not hasattr(cause, "errors") or (low is None and high is None):
        return message
    value = cause.errors(include_url=False)[0]["input"]
    allowed = " and ".join(
        word
        for word in ("" if low is None else f"at least {low:.10g}", "" if high is None else f"at most {high:.10g}")
        if word
    )
    return f"{message.rpartition(': ')[0]}: {value}: must be a number, {allowed}"


def _exit_code(error: Exception) -> int:
    from hil.edge.record.record_errors import IncompleteRecordError

    if isinstance(error, IncompleteRecordError):
        return exit_codes.of_run(error.status, error.reason, is_incomplete=True)
    return exit_codes.BAD_INPUT


def _version(value: bool) -> None:
    if value:
        typer.echo(f"hil {__version__}")
        raise typer.Exit


@app.callback()
def _about(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    del version
