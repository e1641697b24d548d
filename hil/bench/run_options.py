"""How a run is made, whatever the scenario says; and the record that every run closes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Protocol

from hil.bench.assembly import Bench
from hil.bench.open_record import TimelineSettings
from hil.core.controller import ControllerConfig
from hil.core.types import Event, Severity
from hil.edge.can.bus import BusPort
from hil.edge.host.realtime import RealTime
from hil.edge.record.run_folder import Status
from hil.loop import Outcome, Recorder


@dataclass(frozen=True)
class RunOptions:
    """How to run, whatever the scenario says.

    seed : of the emulator's noise. rerun : whether to write run.rrd. realtime : what to ask of the system, live.
    """

    out: Path
    seed: int = 1
    duration_s: float | None = None
    rerun: bool = True
    clear_trip: bool = False
    realtime: RealTime | None = None


def default_folder(name: str, now: datetime) -> Path:
    """runs/<time>_<name>, below the current directory."""
    return Path("runs") / f"{now:%Y%m%d-%H%M%S}_{name}"


def timeline_settings(bench: Bench, config: ControllerConfig, options: RunOptions) -> TimelineSettings | None:
    """What run.rrd needs, if it is wanted."""
    return TimelineSettings(bench.rig.sensors.gain_V_cm, config.duration_s) if options.rerun else None


class ClosableRecorder(Recorder, Protocol):
    """A recorder of the loop that is closed at the end of the run."""

    def close(self, status: Status, reason: str, *, speed_x: float | None = None) -> None:
        """Finish the record and keep how the run ended. speed_x : scenario seconds per wall second."""


class RunRecord:
    """Closes a recorder whatever happens, with how the run ended and what became of its commands as the last event."""

    def __init__(self, recorder: ClosableRecorder, port: BusPort) -> None:
        self.recorder = recorder
        self._port = port
        self.outcome: Outcome | None = None
        self._started = time.perf_counter()

    def __enter__(self) -> RunRecord:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        wall_s = time.perf_counter() - self._started
        if kind is KeyboardInterrupt:
            self.recorder.close("stopped", "interrupted")
            return
        if self.outcome is None:
            self.recorder.close("failed", f"{kind.__name__}: {error}" if kind else "ended without an outcome")
            return
        outcome = self.outcome
        severity = Severity.INFO if outcome.status in ("complete", "stopped") else Severity.ERROR
        counts: dict[str, object] = {
            "commands_sent": outcome.commands_sent,
            "commands_lost": outcome.commands_lost,
            "frames_lost": outcome.frames_lost,
            **{f"line_{name}": number for name, number in self._port.line_counts.items()},
        }
        if self._port.bus_errors:
            counts["bus_errors"] = dict(self._port.bus_errors)
        self.recorder.event(outcome.t_s, Event(severity, "end", f"{outcome.status}: {outcome.reason}", counts))
        self.recorder.close(outcome.status, outcome.reason, speed_x=outcome.t_s / wall_s)
