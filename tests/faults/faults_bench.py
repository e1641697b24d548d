"""Helpers of the tests of faults: a run in lockstep through the wire, all of it kept, and what must hold in any run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import can
import pytest

from firmware_sim import settings as emulator_settings
from firmware_sim.frames import NodeState
from firmware_sim.ports import BusPort as EmulatorPort
from firmware_sim.pump_node import Change
from firmware_sim.rig import Rig as Emulator
from firmware_sim.truth import Truth
from hil import lockstep
from hil.bench import assembly
from hil.campaigns.cases import Case
from hil.campaigns.observer import VOLT_TOLERANCE_V, Observations, Observer, ran_dry, rate_broken
from hil.campaigns.toml_text import toml_text
from hil.core.types import Event, Mode, TickRecord
from hil.edge.can.bus import BusPort
from hil.edge.config.rig_file import load_rig
from hil.edge.config.scenario_file import Scenario
from hil.edge.config.settings_file import validated
from hil.loop import ControlLoop, Outcome
from hil.review.alarms import Finding, injected, merged
from hil.review.run_measures import dry_run
from hil.wire.contract import Contract

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
T_S = 0.1
RX_S = 0.3
"""max(3 control periods, 150 ms)"""
W_S = 0.25
"""The pump node's watchdog."""
RIM_CM = 20.0
REST_NS = 500_000_000
TIME_TOLERANCE_S = 1e-6
OFF = (0.0, 0.0)
LEVEL_FRAMES = ("LowerLevels", "UpperLevels")
NODE_FRAMES = (*LEVEL_FRAMES, "PumpStatus", "PumpHeartbeat", "LevelHeartbeat")
FRAME_PERIOD_S = {
    "LowerLevels": 0.02,
    "UpperLevels": 0.02,
    "PumpStatus": 0.05,
    "PumpHeartbeat": 0.1,
    "LevelHeartbeat": 0.1,
    "PumpCommand": 0.1,
}
MOVING = ((2.0, (0.2, 0.1)), (12.0, (-0.1, 0.2)), (22.0, (0.2, -0.2)), (32.0, (-0.2, 0.1)))
"""References that don't stand still: (at_s, change in V)."""

_channels = count()


def first(count_: int, *values: Any) -> list[Any]:
    """The values as parameters, all but the first few of them for the long tests."""
    return [value if i < count_ else pytest.param(value, marks=pytest.mark.long) for i, value in enumerate(values)]


def fault(kind: str, at_s: float, target: Any = None, value: float | None = None, **more: Any) -> dict[str, Any]:
    """A [[fault]] table; what is None is left out."""
    given = {"kind": kind, "at_s": at_s, "target": target, "value": value, **more}
    return {key: part for key, part in given.items() if part is not None}


def scenario_data(
    *faults: dict[str, Any],
    duration_s: float = 10.0,
    method: str = "none",
    references: Sequence[tuple[float, tuple[float, float]]] = (),
    **tables: Any,
) -> dict[str, Any]:
    """A scenario as a dict. references : (at_s, change in V). tables : further tables of the scenario."""
    made: dict[str, Any] = {
        "scenario": {"name": "fault", "duration_s": duration_s},
        "diagnosis": {"method": method},
        "reference": [{"at_s": at_s, "change_V": list(change_V)} for at_s, change_V in references if at_s < duration_s],
        "fault": sorted(faults, key=lambda one: float(one["at_s"])),
    }
    return {**made, **tables}


def watched(*faults: dict[str, Any], duration_s: float = 45.0, **tables: Any) -> dict[str, Any]:
    """A scenario with the diagnosis at work, on a rig that is not what its file says, with references that move."""
    tables = {"emulator": {"parameter_spread": 0.03}} | tables
    return scenario_data(*faults, duration_s=duration_s, method="glr", references=MOVING, **tables)


class Keeper(Observer):
    """A recorder that keeps everything, beside what a campaign looks at."""

    def __init__(self) -> None:
        super().__init__((0.0, 10.0))
        self.emulator: Emulator | None = None
        self.ticks: list[TickRecord] = []
        self.truths: list[Truth] = []
        self.changes: list[Change] = []
        self.sent: list[tuple[float, bytes]] = []
        self.odd: list[can.Message] = []

    def tick(self, record: TickRecord, true_level_cm: Any = None) -> None:
        super().tick(record, true_level_cm)
        assert self.emulator is not None
        self.ticks.append(record)
        self.truths.append(self.emulator.truth())

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        del arbitration_id
        if not is_rx:
            self.sent.append((timestamp_s, bytes(data)))

    def message(self, timestamp_s: float, message: Any) -> None:
        del timestamp_s
        self.odd.append(message)

    def on_change(self, change: Any) -> None:
        super().on_change(change)
        self.changes.append(change)


@dataclass
class Run:
    """A run and what is known of it. Times are run time; the emulator's scenario time is the same in lockstep."""

    keeper: Keeper
    emulator: Emulator
    loop: ControlLoop
    outcome: Outcome
    seen: Observations
    scenario_data: dict[str, Any]
    seed: int
    start_s: float = 0.0
    events: list[tuple[float, Event]] = field(default_factory=list)

    @property
    def ticks(self) -> list[TickRecord]:
        return self.keeper.ticks

    @property
    def trips(self) -> list[tuple[float, str]]:
        """(run time, cause) of the controller's trips."""
        return [(t_s, str(event.data["cause"])) for t_s, event in self.events if event.code == "trip"]

    @property
    def trip_s(self) -> float:
        assert self.trips, f"no trip: {self.outcome}, {self.told}"
        return self.trips[0][0]

    @property
    def cause(self) -> str:
        return self.trips[0][1] if self.trips else ""

    @property
    def told(self) -> list[str]:
        """All events, for messages."""
        return [f"{t_s:.1f} {event.text}" for t_s, event in self.events]

    def times(self, code: str) -> list[float]:
        return [t_s for t_s, event in self.events if event.code == code]

    @property
    def findings(self) -> tuple[Finding, ...]:
        return merged(event.data for _, event in self.events if event.code == "alarm")

    @property
    def names(self) -> list[str]:
        """What the diagnosis has settled on."""
        return [f"{f.kind} {f.target}" for f in self.findings if f.isolated_s is not None]

    def finding(self, *names: str) -> Finding:
        """The one that was settled under one of these names."""
        for one in self.findings:
            if f"{one.kind} {one.target}" in names and one.isolated_s is not None:
                return one
        raise AssertionError(f"none of {names} among {self.names}: {self.told}")

    def node_off_s(self, after_s: float) -> float:
        """When, after this time, the pump node's outputs went to 0 V."""
        for change in self.keeper.changes:
            t_s = change.t_ns * 1e-9 - self.start_s
            if change.node == "pump" and t_s > after_s - TIME_TOLERANCE_S and change.applied_V == OFF:
                return t_s
        raise AssertionError(f"the node never went to 0 V after {after_s} s: {self.told}")

    def from_s(self, at_s: float, to_s: float = 1e9) -> list[TickRecord]:
        return [tick for tick in self.ticks if at_s - TIME_TOLERANCE_S <= tick.t_s < to_s]

    def at(self, t_s: float) -> TickRecord:
        return next(tick for tick in self.ticks if tick.t_s >= t_s - TIME_TOLERANCE_S)

    def truth_at(self, t_s: float) -> Truth:
        index = next(i for i, tick in enumerate(self.ticks) if tick.t_s >= t_s - TIME_TOLERANCE_S)
        return self.keeper.truths[index]


def broken(run: Run, *, is_alone: bool = True) -> list[str]:
    """The invariants that the run broke, in words.

    is_alone : whether the controller is the only one that commands the node; what an unknown sender makes it do breaks
    the node's rate, and its latch no more than a real one's.
    """
    seen, faults = run.seen, injected(run.scenario_data["fault"])
    levels, applied = seen.steps[:, 3:7], seen.steps[:, 7:9]
    rate_V_s = 20.0
    words = [seen.range_broken]
    if len(levels) and (levels.max() > RIM_CM or run.emulator.truth().spilled_cm3 > 0.0):
        words.append(f"overflow: {levels.max():.2f} cm, {run.emulator.truth().spilled_cm3:.3g} cm3 spilled")
    if dry_run(seen.column("t_s"), applied, faults) or ran_dry(seen):
        words.append("a pump ran on without water")
    if is_alone:
        words += [seen.latch_broken, rate_broken(seen, rate_V_s, T_S)]
        if run.emulator.pump.applied_V != OFF:
            words.append(f"{run.emulator.pump.applied_V} V after the end")
    last = OFF
    for tick in run.ticks:
        if not all(0.0 <= v <= 10.0 for v in tick.command_V):
            words.append(f"command of {tick.command_V} V at {tick.t_s:.1f} s")
        steps = [abs(v - before) for v, before in zip(tick.command_V, last, strict=True)]
        if tick.command_V != OFF and max(steps) > rate_V_s * T_S + VOLT_TOLERANCE_V:
            words.append(f"command from {last} to {tick.command_V} V at {tick.t_s:.1f} s")
        if tick.mode is Mode.TRIPPED and tick.command_V != OFF:
            words.append(f"{tick.command_V} V commanded while tripped, at {tick.t_s:.1f} s")
        last = tick.command_V
    times = [tick.t_s for tick in run.ticks]
    failed = run.cause == "controller_failed"  # a step that raised has its event, but no row
    if sum(b - a > T_S + TIME_TOLERANCE_S for a, b in pairwise(times)) > failed:
        words.append("a step is missing in the record")
    return [word for word in words if word]


def play(
    scenario: dict[str, Any],
    *,
    seed: int = 1,
    is_alone: bool = True,
    fingerprint: int | None = None,
    detector: Callable[[Any], Any] | None = None,
    wrap: Callable[[can.BusABC], can.BusABC] = lambda bus: bus,
    on_step: Callable[[float], None] | None = None,
    emulator: Emulator | None = None,
    clear_trip: bool = False,
    checks: bool = True,
    ends: Callable[[], AbstractContextManager[tuple[can.BusABC, can.BusABC]]] | None = None,
) -> Run:
    """Run a scenario in lockstep over python-can's virtual bus; the invariants are asserted.

    fingerprint : of the nodes' DBC. detector : makes another detector from the scenario's own. wrap : puts something
    around our end of the bus. on_step : called with the run time before each step's frames are read. emulator : one
    that has been running; its clock goes on. checks : whether to assert the invariants.
    """
    bench, config, truth, faults = _built(scenario)
    if detector is not None:
        from dataclasses import replace

        config = replace(config, loop=replace(config.loop, detector=detector(config.loop.detector)))
    keeper = Keeper()
    if emulator is None:
        print_of = contract().fingerprint if fingerprint is None else fingerprint
        emulator = Emulator(truth, faults, seed, print_of, keeper.on_change)
    keeper.emulator, keeper.pump = emulator, emulator.pump
    keeper.effectiveness = lambda: emulator.effectiveness
    with (ends or _virtual_ends)() as (ours, theirs):
        port = BusPort(wrap(ours))
        loop = ControlLoop(
            config,
            contract(),
            bench.rig.sensors.range_V,
            port,
            keeper,
            arm_timeout_s=bench.rig.safety.arm_timeout_s,
            clear_trip=clear_trip,
            true_level_cm=lambda: emulator.levels_cm,
        )
        far: Any = _Later(emulator, theirs, emulator.now_ns, on_step)
        outcome = lockstep.run(loop, port, far, config.loop.period_s)
    emulator.advance(emulator.now_ns + REST_NS)
    start_s = (emulator.start_ns or 0) * 1e-9
    run = Run(keeper, emulator, loop, outcome, keeper.result(), scenario, seed, start_s)
    run.events = list(run.seen.events)
    if checks:
        words = broken(run, is_alone=is_alone)
        assert not words, f"seed {seed}, {scenario['fault']}: {words}; {run.told}"
    return run


@lru_cache(maxsize=1)
def plain() -> Run:
    """The usual run without any fault, made once; nobody changes it."""
    return play(scenario_data())


def play_with_early_fault(scenario: dict[str, Any], after_s: float, *, seed: int) -> Run:
    """Play, with the scenario's only fault so long after power-up: in the start phase, before its time begins."""
    _, _, truth, faults = _built(scenario)
    emulator = Emulator(truth, (), seed, contract().fingerprint)
    coming = list(faults)

    def on_step(_: float) -> None:
        if coming and emulator.now_ns >= round(after_s * 1e9):
            emulator.inject(coming.pop(), emulator.now_ns)

    return play(scenario, seed=seed, emulator=emulator, on_step=on_step)


@contextmanager
def _virtual_ends() -> Iterator[tuple[can.BusABC, can.BusABC]]:
    channel = f"faults {next(_channels)}"
    made: dict[str, Any] = {
        "interface": "virtual",
        "channel": channel,
        "preserve_timestamps": True,
        "ignore_config": True,
    }
    with can.Bus(**made) as ours, can.Bus(**made) as theirs:
        yield ours, theirs


class _Later(EmulatorPort):
    """The emulator's end of the bus for a loop whose clock begins at 0, perhaps in the midst of the emulator's."""

    def __init__(self, rig: Emulator, bus: can.BusABC, began_ns: int, on_step: Callable[[float], None] | None) -> None:
        super().__init__(rig, bus)
        self._began_ns, self._on_step = began_ns, on_step

    def step(self, now_ns: int) -> None:
        if self._on_step is not None:
            start_ns = self.rig.start_ns
            self._on_step((now_ns + self._began_ns - start_ns) * 1e-9 if start_ns is not None else -1.0)
        super().step(now_ns + self._began_ns)

    def read(self, now_ns: int) -> bool:
        return super().read(now_ns + self._began_ns)

    def send(self, frames: list[can.Message]) -> None:
        if self._began_ns:
            for frame in frames:
                frame.timestamp -= self._began_ns * 1e-9
        super().send(frames)


@lru_cache(maxsize=1)
def contract() -> Contract:
    return assembly.load_contract(CONFIG / "bench.dbc")


def _built(scenario: dict[str, Any]) -> tuple[Any, Any, Any, Any]:
    """Everything that a run of this scenario is made of; the emulator reads its part from a file, as it always does."""
    import tempfile

    with tempfile.NamedTemporaryFile("w", suffix=".toml", encoding="utf-8") as file:
        file.write(toml_text(scenario))
        file.flush()
        truth, faults = emulator_settings.load(CONFIG / "emulator.toml", Path(file.name))
    checked = validated(Scenario, scenario, "scenario")
    rig = load_rig(CONFIG / "rig.toml", checked, Path("scenario"))
    bench = assembly.Bench(checked, rig, contract(), Path("scenario"), CONFIG)
    return bench, assembly.controller_config(bench), truth, faults


def assert_tripped(run: Run, at_s: float, within_s: float, *causes: str) -> None:
    """A trip no earlier than at_s and within the bound; one of the causes; the node at 0 V by then or within W."""
    assert at_s - TIME_TOLERANCE_S <= run.trip_s <= at_s + within_s + TIME_TOLERANCE_S, run.told
    assert not causes or run.cause in causes, run.told
    assert run.outcome.status == "tripped"
    assert run.node_off_s(at_s) <= max(run.trip_s, at_s + W_S) + TIME_TOLERANCE_S


def assert_safe(run: Run, at_s: float, within_s: float = W_S) -> None:
    """SAFE: the node itself at 0 V within the bound, latched, and so it stays."""
    assert run.node_off_s(at_s) <= at_s + within_s + TIME_TOLERANCE_S, run.told
    assert run.emulator.pump.applied_V == OFF
    assert run.emulator.pump.state is NodeState.TRIPPED


def assert_no_trip(run: Run) -> None:
    assert run.trips == [], run.told
    assert (run.outcome.status, run.outcome.reason) == ("complete", "duration over"), run.outcome


def case_of(scenario: dict[str, Any], seed: int, label: str = "fault") -> Case:
    """The same for the campaign's runner."""
    return Case(f"{label} {seed}", label, "fault", seed, scenario)
