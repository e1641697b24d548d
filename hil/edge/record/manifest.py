"""The content of a run folder's `run.json`: what was run, with copies of its configuration, and how it ended."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from typing import Any, Literal, get_args

from hil.edge.record.json_text import read_json
from hil.edge.record.manifest_check import wrong_field
from hil.edge.record.record_errors import RunFolderError
from hil.version import __version__

Status = Literal["running", "complete", "stopped", "tripped", "failed"]
RunMode = Literal["lockstep", "live"]

FORMAT = 2
"""Of run.json and the files beside it. 1: ticks.csv with empty cells, can.log in monotonic times with R or T."""
FORMATS_READ = (1, 2)
LIBRARIES = ("numpy", "python-can", "rerun-sdk")


@dataclass(frozen=True, slots=True)
class Window:
    """A stretch of the run over which the errors are summed up: [from_s, to_s] in run time."""

    name: str
    from_s: float
    to_s: float


@dataclass(frozen=True, slots=True)
class RunPlan:
    """What is known of a run before its first step.

    settings : the merged settings as JSON-ready values, `{"rig": {...}, "scenario": {...}, ...}`; the review reads
    `rig.sensors.gain_V_cm` from it. copies : file name -> full text of each configuration file that went in. shown :
    names of the numbers that the control law has recorded.
    """

    scenario: str
    mode: RunMode
    seed: int | None
    period_s: float
    windows: tuple[Window, ...] = ()
    reconfigure: bool = True
    settings: Mapping[str, Any] = field(default_factory=dict)
    copies: Mapping[str, str] = field(default_factory=dict)
    shown: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ClockOffsets:
    """How the times of a record belong together. All of them run alike; each has its own zero.

    monotonic_zero_epoch_s, run_zero_epoch_s : time since the epoch at which the monotonic clock, or the run time `t_s`,
    was 0. None: not known (format 1), or not yet (no step in control). In lockstep the monotonic clock is the simulated
    one, which starts at the epoch itself, so that the same seed gives the same bytes.
    """

    monotonic_zero_epoch_s: float | None = None
    run_zero_epoch_s: float | None = None

    @classmethod
    def of(cls, mode: RunMode) -> ClockOffsets:
        """The offsets of a run that is about to start. Taken once: a wall clock that is set later changes no record."""
        is_live = mode == "live"
        return cls(round((time.time_ns() - time.monotonic_ns()) * 1e-9, 6) if is_live else 0.0)

    def with_run_zero(self, monotonic_s: float) -> ClockOffsets:
        """The offsets with the run's time zero, given as monotonic time; not known where that clock's zero is not."""
        zero_s = self.monotonic_zero_epoch_s
        return replace(self, run_zero_epoch_s=None if zero_s is None else round(zero_s + monotonic_s, 6))


@dataclass(frozen=True, slots=True)
class Manifest:
    """The content of `run.json`. Times are ISO 8601 in UTC; `recorder` has the recorder's own failures, if any."""

    plan: RunPlan
    status: Status
    reason: str
    started_utc: str
    ended_utc: str | None
    versions: Mapping[str, str]
    speed_x: float | None = None
    recorder: Mapping[str, Any] = field(default_factory=dict)
    clock: ClockOffsets = ClockOffsets()

    @property
    def outcome(self) -> str:
        """The status as shown to users: a run whose end was not recorded was interrupted."""
        return "interrupted" if self.status == "running" else self.status

    def to_json(self) -> str:
        """As the text of `run.json`."""
        head = {"format": FORMAT, **asdict(self)}
        plan = head.pop("plan")
        return json.dumps({**head, **plan}, indent=2, ensure_ascii=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Manifest:
        """The manifest in a `run.json`; raises RunFolderError when it is not one."""
        try:
            raw = read_json(text)
            if not isinstance(raw, dict):
                raise RunFolderError("run.json is not a run's manifest: it is no table")
            if raw["format"] not in FORMATS_READ:
                read = " and ".join(str(number) for number in FORMATS_READ)
                raise RunFolderError(f"run.json has format {raw['format']}, this program reads {read}")
            if raw["status"] not in get_args(Status):
                raise RunFolderError(f"run.json has the unknown status {raw['status']!r}")
            if wrong := wrong_field(raw):
                raise RunFolderError(f"run.json is not a run's manifest: {wrong}")
            shown = tuple(raw.pop("shown", ()))  # a run folder of an earlier version has none
            plan = {name: raw.pop(name) for name in RunPlan.__dataclass_fields__ if name != "shown"}
            windows = tuple(Window(**window) for window in plan.pop("windows"))
            del raw["format"]
            clock = ClockOffsets(**raw.pop("clock", {}))
            return cls(plan=RunPlan(windows=windows, shown=shown, **plan), clock=clock, **raw)
        except KeyError as error:
            raise RunFolderError(f"run.json is not a run's manifest: it has no {error}") from error
        except (ValueError, TypeError, RecursionError) as error:
            raise RunFolderError(f"run.json is not a run's manifest: {error}") from error


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on: this program, Python and the libraries; nothing of the machine."""
    return {
        "hil": __version__,
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in LIBRARIES},
    }
