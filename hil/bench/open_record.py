"""Opens the record of a run. Small to import: for a live run this happens in the recorder's own process."""

from __future__ import annotations

import os
import sys
import threading
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue

from hil.core.types import Event
from hil.edge.host.standard_output import GuardedOutput
from hil.edge.record.picture_model import PictureModel
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.recorder import Recorder, Timeline
from hil.edge.record.run_folder import RunFolder

MAX_WAITING_LINES = 1000
"""Lines."""


@dataclass(frozen=True, slots=True)
class TimelineSettings:
    """What the recording for the Rerun viewer has to know of the bench.

    picture : None: without one. live_port : where the run is served to viewers while it goes on; None: it is not.
    """

    level_gain_V_cm: float
    duration_s: float
    picture: PictureModel | None = None
    live_port: int | None = None


class EventLines:
    """Events as lines on the terminal, by a thread of their own: a terminal that blocks or fails delays nothing."""

    def __init__(self) -> None:
        self._lines: SimpleQueue[str] = SimpleQueue()
        threading.Thread(target=self._work, name="event lines", daemon=True).start()

    def put(self, event: Event) -> None:
        """Show one event; it is left out when `MAX_WAITING_LINES` wait already."""
        if self._lines.qsize() < MAX_WAITING_LINES:
            self._lines.put(f"{event.severity.value:5} {event.text}\n")

    def _work(self) -> None:
        output = GuardedOutput(sys.stdout)
        while output.error is None:
            output.write(self._lines.get())
            output.flush()


def open_record(folder: RunFolder, timeline: TimelineSettings | None, with_lines: bool = False) -> Recorder:
    """The recorder into the folder's files. Raises RunFolderError.

    timeline : None without run.rrd. with_lines : whether events are also shown on the terminal.
    """
    on_event = EventLines().put if with_lines else None
    if timeline is None:
        return Recorder.open(folder, on_event=on_event)
    os.environ.setdefault("RUST_LOG", "off")  # Rerun's messages; the end of the run says in one line what failed
    return Recorder.open(folder, timeline=_timeline(folder, timeline), on_event=on_event)


def _timeline(folder: RunFolder, settings: TimelineSettings) -> Timeline:
    """The recording as a file, and as it is served live. Raises RunFolderError."""
    from hil.edge.record.coarse_rows import coarseness
    from hil.edge.record.rerun_log import RerunLog, RunCard
    from hil.review.blueprint import blueprint, live_blueprint

    manifest = folder.manifest()
    mode, shown, is_live = manifest.plan.mode, manifest.plan.shown, manifest.plan.mode == "live"
    facts = {"scenario": manifest.plan.scenario, "mode": mode, "started": manifest.started_utc}
    text = "\n".join(f"- **{name}**: {value}" for name, value in facts.items())
    card = RunCard(folder.path.name, facts, f"# {manifest.plan.scenario}\n\n{text}\n")
    log = partial(
        RerunLog, card=card, level_gain_V_cm=settings.level_gain_V_cm, mode=mode, shown=shown, picture=settings.picture
    )
    has_picture = settings.picture is not None
    try:
        file = log(
            folder.rrd_path,
            blueprint=blueprint(mode, settings.duration_s, shown, has_picture=has_picture),
            batch_ticks=6000 if is_live else 250,
            coarser=coarseness(settings.duration_s, manifest.plan.period_s),
            compact_at_close=is_live,
        )
    except Exception as error:  # whatever the viewer's library raises for a file that it can't write
        cause = (isinstance(error, OSError) and error.strerror) or error
        raise RunFolderError(f"{folder.rrd_path} can't be written: {cause}") from error
    if settings.live_port is None:
        return file
    from hil.edge.record.live_log import LiveLog, server_on

    layout = live_blueprint(mode, shown, has_picture=has_picture)
    try:
        return LiveLog(file, partial(log, None, blueprint=layout, server=server_on(settings.live_port)))
    except Exception as error:  # whatever it is, no pump has moved yet
        file.close()
        raise RunFolderError(f"the run can't be served on port {settings.live_port}: {error}") from error
