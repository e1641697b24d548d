"""What `hil view` does: which recording, at which moment, in a window or as a page."""

from __future__ import annotations

import signal
from contextlib import suppress
from functools import partial
from pathlib import Path

import typer

from hil.bench.run_options import LivePicture
from hil.cli.complaint import warn
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review import viewer
from hil.review.moment import moment_s
from hil.review.viewer import Opening

IDENTIFICATION = "identification.rrd"


def open_view(folder: Path, at: str | None, *, is_page: bool | None) -> None:
    """Open the folder's recording. is_page : None: a page where there is no screen.

    Raises RunFolderError, NoViewerError and UnknownMomentError, with messages for the user.
    """
    path, opening = _opening(folder, at)
    if is_page or (is_page is None and not viewer.has_screen()):
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.default_int_handler)  # each ends the server, too
        with suppress(KeyboardInterrupt):
            viewer.serve_page(path, opening, partial(_say, opening.at_s))
        return
    if not viewer.has_screen():
        raise viewer.NoViewerError(
            f"there is no screen here for the Rerun viewer; --web serves a page; {opening.instead}"
        )
    if not viewer.open_window(path, opening):
        warn(f"the viewer did not take the time: move its cursor to {opening.at_s:g} s")


def live_choice(*, live: bool, is_page: bool, is_recorded: bool) -> LivePicture | None:
    """How a run is shown while it goes on. Raises NoViewerError where it is not recorded for the viewer."""
    if not live and not is_page:
        return None
    if not is_recorded:
        raise viewer.NoViewerError("--live shows the recording for the viewer; leave --no-rerun out")
    return "page" if is_page or not viewer.has_screen() else "window"


def _opening(folder: Path, at: str | None) -> tuple[Path, Opening]:
    recording = folder / IDENTIFICATION
    if recording.is_file():
        if at is not None:
            raise RunFolderError(f"--at {at}: {folder} is an identification, which has no moments; leave --at out")
        return recording, Opening(instead=f"the report is at {folder / 'report.html'}")
    run = RunFolder.open(folder)
    path, instead = viewer.recording_of(run), viewer.instead_of(run)
    if at is None:
        return path, Opening(instead=instead)
    at_s = moment_s(run, at)
    return path, Opening(at_s, partial(_write_layout, run, at_s), instead)


def _write_layout(run: RunFolder, at_s: float, path: Path) -> None:
    from hil.edge.record.rerun_log import APPLICATION
    from hil.review.blueprint import blueprint

    plan = run.manifest().plan
    blueprint(plan.mode, None, plan.shown, has_picture=True, at_s=at_s).save(APPLICATION, str(path))


def _say(at_s: float | None, address: str) -> None:
    typer.echo(f"{address}\nOpen this address in a browser on this machine. Ctrl-C ends it.")
    if at_s is not None:
        typer.echo(f"The plots open around {at_s:g} s. To move the time cursor there, type {at_s:g}s into its field.")
