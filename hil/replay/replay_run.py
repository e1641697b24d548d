"""A replay from files to its result; nothing here touches the terminal."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from math import inf, isnan, nan
from pathlib import Path

from hil.core.counted import counted
from hil.core.reference_path import TIME_TOLERANCE_S
from hil.core.types import Pair
from hil.edge.record.run_folder import RunFolder
from hil.replay.alarm_difference import alarm_difference, findings_until
from hil.replay.command_difference import CommandComparison, compare_commands
from hil.replay.folder_steps import read_folder_steps
from hil.replay.frame_log import ReplayError
from hil.replay.log_steps import read_log_steps, with_late_start
from hil.replay.open_loop import OnProgress, Replayed, count_of_command, play
from hil.replay.recorded_bench import RecordedController, WhatIf, named_controller, recorded_controller
from hil.replay.recorded_steps import NOTHING, RecordedSteps
from hil.replay.reference_file import ReplayReference, read_reference, reference_path, write_reference
from hil.review.alarms import Finding
from hil.review.ticks import parse_events
from hil.wire.contract import Contract

AS_RECORDED = WhatIf()


LOG_TOLERANCE_V = 0.05
"""Of a log, whose steps are not known to the microsecond: a control period that is 0.3 ms longer moves the command."""


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """Options of a replay.

    tolerance_V : of voltages; None: one count on the wire, and for a log LOG_TOLERANCE_V. scenario, config_dir : of a
    log, which has no settings; its rig is that of `what_if`. duration_s : of a log, in place of the scenario's.
    update : make a new reference.
    """

    what_if: WhatIf = AS_RECORDED
    tolerance_V: float | None = None
    scenario: str | Path | None = None
    config_dir: Path | None = None
    duration_s: float | None = None
    update: bool = False


@dataclass(frozen=True, eq=False)
class ReplayResult:
    """What a replay found.

    expected : what today's payloads are compared with: those of the record, or of its reference. comparison : None for
    a what-if, of which no verdict is given. recorded_alarms : of the record or its reference; None for a log, which has
    none. alarm_difference : in words; "" for none. reference_version : of the program that made the reference; "" if
    there is none. doubts : what the record does not say exactly.
    """

    where: Path
    what_if: WhatIf
    recorded: RecordedSteps
    replayed: Replayed
    expected: tuple[bytes, ...]
    comparison: CommandComparison | None
    recorded_alarms: tuple[Finding, ...] | None
    replayed_alarms: tuple[Finding, ...]
    alarm_difference: str
    reference_version: str
    doubts: tuple[str, ...]
    contract: Contract

    @property
    def is_same(self) -> bool:
        """Whether today's controller does what was recorded. A what-if has no verdict."""
        return self.comparison is None or (self.comparison.first is None and not self.alarm_difference)

    @property
    def columns(self) -> tuple[str, str]:
        """What stands beside each other, in words."""
        before = "not in a log" if self.recorded_alarms is None else "recorded"
        return "reference" if self.reference_version else before, "what if" if self.comparison is None else "today"

    @property
    def step_s(self) -> list[float]:
        """Run time of each step; NaN outside of control."""
        times = zip(self.recorded.steps, self.replayed.step_s, strict=True)
        return [again_s if isnan(step.t_s) else step.t_s for step, again_s in times]

    def volts(self, payload: bytes) -> Pair:
        """(2,) the voltages of a command; NaN for none."""
        values = self.contract.frames["PumpCommand"].decode(payload) if payload else None
        return (nan, nan) if values is None else (values["Command1"], values["Command2"])

    @property
    def summary(self) -> tuple[str, ...]:
        """The result in a few lines."""
        done = self.comparison
        if done is None:
            return (f"what if: {self.what_if}; there is no verdict on the commands",)
        what = (
            f"as in the reference (made by hil {self.reference_version})" if self.reference_version else "as recorded"
        )
        lines = [f"same commands {what}: {counted(done.compared, 'command')}"]
        if done.first is not None:
            lines = [
                f"first difference: {done.first}",
                f"{done.differing} of {counted(done.compared, 'command')} not {what}, by up to {done.largest_V:.4g} V",
            ]
        elif done.rounded:
            rounded = counted(done.rounded, "command")
            lines.append(f"{rounded} differ within the tolerance, by up to {done.largest_V:.2g} V")
        if self.alarm_difference:
            lines.append(f"alarms differ: {self.alarm_difference}")
        return tuple(lines)


def replay(path: Path, options: ReplayOptions, on_progress: OnProgress | None = None) -> ReplayResult:
    """Replay a run folder or a log. on_progress : see `play`. Raises ReplayError, RunFolderError, SettingsError."""
    is_log = not path.is_dir()
    what_if = replace(options.what_if, rig=None) if options.scenario is not None else options.what_if
    if options.update and what_if:
        raise ReplayError(f"{path}: --update is of what was recorded, not of a what-if ({what_if})")
    with _controller(path, options) as controller:
        contract = controller.bench.contract
        if is_log:
            recorded = read_log_steps(path, contract, controller.config.loop.period_s)
        else:
            recorded = read_folder_steps(RunFolder.open(path), contract.frames["PumpCommand"].frame_id)
        old = None if options.update or what_if else read_reference(reference_path(path), contract, len(recorded.steps))
        expected = _payloads(recorded) if old is None else old.payloads
        tolerance_V = LOG_TOLERANCE_V if is_log and old is None else count_of_command(contract)
        tolerance_V = tolerance_V if options.tolerance_V is None else options.tolerance_V
        replayed, comparison = _compared(controller, recorded, expected, tolerance_V, on_progress)
        if is_log and comparison.first is not None:
            later = with_late_start(recorded, contract)
            other = _compared(controller, later, expected, tolerance_V, on_progress)
            if other[1].differing < comparison.differing:
                (replayed, comparison), recorded = other, later
    today = findings_until(parse_events(replayed.event_text, "the replay"), inf)
    before = _recorded_alarms(recorded, old)
    result = ReplayResult(
        where=path,
        what_if=what_if,
        recorded=recorded,
        replayed=replayed,
        expected=expected,
        comparison=None if what_if else comparison,
        recorded_alarms=before,
        replayed_alarms=today,
        alarm_difference=""
        if what_if or before is None
        else alarm_difference(before, today, controller.config.loop.period_s),
        reference_version="" if old is None else old.version,
        doubts=(*controller.doubts, *recorded.doubts),
        contract=contract,
    )
    if options.update:
        write_reference(reference_path(path), contract, replayed.payloads, today)
    return result


def _compared(
    controller: RecordedController,
    recorded: RecordedSteps,
    expected: tuple[bytes, ...],
    tolerance_V: float,
    on_progress: OnProgress | None,
) -> tuple[Replayed, CommandComparison]:
    """What today's controller does, and how it differs."""
    done = play(
        recorded, controller.bench, controller.config, clear_trip=controller.clear_trip, on_progress=on_progress
    )
    return done, compare_commands(controller.bench.contract, recorded.steps, expected, done, tolerance_V)


def _payloads(recorded: RecordedSteps) -> tuple[bytes, ...]:
    return tuple(b"" if step.command == NOTHING else recorded.log.payload(step.command) for step in recorded.steps)


def _recorded_alarms(recorded: RecordedSteps, reference: ReplayReference | None) -> tuple[Finding, ...] | None:
    """Those of the reference, or of the record as far as its steps are replayed."""
    if reference is not None:
        return reference.alarms
    if recorded.events is None:
        return None
    end_s = max((step.t_s for step in recorded.steps if step.is_in_control), default=inf)
    return findings_until(recorded.events, end_s + TIME_TOLERANCE_S)


def _controller(path: Path, options: ReplayOptions) -> AbstractContextManager[RecordedController]:
    """By the settings of the run folder, of the one that a log lies in, or of the scenario that was named."""
    if options.scenario is not None:
        if path.is_dir():
            raise ReplayError(f"{path}: a run folder has its own scenario: --scenario is for a log")
        return nullcontext(named_controller(options.scenario, options.config_dir, options.what_if, options.duration_s))
    if options.duration_s is not None:
        raise ReplayError(f"{path}: --duration is for a log whose scenario is named with --scenario")
    if not path.exists():
        raise ReplayError(f"{path}: there is no such run folder or log")
    folder = path if path.is_dir() else path.parent
    if not path.is_dir() and not (folder / "run.json").is_file():
        raise ReplayError(
            f"{path}: a log has no settings: name the scenario that ran with --scenario, and its rig with --rig"
        )
    return recorded_controller(RunFolder.open(folder), options.what_if)
