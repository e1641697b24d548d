"""How a run is made, whatever the scenario says."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from itertools import count
from math import isfinite
from pathlib import Path
from typing import Literal

from hil.bench.assembly import Bench
from hil.bench.open_record import TimelineSettings
from hil.core.controller import ControllerConfig
from hil.edge.config.rig_file import Rig
from hil.edge.config.settings_file import SettingsError
from hil.edge.host.realtime import RealTime
from hil.edge.record.picture_model import PictureModel

LivePicture = Literal["window", "page"]


@dataclass(frozen=True)
class RunOptions:
    """How to run, whatever the scenario says.

    seed : of the emulator's noise. rerun : whether to write run.rrd. realtime : what to request of the system, live.
    live : the run is served to viewers while it goes on; in a window, or as a page. None: it is not.
    control : where a live run listens; None: in its folder. attended_s : see `hil.core.attendance`.
    """

    out: Path
    seed: int = 1
    duration_s: float | None = None
    rerun: bool = True
    clear_trip: bool = False
    realtime: RealTime | None = None
    live: LivePicture | None = None
    control: Path | None = None
    attended_s: float = 0.0


def check_length(bench: Bench, duration_s: float | None) -> None:
    """A run on a simulated clock needs an end. Raises SettingsError."""
    if duration_s is None and not isfinite(bench.scenario.scenario.length_s):
        raise SettingsError(
            f"{bench.scenario_path}: scenario.duration_s = 'open': only `hil run` can be ended by hand; "
            "give a length (--duration, duration_s)"
        )


def default_folder(name: str, now: datetime) -> Path:
    """runs/<time>_<name>, below the current directory; a second one in the same second ends in _2, and so on."""
    path = first = Path("runs") / f"{now:%Y%m%d-%H%M%S}_{name}"
    for number in count(2):
        if not path.exists():
            break
        path = first.with_name(f"{first.name}_{number}")
    return path


def timeline_settings(bench: Bench, config: ControllerConfig, options: RunOptions) -> TimelineSettings | None:
    """What run.rrd needs, if it is wanted."""
    return timeline_of(bench.rig, config.duration_s) if options.rerun else None


def timeline_of(rig: Rig, duration_s: float) -> TimelineSettings:
    """What run.rrd needs of a rig."""
    picture = PictureModel(rig.tank_model, rig.pump_path, rig.safety.level_max_cm)
    return TimelineSettings(rig.tank_model.level_gain_V_cm, duration_s, picture)
