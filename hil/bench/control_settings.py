"""What the control channel of a run tells its clients at first, and where it listens."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from math import isfinite

from hil.bench.assembly import Bench
from hil.bench.run_options import RunOptions
from hil.core.controller import ControllerConfig
from hil.core.interlocks import BYPASSABLE
from hil.core.types import Event, Severity
from hil.edge.control.control_channel import ControlChannel
from hil.edge.control.socket_path import ControlError, RunningRun, ServerSettings, place_of
from hil.edge.record.run_folder import RunFolder


def open_channel(
    channel: ControlChannel, bench: Bench, config: ControllerConfig, folder: RunFolder, options: RunOptions
) -> tuple[Event, ...]:
    """Open it. Where it can't be opened, a run goes on without it and says so.

    Raises ControlError when the user has named the path.
    """
    try:
        channel.open(control_settings(bench, config, folder, options), config)
    except ControlError as error:
        if options.control is not None:
            raise
        return (Event(Severity.WARNING, "control_lost", f"{error}; stop the run by Ctrl-C or SIGTERM"),)
    return ()


def control_settings(bench: Bench, config: ControllerConfig, folder: RunFolder, options: RunOptions) -> ServerSettings:
    """Of this run. Raises ControlError for a path that can't be."""
    limits, pid, path = config.limits, os.getpid(), folder.path.absolute()
    model, name = limits.model, bench.scenario.scenario.name
    place = place_of(path, options.control, pid)
    hello: dict[str, object] = {
        "folder": str(path),
        "scenario": name,
        "pid": pid,
        "duration_s": config.duration_s if isfinite(config.duration_s) else None,
        "period_s": config.loop.period_s,
        "rig": {
            "level_max_cm": limits.level_max_cm,
            "height_cm": model.height_cm,
            "level_gain_V_cm": model.level_gain_V_cm,
            "range_V": limits.range_V,
            "area_cm2": model.area_cm2,
            "valve_split": model.valve_split,
        },
        "bypassable": sorted(str(cause) for cause in BYPASSABLE),
        "bypass_max_s": limits.bypass_max_s,
        "attended_s": limits.attended_s,
    }
    run = RunningRun(pid, str(path), str(place), name, datetime.now(UTC).isoformat(timespec="seconds"))
    return ServerSettings(place, run, hello, config.loop.period_s)
