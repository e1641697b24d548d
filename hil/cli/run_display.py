"""What the commands show on the terminal: progress, a live status table, the results of a run."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from hil.bench.assembly import Bench
from hil.bench.run_record import check_complete, incomplete
from hil.core.controller import Output
from hil.core.counted import counted
from hil.core.types import Inputs, Mode
from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder
from hil.review.kpi import Kpi

REFRESH_S = 0.25


@contextmanager
def progress(console: Console, bench: Bench, duration_s: float | None = None) -> Iterator[Callable[[int], None]]:
    """A bar over the run's time; yields what to call with the number of steps made."""
    period_s = bench.rig.control.period_s
    total_s = bench.scenario.scenario.length_s if duration_s is None else duration_s
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s, {task.fields[speed]:.0f} times real time"),
        TimeRemainingColumn(),
    )
    started = time.perf_counter()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(bench.scenario.scenario.name, total=total_s, speed=0.0)

        def advance(steps: int) -> None:
            simulated_s = min(steps * period_s, total_s)
            bar.update(task, completed=simulated_s, speed=simulated_s / (time.perf_counter() - started))

        yield advance


class LiveStatus:
    """A table that follows the run on a terminal; events and changes of mode as lines anywhere.

    `watch` only stores the step; a thread of its own draws, so that a blocked terminal does not delay the loop.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._lines: deque[str] = deque(maxlen=1000)
        self._latest: tuple[Inputs, Output, Mode] | None = None
        self._mode: Mode | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="display", daemon=True)

    def __enter__(self) -> LiveStatus:
        """Start to draw."""
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        """Draw what is left; the display gives up on a blocked terminal."""
        self._stop.set()
        self._thread.join(timeout=1.0)

    def watch(self, inputs: Inputs, output: Output, mode: Mode) -> None:
        """Store a step, to be drawn by the thread."""
        self._lines.extend(f"{e.severity.value:5} {e.text}" for e in output.events if e.code != "mode")
        if mode is not self._mode:
            self._mode = mode
            self._lines.append(f"      {mode.name}")
        self._latest = (inputs, output, mode)

    def _work(self) -> None:
        with Live(console=self._console, auto_refresh=False, transient=True) as live:
            while not self._stop.wait(REFRESH_S):
                self._draw(live)
            self._draw(live)

    def _draw(self, live: Live) -> None:
        while self._lines:
            self._console.print(self._lines.popleft(), highlight=False, markup=False)
        if self._console.is_terminal and self._latest is not None:
            live.update(status_table(*self._latest), refresh=True)


@contextmanager
def live_status(console: Console, *, with_table: bool) -> Iterator[Callable[[Inputs, Output, Mode], None] | None]:
    """What to call at each step; None in real time, where no other thread may delay the loop's."""
    if not with_table:
        yield None
        return
    with LiveStatus(console) as status:
        yield status.watch


def status_table(inputs: Inputs, output: Output, mode: Mode) -> Table:
    """The bench at one step."""
    record = output.record
    title = mode.name if record is None else f"{mode.name}   {_run_time(record.t_s)}"
    table = Table(title=title, title_justify="left")
    for name in ("", "1", "2", "3", "4"):
        table.add_column(name, justify="right")
    table.add_row("level [V]", *(f"{y:.3f}" for y in inputs.measurement.level_V))
    if record is not None:
        table.add_row("reference [V]", *(f"{r:.3f}" for r in record.reference_V))
        table.add_row("effectiveness", *(f"{e:.2f}" for e in record.effectiveness))
        table.add_row("IAE so far [V s]", *(f"{i:.3f}" for i in record.iae_Vs))
        if record.probe_V != (0.0, 0.0):
            table.add_row("of it a probe [V]", *(f"{v:+.3f}" for v in record.probe_V))
    table.add_row("command [V]", *(f"{v:.3f}" for v in output.command.voltage_V))
    table.add_row("applied [V]", *(f"{v:.3f}" for v in inputs.pumps.applied_V))
    bus = inputs.bus
    table.caption = (
        f"frames {bus.accepted}, rejected {bus.rejected}, skipped steps {inputs.timing.skipped}, "
        f"late {inputs.timing.lateness_s * 1e3:.1f} ms, levels {inputs.measurement.age_s * 1e3:.0f} ms old"
    )
    return table


def _run_time(t_s: float) -> str:
    return f"start phase, {-t_s:.1f} s to time 0" if t_s < 0.0 else f"{t_s:.1f} s"


def finish(console: Console, folder: Path, figures: Kpi, *, with_report: bool) -> None:
    """The key figures, and where everything is. Raises IncompleteRecordError at the end when the record has gaps."""
    run = RunFolder(folder)
    if with_report:
        from hil.review.run_report import write_report

        try:
            write_report(run)
        except RunFolderError as error:  # a full disk, or the folder has just been removed; the run was made
            errors = [*figures.recorder.get("errors", ()), str(error)]
            raise incomplete(run, figures.status, figures.reason, errors) from None
    console.print(f"{figures.scenario}: {figures.status} ({figures.reason})", highlight=False)
    if figures.iae_Vs:
        table = Table()
        for name in ("window", "IAE 1 [V s]", "IAE 2 [V s]"):
            table.add_column(name, justify="left" if name == "window" else "right")
        for window, (first, second) in figures.iae_Vs.items():
            reached = figures.iae_covered_s[window] > 0.0
            table.add_row(window, *((f"{first:.3f}", f"{second:.3f}") if reached else ("not reached", "")))
        console.print(table)
    speed = "" if figures.speed_x is None else f", {figures.speed_x:.0f} times real time"
    console.print(
        f"{counted(figures.ticks, 'step')}, {figures.skipped} skipped, {counted(len(figures.alarms), 'alarm')}, "
        f"{counted(len(figures.trips), 'trip')}{speed}",
        highlight=False,
    )
    files = [path for path in (run.report_path, run.rrd_path) if path.exists()]
    for path in [folder / "kpi.json", *files]:
        console.print(str(path), highlight=False, soft_wrap=True)
    check_complete(run, figures)
