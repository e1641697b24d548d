"""The picture of docs/how-to/export.md: `python -m tools.export_picture`. Needs a Vulkan driver, and the extra `mcap`.

Exports a run of the scenario `leak` to MCAP, and opens the file in Rerun, which knows the format but nothing of this
project: control steps, decoded signals and events, plotted by their names.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from hil.bench import assembly
from hil.bench.lockstep_run import simulate
from hil.bench.run_options import RunOptions
from hil.export.formats import export_run
from tools.screenshot import screenshot

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "export-mcap.png"
APPLICATION = "leak"
SEED, LENGTH_S = 7, 400
SIZE = "1600x900"
COLORS = ((76, 153, 230), (240, 150, 60), (110, 190, 110), (220, 90, 90))


def main() -> int:
    """Run, export, convert by Rerun's own command, open, and take the picture."""
    with TemporaryDirectory() as made:
        folder = Path(made) / "leak"
        simulate(assembly.load(Path("leak")), RunOptions(folder, seed=SEED, rerun=False))
        exported, layout = export_run(folder, "mcap"), Path(made) / "layout.rbl"
        recording = exported.with_suffix(".rrd")
        command = [sys.executable, "-m", "rerun_cli", "mcap", "convert", str(exported), "-o", str(recording)]
        subprocess.run([*command, "--application-id", APPLICATION], check=True)
        blueprint().save(APPLICATION, str(layout))
        screenshot(recording, PICTURE, size=SIZE, layout=layout)
    return 0


def blueprint() -> rrb.Blueprint:
    """Levels and commands of the control steps, levels as they were on the bus, and the events."""
    steps = plot("Levels of the lower tanks, estimated [V]", "/ticks", "Ticks", {"h1_est_V": 0, "h2_est_V": 1})
    commands = plot("Commands of the pumps [V]", "/ticks", "Ticks", {"v1_V": 0, "v2_V": 1})
    bus = plot("The same levels in the frames of the bus [V]", "/signals/LowerLevels", "LowerLevels",
               {"Level1": 0, "Level2": 1})  # fmt: skip
    upper = plot("The upper tanks [V]", "/signals/UpperLevels", "UpperLevels", {"Level3": 2, "Level4": 3})
    events = rrb.TextLogView(origin="/log", name="Events: /log")
    left, right = rrb.Vertical(steps, bus), rrb.Vertical(commands, upper, events)
    return rrb.Blueprint(
        rrb.Horizontal(left, right),
        rrb.TimePanel(state="hidden", timeline="message_log_time"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def plot(title: str, topic: str, message: str, fields: Mapping[str, int]) -> rrb.TimeSeriesView:
    """Fields of a topic's messages as lines. fields : name -> number of the color."""
    source = f"fourtank.{message}:message"
    lines = []
    for name, color in fields.items():
        where = VisualizerComponentMapping(
            "Scalars:scalars", ComponentSourceKind.SourceComponent, source_component=source, selector=f".{name}"
        )
        lines.append(rr.SeriesLines(names=f"{topic} {name}", colors=COLORS[color]).visualizer(mappings=[where]))
    whole = rrb.TimeAxis(view_range=rr.TimeRange(start=rr.TimeInt(seconds=0), end=rr.TimeInt(seconds=LENGTH_S)))
    corner = rrb.Corner2D.LeftBottom
    return rrb.TimeSeriesView(origin=topic, name=title, overrides={topic: lines}, plot_legend=corner, axis_x=whole)


if __name__ == "__main__":
    sys.exit(main())
