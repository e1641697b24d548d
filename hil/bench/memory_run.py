"""One run in lockstep whose record stays in memory: for scripts that need no run folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from firmware_sim.ports import BusPort as EmulatorPort
from hil import lockstep
from hil.bench.assembly import Bench, controller_config, make_loop
from hil.bench.emulator_twin import emulator_of
from hil.bench.results import RunResult
from hil.bench.run_options import check_length
from hil.bench.run_plan import run_plan
from hil.bench.run_record import RunRecord
from hil.core.types import Event, Quad, TickRecord
from hil.edge.can.bus import BusPort
from hil.edge.can.pair_bus import pair
from hil.edge.record.manifest import Manifest, Status, versions
from hil.edge.record.record_format import TickFormat, event_line
from hil.edge.record.signals import UNKNOWN_LEVELS, Step, recorded
from hil.review.kpi import evaluate, with_parameters
from hil.review.ticks import parse_events, parse_ticks

WHERE = "the record in memory"


class MemoryRecorder:
    """Keeps ticks and events as the text that the run folder's files would have, so that both give the same figures.

    Frames are not kept.
    """

    def __init__(self, shown: Sequence[str] = ()) -> None:
        self._format = TickFormat(recorded("lockstep", shown))
        self.ticks = [self._format.header]
        self.events: list[str] = []
        self.ending: tuple[Status, str, float | None] = ("running", "", None)

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None) -> None:
        """Keep one step and its events."""
        step = Step(record, UNKNOWN_LEVELS if true_level_cm is None else true_level_cm)
        self.ticks.append(self._format.line(self._format.row(step)))
        for event in record.events:
            self.event(record.t_s, event)

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        """Frames are not kept."""

    def message(self, timestamp_s: float, message: Any) -> None:
        """Frames are not kept."""

    def event(self, t_s: float, event: Event) -> None:
        """Keep one event."""
        self.events.append(event_line(t_s, event))

    def close(self, status: Status, reason: str, *, speed_x: float | None = None) -> None:
        """Keep how the run ended."""
        self.ending = (status, reason, speed_x)


def simulate_in_memory(
    bench: Bench, *, seed: int, duration_s: float | None, on_progress: Callable[[int], None] | None = None
) -> RunResult:
    """One run in lockstep with the emulator. Raises SettingsError."""
    check_length(bench, duration_s)
    config = controller_config(bench, duration_s)
    emulator = emulator_of(bench, seed)
    recorder = MemoryRecorder(bench.shown)
    manifest = Manifest(run_plan(bench, is_live=False, seed=seed), "running", "", _now(), None, versions())
    with ExitStack() as stack:
        ours, theirs = (stack.enter_context(end) for end in pair())
        port = BusPort(ours)
        record = stack.enter_context(RunRecord(recorder, port))
        loop = make_loop(bench, config, port, recorder, true_level_cm=lambda: emulator.levels_cm)
        record.outcome = lockstep.run(loop, port, EmulatorPort(emulator, theirs), config.loop.period_s, on_progress)
    status, reason, speed_x = recorder.ending
    manifest = replace(
        manifest,
        status=status,
        reason=reason,
        ended_utc=_now(),
        speed_x=speed_x,
        recorder={"errors": [], "dropped": 0},
    )
    ticks = parse_ticks("".join(recorder.ticks), WHERE)
    events = parse_events("".join(recorder.events), WHERE)
    figures = with_parameters(evaluate(manifest, ticks, events), manifest, ticks, events)
    return RunResult(figures, ticks.columns, events, manifest)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
