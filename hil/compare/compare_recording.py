"""A recording of several runs for the Rerun viewer: one entity tree for each, in a layout that compares them.

    /<run>/levels/tank1 ...   the run's own series, as in its run.rrd
    /<run>/states/..., log    its mode, pump health and events
    /<run>/overlaid/output1   what is laid over the other runs, in the run's colour

Times are on the common axis: 0 is the moment at which the runs are aligned.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from hil.compare.compared_run import ComparedRun, CompareError
from hil.core.types import Mode
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.rerun_log import APPLICATION, TIMELINE, series, time_column
from hil.edge.record.run_states import STATES, pump_state
from hil.edge.record.signals import AMBER, BLUE, GREEN, GREY, ORANGE, PURPLE
from hil.review.blueprint import PLOT_BACKGROUND, PLOTS, LinkedBlueprint, linked_axis
from hil.review.kpi import level_gain, output_levels

OVERLAID = {
    "output1": "Output 1 [V]",
    "output2": "Output 2 [V]",
    "pump1": "Pump 1 command [V]",
    "pump2": "Pump 2 command [V]",
    "effectiveness1": "Pump 1 effectiveness [1]",
    "effectiveness2": "Pump 2 effectiveness [1]",
    "level3": "Tank 3, estimated level [V]",
    "level4": "Tank 4, estimated level [V]",
}
COLUMNS = {
    **{f"pump{pump}": f"v{pump}_V" for pump in (1, 2)},
    **{f"effectiveness{pump}": f"theta{pump}" for pump in (1, 2)},
    **{f"level{tank}": f"h{tank}_est_V" for tank in (3, 4)},
}
BESIDE = ("levels/tank1", "levels/tank2", "pumps/pump1", "pumps/pump2", "pumps/effectiveness")
COLORS = (BLUE, ORANGE, GREEN, PURPLE, AMBER, 0x4FC3C7FF, 0xE57FA8FF, GREY)
"""Of the runs, in their order, for a dark background; after the last they come again."""

WIDTH = 1.6
CORNER = rrb.PlotLegend(corner=rrb.Corner2D.RightBottom)


def write_recording(path: Path, runs: Sequence[ComparedRun]) -> None:
    """Write the recording. Raises CompareError when no run has a step, or the file can't be written."""
    drawn = [run for run in runs if len(run.ticks)]
    if not drawn:
        raise CompareError(f"{path}: no run has a control step, so there is nothing to record")
    trees = tree_names([run.name for run in drawn])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("wb").close()  # Rerun itself says nothing of a file that it can't write
    except OSError as error:
        raise CompareError(f"{path} can't be written: {error.strerror}") from None
    recording = rr.RecordingStream(APPLICATION, recording_id="comparison-" + "-".join(trees))
    recording.save(path, default_blueprint=layout(drawn, trees))
    for place, (run, tree) in enumerate(zip(drawn, trees, strict=True)):
        _log_series(recording, run, tree)
        _log_states(recording, run, tree)
        _log_overlaid(recording, run, tree, place)
    recording.flush(timeout_sec=30.0)
    recording.disconnect()


def tree_names(names: Sequence[str]) -> list[str]:
    """Names of entity trees: letters, digits, `_` and `-` alone, each different."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_-]+", "_", name) or "run"
        number, one = 2, plain
        while one in found:
            one, number = f"{plain}_{number}", number + 1
        found.append(one)
    return found


def layout(runs: Sequence[ComparedRun], trees: Sequence[str]) -> rrb.Blueprint:
    """Tabs: the runs over each other, side by side, and the log and states of each. All plots share one time range."""
    begin_s = min(float(run.times_s[0]) for run in runs)
    end_s = max(float(run.times_s[-1]) for run in runs)
    start, end = (rr.TimeRangeBoundary.absolute(seconds=at_s) for at_s in (begin_s, end_s))
    axis = linked_axis(rr.TimeRange(start=start, end=end))

    def plot(contents: list[str], name: str, range_: tuple[float, float] | None = None) -> rrb.TimeSeriesView:
        scale = None if range_ is None else rrb.ScalarAxis(range=range_)
        return rrb.TimeSeriesView(
            origin="/",
            contents=contents,
            name=name,
            axis_x=axis,
            axis_y=scale,
            background=PLOT_BACKGROUND,
            plot_legend=CORNER,
        )

    over = [plot([f"/{tree}/overlaid/{name}" for tree in trees], title) for name, title in OVERLAID.items()]
    pairs = [rrb.Horizontal(*over[at : at + 2]) for at in range(0, len(over), 2)]
    beside = [
        rrb.Vertical(
            *(plot([f"/{tree}/{entity}"], f"{tree}: {PLOTS[entity].title}", PLOTS[entity].range_) for entity in BESIDE),
            name=tree,
        )
        for tree in trees
    ]
    logs = [
        rrb.Horizontal(
            rrb.StateTimelineView(
                origin=f"/{tree}/states", contents=[f"/{tree}/states/**"], name=f"{tree}: states", time_view=axis
            ),
            rrb.TextLogView(origin=f"/{tree}/log", name=f"{tree}: log"),
        )
        for tree in trees
    ]
    return LinkedBlueprint(
        axis,
        rrb.Tabs(
            rrb.Vertical(*pairs, name="Over each other"),
            rrb.Horizontal(*beside, name="Side by side"),
            rrb.Vertical(*logs, name="States and log"),
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        auto_views=False,
    )


def _log_series(recording: rr.RecordingStream, run: ComparedRun, tree: str) -> None:
    """The run's own series, those of an older record as far as it has them."""
    plan = run.manifest.plan
    to_V = _level_gain(run)
    times = time_column(run.times_s)
    for one in series(plan.mode, plan.shown):
        signals = [signal for signal in one.signals if signal.column in run.ticks.columns]
        if not signals:
            continue
        curves = [signal.curve for signal in signals if signal.curve]
        look = rr.SeriesLines(
            names=[signal.curve_name for signal in signals],
            colors=np.array([curve.color for curve in curves], dtype=np.uint32),
            widths=[curve.width for curve in curves],
        )
        recording.log(f"{tree}/{one.entity}", look, static=True)
        values = np.column_stack([run.ticks[signal.column] * (to_V if signal.is_in_cm else 1.0) for signal in signals])
        recording.send_columns(f"{tree}/{one.entity}", [times], rr.Scalars.columns(scalars=values))


def _log_states(recording: rr.RecordingStream, run: ComparedRun, tree: str) -> None:
    """Mode, health of the pumps, and the log."""
    modes = [Mode(int(mode)).name for mode in run.ticks["mode"]]
    pumps = [[pump_state(share) for share in run.ticks.get(f"theta{pump}").tolist()] for pump in (1, 2)]
    for entity, states in zip(("states/mode", "states/pump1", "states/pump2"), (modes, *pumps), strict=True):
        values, labels, colors = STATES[entity]
        style = rr.StateConfiguration(values=values, labels=labels, colors=np.array(colors, dtype=np.uint32))
        recording.log(f"{tree}/{entity}", style, static=True)
        at = list(_changes(states))
        times = time_column(run.times_s[at])
        recording.send_columns(f"{tree}/{entity}", [times], rr.StateChange.columns(state=[states[i] for i in at]))
    if run.events:
        times = time_column(np.array([event.t_s - run.zero_s for event in run.events]))
        texts = [f"{event.code}: {event.text}" for event in run.events]
        levels = [event.severity for event in run.events]
        recording.send_columns(f"{tree}/log", [times], rr.TextLog.columns(text=texts, level=levels))


def _changes(states: Sequence[str]) -> Iterator[int]:
    """Places at which a state differs from the one before; the first, too."""
    return (at for at, state in enumerate(states) if at == 0 or states[at - 1] != state)


def _log_overlaid(recording: rr.RecordingStream, run: ComparedRun, tree: str, place: int) -> None:
    color = COLORS[place % len(COLORS)]
    times = time_column(run.times_s)
    try:
        outputs_V = output_levels(run.ticks, _level_gain(run))
        curves = {f"output{output}": outputs_V[:, output - 1] for output in (1, 2)}
    except KeyError:
        curves = {}
    curves |= {name: run.ticks.get(column) for name, column in COLUMNS.items()}
    for name, values in curves.items():
        look = rr.SeriesLines(names=[tree], colors=np.array([color], dtype=np.uint32), widths=[WIDTH])
        recording.log(f"{tree}/overlaid/{name}", look, static=True)
        recording.send_columns(f"{tree}/overlaid/{name}", [times], rr.Scalars.columns(scalars=values))


def _level_gain(run: ComparedRun) -> float:
    try:
        return level_gain(run.manifest.plan.settings)
    except RunFolderError:
        return float("nan")
