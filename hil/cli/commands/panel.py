"""`hil panel`: watch a run and give it requests, in the terminal or in a browser."""

from __future__ import annotations

import os
import shlex
import signal
import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from hil.cli.options import PanelEmulator

EXAMPLE = "hil panel"


def panel(
    run: Annotated[
        Optional[Path], typer.Argument(metavar="RUN", help="Folder of the run. Default: the only run that goes on.")
    ] = None,
    socket: Annotated[
        Optional[Path],
        typer.Option("--socket", metavar="PATH", help="Socket of a run that was started with --control."),
    ] = None,
    emulator: PanelEmulator = None,
    web: Annotated[bool, typer.Option("--web", help="Serve the panel in a browser, on 127.0.0.1 only.")] = False,
    port: Annotated[int, typer.Option(metavar="N", min=1, max=65535, help="With --web: TCP port.")] = 8024,
) -> None:
    """Watch a run and send it requests: references, manual voltages, stop. The run does not depend on the panel."""
    from hil.panel.run_search import check_choice, run_finder

    check_choice(run, socket)
    if web:
        _serve(run, socket, emulator, port)
        return
    from hil.cli.beside_panel import BESIDE, check_terminal

    if "TEXTUAL_DRIVER" not in os.environ:  # textual-serve has set it
        check_terminal()
    signal.signal(
        signal.SIGHUP, signal.SIG_DFL
    )  # a run that ignores it has started us: a closed terminal ends the panel
    from hil.panel.emulator_client import EmulatorClient
    from hil.panel.panel_app import PanelApp

    find = run_finder(run, socket)
    app = PanelApp(
        find,
        emulator=None if emulator is None else EmulatorClient(emulator),
        parent=os.getppid() if BESIDE in os.environ else None,
    )
    app.run()
    raise typer.Exit(app.return_code or 0)


def _serve(run: Path | None, socket: Path | None, emulator: str | None, port: int) -> None:
    """Serve until Ctrl-C. Raises PanelError."""
    from hil.panel.panel_error import PanelError

    try:
        from hil.panel.web_server import PanelServer
    except ImportError:
        raise PanelError("hil panel --web needs textual-serve: pip install 'fourtank-hil[web]'") from None

    words = [sys.executable, "-m", "hil", "panel"]
    words += [] if run is None else [str(run.absolute())]
    words += [] if socket is None else ["--socket", str(socket.absolute())]
    words += (
        [] if emulator is None else ["--emulator", emulator if emulator.isdecimal() else str(Path(emulator).absolute())]
    )
    try:
        PanelServer(shlex.join(words), port, lambda address: typer.echo(f"panel: {address}")).serve()
    except OSError as error:
        raise PanelError(
            f"--port {port}: {error.strerror}; another program uses it, or a panel: choose another"
        ) from None
