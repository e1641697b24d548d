"""A replay from files to its result; nothing here touches the terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.edge.record.run_folder import RunFolder
from hil.replay.command_difference import CommandComparison, compare_commands, count_of_command
from hil.replay.folder_steps import read_folder_steps
from hil.replay.open_loop import Replayed, play
from hil.replay.recorded_bench import WhatIf, recorded_controller
from hil.replay.recorded_steps import NOTHING, RecordedSteps
from hil.review import alarms
from hil.review.alarms import Finding
from hil.review.ticks import LoggedEvent, parse_events

AS_RECORDED = WhatIf()


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """tolerance_V : of voltages; None: one count on the wire."""

    what_if: WhatIf = AS_RECORDED
    tolerance_V: float | None = None


@dataclass(frozen=True, eq=False)
class ReplayResult:
    """What a replay found.

    comparison : None for a what-if, of which no verdict is given. doubts : what the record does not say exactly.
    recorded_alarms : None for a log, which has none.
    """

    where: Path
    what_if: WhatIf
    recorded: RecordedSteps
    replayed: Replayed
    expected: tuple[bytes, ...]
    comparison: CommandComparison | None
    recorded_alarms: tuple[Finding, ...] | None
    replayed_alarms: tuple[Finding, ...]
    doubts: tuple[str, ...]

    @property
    def is_same(self) -> bool:
        """Whether today's controller does what was recorded."""
        return self.comparison is None or self.comparison.first is None


def replay(path: Path, options: ReplayOptions, on_progress: Callable[[int], None] | None = None) -> ReplayResult:
    """Replay a run folder. on_progress : see `play`. Raises ReplayError, RunFolderError, SettingsError."""
    folder = RunFolder.open(path)
    with recorded_controller(folder, options.what_if) as controller:
        bench = controller.bench
        recorded = read_folder_steps(folder, bench.contract.frames["PumpCommand"].frame_id)
        replayed = play(recorded, bench, controller.config, clear_trip=controller.clear_trip, on_progress=on_progress)
    expected = tuple(b"" if step.command == NOTHING else recorded.log.payload(step.command) for step in recorded.steps)
    comparison = None
    if not options.what_if:
        tolerance_V = count_of_command(bench.contract) if options.tolerance_V is None else options.tolerance_V
        comparison = compare_commands(bench.contract, recorded.steps, expected, replayed.payloads, tolerance_V)
    return ReplayResult(
        where=path,
        what_if=options.what_if,
        recorded=recorded,
        replayed=replayed,
        expected=expected,
        comparison=comparison,
        recorded_alarms=None if recorded.events is None else _findings(recorded.events),
        replayed_alarms=_findings(parse_events(replayed.event_text, "the replay")),
        doubts=(*controller.doubts, *recorded.doubts),
    )


def _findings(events: Sequence[LoggedEvent]) -> tuple[Finding, ...]:
    return alarms.merged(event.data for event in events if event.code == "alarm")
