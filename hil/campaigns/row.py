"""The row that a run leaves in the table of outcomes."""

from __future__ import annotations

import time
from dataclasses import dataclass

CRASHED = "crashed"
INVARIANTS = ("overflow", "dry_run", "applied_out_of_range", "rate_broken", "latch_broken", "not_at_rest", "crashed")


@dataclass(frozen=True, slots=True)
class Elapsed:
    """Time that a run needs: by the clock, and of the processor, which other programs don't lengthen."""

    wall_s: float
    cpu_s: float

    @classmethod
    def since(cls, started: Elapsed) -> Elapsed:
        """From `started`, as `now` gave it."""
        now = cls.now()
        return cls(now.wall_s - started.wall_s, now.cpu_s - started.cpu_s)

    @classmethod
    def now(cls) -> Elapsed:
        """Both clocks."""
        return cls(time.perf_counter(), time.process_time())


@dataclass(frozen=True)
class Row:
    """One run. None: not known, or does not apply. JSON columns end in _json.

    detected : some alarm names a fault that was played; delays count from the first onset, the isolation's to the last
    fault named. candidates_hold : the fault was among the candidates of its first alarm. right : all faults are named
    as they are, and nothing else. not_played : how many faults had not begun when the run ended; they are not judged,
    and where none was played, detected and what follows from it is None. size_error_* : of a pump's effectiveness, 1
    and 5 s after its isolation. declared : all that was named after the onset, each once.
    repeated_alarms : later ones that name a growing or intermittent fault again. drawn_json : what [draw] drew.
    honest_alarms : on a drawn rig that the rig file doesn't know, alarms that say what its pumps really give; they are
    neither false nor spurious. unknowns, unknown_s, unknown_long : see `told.unknown_figures`. questions : of the false
    and the spurious, those that were withdrawn before they had a name: open questions. windows_json : figures of the
    scenario's windows, see `control_figures`. held : all faults are named as they are, or are among the candidates of
    an alarm that is still open, and nothing else is named.
    grown_s, named_s : of growing faults, see `growing`.
    alarm_* : how much the run asks an operator to look at, see `hil.review.alarm_load`.
    hours : of control, with a start phase. healthy_h : those before the first fault of the process.
    spilled_cm3 : what went over a rim.
    overflow to crashed : the invariants, true where broken; broken : in words. wall_s, cpu_s : elapsed time, and
    processor time, which other programs don't lengthen.
    """

    key: str
    label: str
    scenario: str
    seed: int
    faults_json: str
    kind: str
    target: str
    value: float | None
    onset_s: float | None
    detected: bool | None
    detection_s: float | None
    isolation_s: float | None
    bound_s: float | None
    declared: str
    candidates_hold: bool | None
    right: bool | None
    not_played: int
    size_error_1s: float | None
    size_error_5s: float | None
    flips: int
    false_alarms: int
    spurious_alarms: int
    alarms_json: str
    hours: float
    healthy_h: float
    iae_1_Vs: float
    iae_2_Vs: float
    iae_after_fault_1_Vs: float | None
    iae_after_fault_2_Vs: float | None
    iae_windows_json: str
    level_max_cm: float | None
    spilled_cm3: float
    applied_max_V: float | None
    overflow: bool
    dry_run: bool
    applied_out_of_range: bool
    rate_broken: bool
    latch_broken: bool
    not_at_rest: bool
    crashed: bool
    broken: str
    trip_cause: str
    trip_s: float | None
    commands_lost: int
    frames_lost: int
    status: str
    reason: str
    steps: int
    wall_s: float
    cpu_s: float
    repeated_alarms: int = 0
    held: bool | None = None
    grown_s: float | None = None
    named_s: float | None = None
    drawn_json: str = "{}"
    honest_alarms: int = 0
    questions: int = 0
    unknowns: int = 0
    unknown_s: float = 0.0
    unknown_long: int = 0
    windows_json: str = "{}"
    alarm_count: int = 0
    alarm_peak_10_min: int = 0
    alarm_floods: int = 0
    alarm_chattering: int = 0

    @property
    def breaks(self) -> tuple[str, ...]:
        """Names of the invariants that the run broke."""
        return tuple(name for name in INVARIANTS if getattr(self, name))
