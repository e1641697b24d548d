"""Opens the record of a run. Small to import: for a live run this happens in the recorder's own process."""

from __future__ import annotations

from dataclasses import dataclass

from hil.edge.recorder import Recorder
from hil.edge.run_folder import RunFolder


@dataclass(frozen=True, slots=True)
class TimelineSettings:
    """What the recording for the Rerun viewer has to know of the bench."""

    level_gain_V_cm: float
    duration_s: float
    with_truth: bool


def open_record(folder: RunFolder, timeline: TimelineSettings | None) -> Recorder:
    """The recorder into the folder's files; timeline : None without run.rrd. Raises RunFolderError."""
    if timeline is None:
        return Recorder.open(folder)
    from hil.edge.rerun_log import RerunLog, RunCard
    from hil.review.blueprint import blueprint

    manifest = folder.manifest()
    facts = {"scenario": manifest.plan.scenario, "mode": manifest.plan.mode, "started": manifest.started_utc}
    text = "\n".join(f"- **{name}**: {value}" for name, value in facts.items())
    card = RunCard(folder.path.name, facts, f"# {manifest.plan.scenario}\n\n{text}\n")
    log = RerunLog(
        folder.rrd_path,
        card,
        level_gain_V_cm=timeline.level_gain_V_cm,
        with_truth=timeline.with_truth,
        blueprint=blueprint(timeline.duration_s),
        batch_ticks=250 if timeline.with_truth else 1000,
        compact_at_close=not timeline.with_truth,
    )
    return Recorder.open(folder, timeline=log)
