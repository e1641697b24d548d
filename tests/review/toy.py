"""A toy closed loop: seeded, plausible tick records and frames for the tests of what records and reviews them."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from random import Random
from typing import Any

from hil.core.types import Alarm, Event, Mode, Pair, Quad, Severity, TickRecord
from hil.edge.record.manifest import RunMode, RunPlan, Window
from hil.edge.record.recorder import Recorder
from hil.edge.record.rerun_log import RerunLog, RunCard
from hil.edge.record.run_folder import RunFolder
from hil.review.blueprint import blueprint
from tests.narrowing import pair, quad

GAIN_V_CM = 0.5
SCENARIO = """[scenario]
name = "toy"

[[fault]]
at_s = 200.0
kind = "pump_effectiveness"
target = 1
value = 0.4

[[fault]]
at_s = 200.0
kind = "pump_effectiveness"
target = 2
value = 0.4
"""
SETTINGS = {
    "rig": {"sensors": {"gain_V_cm": GAIN_V_CM}, "tanks": {"height_cm": 20.0}, "pumps": {"range_V": [0.0, 10.0]}},
    "scenario": tomllib.loads(SCENARIO),
}
WINDOWS = (Window("gain_fall", 200.0, 350.0), Window("reference_step", 350.0, 500.0))
EQUILIBRIUM_V: Quad = (6.1, 6.4, 0.82, 0.70)


def plan(*, reconfigure: bool = True, windows: tuple[Window, ...] = WINDOWS, mode: RunMode = "lockstep") -> RunPlan:
    return RunPlan(
        scenario="toy",
        mode=mode,
        seed=1,
        period_s=0.1,
        windows=windows,
        reconfigure=reconfigure,
        settings=SETTINGS,
        copies={"rig.toml": "[sensors]\ngain_V_cm = 0.5 # <b>&\n", "scenario.toml": SCENARIO},
    )


def steps(
    *, reconfigure: bool = True, until_s: float = 500.0, period_s: float = 0.1, seed: int = 1
) -> Iterator[tuple[TickRecord, Quad]]:
    """Tick records and true levels in cm: reference steps at 100 and 350 s, both pumps at 40 % from 200 s."""
    random = Random(seed)  # noqa: S311
    level = list(EQUILIBRIUM_V)
    iae = [0.0, 0.0]
    applied: Pair = (3.0, 3.0)
    for index in range(round(until_s / period_s)):
        t_s = index * period_s
        faulty, told = t_s >= 200.0, t_s >= 201.0 and reconfigure
        rise = 0.3146394 * ((t_s >= 100.0) + (t_s >= 350.0))
        reference = (EQUILIBRIUM_V[0] + rise, EQUILIBRIUM_V[1] + rise)
        settle_s = 12.0 if not faulty or told else 45.0
        hold = (3.0 + 0.45 * rise, 3.0 + 0.4 * rise)
        error = [reference[i] - level[i] for i in (0, 1)]
        theta = 0.4 if faulty else 1.0
        known = (0.4, 0.4) if told else (1.0, 1.0)
        wanted = pair((hold[i] + 1.6 * error[i] + random.gauss(0, 0.01)) / known[i] for i in (0, 1))
        if faulty and not reconfigure:
            wanted = pair(v + 4.5 * (1 - math.exp(-(t_s - 200.0) / 35.0)) for v in wanted)
        command = (min(10.0, max(0.0, wanted[0])), min(10.0, max(0.0, wanted[1])))
        sag = 0.03 if faulty and not told else 0.0
        for i in (0, 1):
            iae[i] += abs(error[i]) * period_s
            fade = math.exp(-(t_s - 200.0) / 30.0) if faulty else 1.0
            level[i] += period_s * (error[i] / settle_s - sag * fade)
        level[2] = EQUILIBRIUM_V[2] + 0.2 * (applied[1] * theta - 3.0) * 0.5
        level[3] = EQUILIBRIUM_V[3] + 0.2 * (applied[0] * theta - 3.0) * 0.5
        truth: Quad = (level[0], level[1], max(0.0, level[2]), max(0.0, level[3]))
        measured = quad(v + random.gauss(0, 0.005) for v in truth)
        estimate = quad(v + random.gauss(0, 0.001) for v in truth)
        record = TickRecord(
            t_s=t_s,
            mode=Mode.DEGRADED if told else Mode.RUNNING,
            measured_V=measured,
            estimated_V=estimate,
            reference_V=reference,
            target_V=reference,
            operating_V=(hold[0] / known[0], hold[1] / known[1]),
            raw_V=wanted,
            command_V=command,
            applied_V=applied,
            effectiveness=known,
            integral_Vs=(2.0 + iae[0] / 9, 2.0 + iae[1] / 9),
            gain=tuple((1.9 - 0.31 * k) / known[k // 6] for k in range(12)),
            iae_Vs=(iae[0], iae[1]),
            levels_age_s=0.004 + abs(random.gauss(0, 0.002)),
            status_age_s=0.02 + abs(random.gauss(0, 0.01)),
            lateness_s=abs(random.gauss(0, 0.0001)) + (0.004 if index % 700 == 699 else 0.0),
            skipped=0,
            accepted=13 * index,
            rejected=index // 1500,
            events=tuple(events_at(t_s, index, reconfigure)),
        )
        applied = command
        yield record, quad(v / GAIN_V_CM for v in truth)


def at(record: TickRecord, monotonic_ns: int) -> TickRecord:
    """The same step at another time of the monotonic clock."""
    return record._replace(monotonic_ns=monotonic_ns)


def events_at(t_s: float, index: int, reconfigure: bool) -> Iterator[Event]:
    if index == 0:
        yield Event(Severity.INFO, "running", "control on <now> & steady")
    if abs(t_s - 201.0) < 1e-6 and reconfigure:
        for pump in (1, 2):
            name = f"pump_effectiveness {pump}"
            alarm = Alarm(t_s, "pump_effectiveness", pump, 0.4, 0.02, 200.1, t_s, (name,), number=pump)
            yield Event(Severity.WARNING, "alarm", f"pump {pump} has 40 % of its gain left", asdict(alarm))


def frames(t_s: float, index: int) -> Iterator[tuple[float, int, bytes, bool]]:
    """Fifteen frames of a step: one command out, level, status and heartbeat frames in."""
    yield t_s, 0x100, bytes((index & 255, 1, 2, 3, 4, 5, 6, 7)), False
    for number in range(14):
        yield t_s + 0.006 * number, 0x110 + number, bytes((number, index & 255, 0, 0, 0, 0, 0, 9)), True


def record_run(path: Path, *, with_rerun: bool = False, live: bool = False, **options: Any) -> RunFolder:
    """A whole toy run in a new folder."""
    reconfigure = bool(options.get("reconfigure", True))
    mode: RunMode = "live" if live else "lockstep"
    folder = RunFolder.create(path, plan(reconfigure=reconfigure, mode=mode))
    timeline = None
    if with_rerun:
        card = RunCard(path.name, {"scenario": "toy", "seed": "1"}, "# Toy run\n\nseed 1")
        timeline = RerunLog(
            folder.rrd_path, card, level_gain_V_cm=GAIN_V_CM, mode=mode, blueprint=blueprint(mode, 500.0)
        )
    recorder = Recorder.open(folder, timeline=timeline)
    for index, (record, truth) in enumerate(steps(**options)):
        for frame in frames(record.t_s, index):
            recorder.frame(*frame)
        recorder.tick(record, None if live else truth)
    recorder.close("complete", "the scenario's end was reached", speed_x=412.0)
    return folder
