"""Timings, as ratios wherever there is something to compare with: `python -m tools.benchmark [--write] [--quick]`.

What is compared takes turns within one process, round by round, so that a busy machine slows both alike. A figure is
the median over the rounds with the lowest beside it; a ratio is the median of the rounds' own ratios.
"""

from __future__ import annotations

import argparse
import cProfile
import importlib.util
import os
import platform
import pstats
import sys
import tempfile
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

import can
import cantools
import control
import numpy as np
import scipy.signal
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from firmware_sim import settings as emulator_settings
from firmware_sim.ports import BusPort as EmulatorPort
from firmware_sim.rig import Rig as Emulator
from hil import lockstep
from hil.cli import build, experiment
from hil.core import controller
from hil.core.controller import ControllerState, Output
from hil.core.design import PAPER_ANGLES_RAD, PAPER_POLES
from hil.core.eigenstructure import assign, augment
from hil.core.tanks import equilibrium, linearise, printed_linear_model
from hil.core.types import Event, Inputs, Mode, Quad, TickRecord
from hil.edge.bus import BusPort
from hil.loop import ControlLoop
from hil.wire.checks import FrameCheck, Rejection

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "config/scenarios/paper.toml"
DOCUMENT = ROOT / "docs/benchmarks.md"
BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"

TICK_US = 100_000.0
SPEED_TARGET = 150.0
YT_TARGET = 100.0
VARGA_TARGET = 1.0
PROFILE_ROWS = 25


@dataclass(frozen=True)
class Section:
    """One table with its note."""

    title: str
    note: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@dataclass(frozen=True)
class Effort:
    """How many runs, rounds and steps."""

    runs: int = 7
    rounds: int = 41
    steps: int = 20_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description="Timings of the project, as ratios where there is a peer.")
    parser.add_argument("--write", action="store_true", help=f"put the figures into {DOCUMENT.relative_to(ROOT)}")
    parser.add_argument("--quick", action="store_true", help="few repetitions: to see that it works")
    options = parser.parse_args(arguments)
    effort = Effort(runs=2, rounds=7, steps=2_000) if options.quick else Effort()
    console = Console(width=max(Console().width, 120))
    sections = []
    measures = (lockstep_speed, lockstep_profile, eigenstructure_assignment, recomputation, control_step, codec)
    for measure in measures:
        for section in measure(effort):
            sections.append(section)
            console.print(_rich(section), section.note, "")
    if options.write:
        _write(sections, effort)
        console.print(f"written to {DOCUMENT.relative_to(ROOT)}")
    return 0


def lockstep_speed(effort: Effort) -> list[Section]:
    """Scenario seconds per second, with and without Rerun, in turns; the first round warms up and does not count."""
    bench = build.load(SCENARIO)
    speeds: dict[bool, list[float]] = {True: [], False: []}
    with tempfile.TemporaryDirectory() as folder:
        for index in range(effort.runs + 1):
            for rerun, found in speeds.items():
                speed = _simulate(bench, Path(folder) / f"{index}_{rerun}", rerun=rerun)
                if index:
                    found.append(speed)
    rows = [
        (
            f"paper.toml, {'with' if rerun else 'without'} Rerun",
            f"{median(found):.0f} ×",
            f"{max(found):.0f} ×",
            f"{SPEED_TARGET:.0f} ×",
            _verdict(median(found) >= SPEED_TARGET),
        )
        for rerun, found in speeds.items()
    ]
    note = (
        "Times real time: 500 s of scenario over the wall time of the whole run, from opening the folder to kpi.json. "
        "0.1 s control period, 20 ms level frames, every frame encoded, sent on a virtual bus, checked and decoded."
    )
    return [Section("Lockstep speed", note, ("run", "median", "best", "target", "verdict"), rows)]


def lockstep_profile(effort: Effort) -> list[Section]:
    """Where a run's time goes: own time by function, and by module. One run, whatever the effort."""
    del effort
    bench = build.load(SCENARIO)
    profile = cProfile.Profile()
    with tempfile.TemporaryDirectory() as folder:
        profile.enable()
        _simulate(bench, Path(folder) / "run", rerun=True)
        profile.disable()
    own = _own_times(profile)
    total = sum(own.values())
    groups: defaultdict[str, float] = defaultdict(float)
    for function, seconds in own.items():
        groups[_group(function[0])] += seconds
    modules = [
        (name, _share(seconds, total))
        for name, seconds in sorted(groups.items(), key=lambda group: -group[1])
        if seconds > 0.001 * total
    ]
    functions = [
        (_group(file), f"{name} ({Path(file).name}:{line})", _share(seconds, total))
        for (file, line, name), seconds in sorted(own.items(), key=lambda function: -function[1])[:PROFILE_ROWS]
    ]
    by_module = (
        "Own time in cProfile of one run with Rerun; built-in functions count for their caller. What is of the "
        "standard library is nearly all python-can's virtual bus: copy, queue, threading."
    )
    by_function = (
        f"The {PROFILE_ROWS} functions with the most. A profiler makes small functions look dearer than they are."
    )
    return [
        Section("Where a lockstep run's time goes, by module", by_module, ("module", "share"), modules),
        Section("The same by function", by_function, ("module", "function", "share"), functions),
    ]


def eigenstructure_assignment(effort: Effort) -> list[Section]:
    """`assign` beside scipy's and slycot's pole placement, on the model and poles of the calibrated design."""
    A, B = augment(printed_linear_model())
    poles = np.array(PAPER_POLES)
    angles = np.array(PAPER_ANGLES_RAD)
    W = np.vstack([np.cos(angles), np.sin(angles)])
    ours, alike = "assign", "assign, given YT's eigenvectors"
    W_alike = _parameters(A, B, _place(A, B, poles, "YT"), poles)
    calls: dict[str, tuple[Callable[[], Any], int]] = {
        ours: (lambda: assign(A, B, poles, W).K, 100),
        alike: (lambda: assign(A, B, poles, W_alike).K, 100),
        "scipy place_poles, YT": (lambda: _place(A, B, poles, "YT"), 1),
        "scipy place_poles, KNV0": (lambda: _place(A, B, poles, "KNV0"), 3),
    }
    has_slycot = importlib.util.find_spec("slycot") is not None
    if has_slycot:
        calls["control place_varga (slycot)"] = (lambda: control.place_varga(A, B, poles), 100)
    times = _in_turns(calls, effort.rounds)
    errors = {name: _pole_error(A, B, call(), poles) for name, (call, _) in calls.items()}
    targets = {"scipy place_poles, YT": YT_TARGET, "control place_varga (slycot)": VARGA_TARGET}
    rows = []
    for name, found in times.items():
        ratio = median(theirs / mine for theirs, mine in zip(found, times[ours], strict=True))
        target = targets.get(name)
        verdict = "" if target is None else _verdict(ratio >= target)
        if name == alike:
            verdict = f"error {_verdict(errors[alike] <= max(errors[peer] for peer in targets if peer in errors))}"
        wanted = "" if target is None else f"≥ {target:g}"
        timing = (_time(median(found)), _time(min(found)), f"{ratio:.1f}")
        rows.append((name, *timing, wanted, f"{errors[name]:.1e}", verdict))
    if not has_slycot:
        rows.append(("control place_varga", "–", "–", "–", "", "–", "not measured: pip install slycot (GPL)"))
    note = (
        "Six states, two inputs; the first row has the calibrated eigenvectors, which nobody else can be asked for. "
        "Their condition number of 541 is in its error. Ratio: time over the first row's. Error: largest distance of "
        "an achieved pole from the requested one, 1/s; to be no larger than the peers' where the eigenvectors are YT's."
    )
    columns = ("method", "median", "best", "ratio", "target", "pole error", "verdict")
    return [Section("Eigenstructure assignment", note, columns, rows)]


def recomputation(effort: Effort) -> list[Section]:
    """What a change of reference or diagnosis costs within a control step."""
    config = build.controller_config(build.load(SCENARIO)).loop
    model, design = config.reconfiguration.model, config.reconfiguration.design
    at = linearise(model, equilibrium(model, config.reconfiguration.operating_point_V))
    reference = config.references[0][1]
    law = config.reconfiguration.law
    calls: dict[str, tuple[Callable[[], Any], int]] = {
        "RigDesign.gains": (lambda: design.gains(at), 50),
        "Reconfiguration.law": (lambda: law(reference, (0.4, 0.4)), 50),
        "Reconfiguration.law, reference out of reach": (lambda: law(reference, (0.2, 0.4)), 20),
    }
    times = _in_turns(calls, effort.rounds)
    rows = [
        (name, _time(median(found)), _time(min(found)), f"{100.0 * median(found) / TICK_US:.2f} %")
        for name, found in times.items()
    ]
    note = "`law` is all of it: gains, operating voltages, the target that the pumps can reach. Tick: 100 ms."
    return [Section("Recomputing the control law", note, ("what", "median", "best", "share of a tick"), rows)]


def control_step(effort: Effort) -> list[Section]:
    """`controller.step` on what a run of the paper's scenario gave it to see."""
    capture = Capture.of_a_run()
    config = build.controller_config(build.load(SCENARIO))
    took_us: list[float] = []
    while len(took_us) < effort.steps:
        state = ControllerState()
        for number, inputs in enumerate(capture.inputs[: effort.steps - len(took_us)]):
            started_ns = time.perf_counter_ns()
            state, _ = controller.step(config, state, inputs, number * capture.period_ns)
            took_us.append((time.perf_counter_ns() - started_ns) * 1e-3)
    p50, p99, largest = (float(value) for value in np.percentile(took_us, [50, 99, 100]))
    rows = [
        (name, _time(value), f"{100.0 * value / TICK_US:.2f} %")
        for name, value in (("p50", p50), ("p99", p99), ("max", largest))
    ]
    note = f"{len(took_us)} steps, reference changes and reconfiguration among them. Tick: 100 ms."
    return [Section("One control step", note, ("quantile", "time", "share of a tick"), rows)]


def codec(effort: Effort) -> list[Section]:
    """Encode, check and decode, per frame, beside cantools' own encode and decode (which know no CRC or counter)."""
    capture = Capture.of_a_run(60.0)
    bench = build.load(SCENARIO)
    specs = {spec.frame_id: spec for spec in bench.contract.frames.values()}
    database: Any = cantools.database.load_file(bench.dbc_path)
    command = bench.contract.frames["PumpCommand"]
    values: dict[str, Any] = {"Command1": 3.1, "Command2": 2.9, "Enable": 1, "ClearTrip": 0, "Counter": 7, "Crc": 0}
    frames = capture.frames[:400]

    def admit() -> None:
        checks = {frame_id: FrameCheck(spec) for frame_id, spec in specs.items()}
        for frame in frames:
            found = checks[frame.arbitration_id].admit(frame, round(frame.timestamp * 1e9))
            if isinstance(found, Rejection):
                raise AssertionError(f"frame {frame} refused: {found}")

    def decode() -> None:
        for frame in frames:
            specs[frame.arbitration_id].decode(bytes(frame.data))

    def decode_by_cantools() -> None:
        for frame in frames:
            database.decode_message(frame.arbitration_id, frame.data, decode_choices=False)

    calls: dict[str, tuple[Callable[[], Any], int]] = {
        "encode, with CRC": (lambda: command.encode(values), 400),
        "cantools encode": (lambda: database.encode_message("PumpCommand", values), 400),
        "check and decode": (admit, 1),
        "decode alone": (decode, 1),
        "cantools decode": (decode_by_cantools, 1),
    }
    times = _in_turns(calls, effort.rounds)
    for name in ("check and decode", "decode alone", "cantools decode"):
        times[name] = [value / len(frames) for value in times[name]]
    peers = {"encode, with CRC": "cantools encode", "check and decode": "cantools decode"}
    peers["decode alone"] = "cantools decode"
    rows = []
    for name, found in times.items():
        peer = peers.get(name)
        ratio = median(theirs / mine for theirs, mine in zip(times[peer], found, strict=True)) if peer else None
        rows.append((name, _time(median(found)), _time(min(found)), "" if ratio is None else f"{ratio:.1f}"))
    both = [e + d for e, d in zip(times["encode, with CRC"], times["check and decode"], strict=True)]
    rows.append(("encode + check + decode", _time(median(both)), _time(min(both)), ""))
    note = (
        "Per frame; PumpCommand for encoding, the frames of a run in their order for checking. "
        "Ratio: cantools' time over ours."
    )
    return [Section("Codec", note, ("what", "median", "best", "ratio"), rows)]


class Capture:
    """A run in lockstep without files, for what the controller saw and what was on the bus. Also a loop's recorder."""

    def __init__(self, period_s: float) -> None:
        self.period_ns = round(period_s * 1e9)
        self.inputs: list[Inputs] = []
        self.frames: list[can.Message] = []

    @classmethod
    def of_a_run(cls, duration_s: float | None = None) -> Capture:
        """The paper's scenario, or the beginning of it."""
        bench = build.load(SCENARIO)
        config = build.controller_config(bench, duration_s)
        truth, faults = emulator_settings.load(bench.emulator_path, bench.scenario_path)
        emulator = Emulator(truth, faults, 1, emulator_settings.load_fingerprint(bench.dbc_path))
        capture = cls(config.loop.period_s)
        channel = f"benchmark-{id(capture)}"
        ours, theirs = (
            can.Bus(interface="virtual", channel=channel, preserve_timestamps=True, ignore_config=True)
            for _ in range(2)
        )
        with ours, theirs:
            port = BusPort(ours)
            loop = ControlLoop(
                config,
                bench.contract,
                bench.rig.sensors.range_V,
                port,
                capture,
                arm_timeout_s=bench.rig.safety.arm_timeout_s,
                on_tick=capture.watch,
            )
            lockstep.run(loop, port, EmulatorPort(emulator, theirs), config.loop.period_s)
        return capture

    def watch(self, inputs: Inputs, output: Output, mode: Mode) -> None:
        """Keep what a step saw."""
        del output, mode
        self.inputs.append(inputs)

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None) -> None:
        """Steps are not kept."""

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        """Keep what came off the bus."""
        if is_rx:
            self.frames.append(
                can.Message(timestamp_s, arbitration_id, is_extended_id=False, data=bytearray(data), is_rx=True)
            )

    def message(self, timestamp_s: float, message: Any) -> None:
        """There are no others."""

    def event(self, t_s: float, event: Event) -> None:
        """Events are not kept."""


def _simulate(bench: build.Bench, out: Path, *, rerun: bool) -> float:
    """Scenario seconds per wall second of a whole run."""
    started = time.perf_counter()
    kpi = experiment.simulate(bench, experiment.Options(out=out, rerun=rerun))
    wall_s = time.perf_counter() - started
    if kpi.status != "complete":
        raise RuntimeError(f"the run ended {kpi.status}: {kpi.reason}")
    return kpi.duration_s / wall_s


def _in_turns(calls: dict[str, tuple[Callable[[], Any], int]], rounds: int) -> dict[str, list[float]]:
    """Microseconds per call, one number a round. calls : name -> (call, how often in a round)."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # place_poles warns when its iterations did not converge
        for index in range(rounds + 1):  # the first round warms up
            for name, (call, count) in calls.items():
                started = time.perf_counter()
                for _ in range(count):
                    call()
                took_us = (time.perf_counter() - started) / count * 1e6
                if index:
                    times[name].append(took_us)
    return times


def _place(A: NDArray[Any], B: NDArray[Any], poles: NDArray[Any], method: str) -> Any:
    return scipy.signal.place_poles(A, B, poles, method=method).gain_matrix


def _parameters(A: NDArray[Any], B: NDArray[Any], K: Any, poles: NDArray[Any]) -> NDArray[Any]:
    """The parameters w_i = K v_i with which `assign` gives the eigenvectors of A - B K."""
    values, vectors = np.linalg.eig(A - B @ np.asarray(K))
    order = [int(np.argmin(np.abs(values - pole))) for pole in poles]
    parameters: NDArray[Any] = (np.asarray(K) @ vectors[:, order]).real
    return parameters


def _pole_error(A: NDArray[Any], B: NDArray[Any], K: Any, poles: NDArray[Any]) -> float:
    """Largest distance of an eigenvalue of A - B K from the pole it stands for."""
    achieved = np.sort_complex(np.linalg.eigvals(A - B @ np.asarray(K)))
    return float(np.max(np.abs(achieved - np.sort_complex(poles))))


Function = tuple[str, int, str]


def _own_times(profile: cProfile.Profile) -> dict[Function, float]:
    """Own time in s by function; that of built-in functions goes to their callers."""
    own: defaultdict[Function, float] = defaultdict(float)
    stats: dict[Function, tuple[int, int, float, float, dict[Function, Any]]] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    for function, (_, _, seconds, _, callers) in stats.items():
        if function[0] != "~" or not callers:
            own[function] += seconds
            continue
        for caller, (_, _, part, _) in callers.items():
            own[caller] += part
    return own


def _group(file: str) -> str:
    """Which of the modules of interest a source file belongs to."""
    path = Path(file)
    parts = path.parts
    if "site-packages" in parts:
        package = parts[parts.index("site-packages") + 1].removesuffix(".py")
        return {"can": "python-can", "rerun_sdk": "rerun", "rerun_bindings": "rerun"}.get(package, package)
    if path.is_relative_to(ROOT):
        inside = path.relative_to(ROOT).parts
        return f"hil.{inside[1].removesuffix('.py')}" if inside[0] == "hil" else inside[0]
    return "built in" if file == "~" else "standard library"


def _time(us: float) -> str:
    """Three digits, in µs or ms."""
    scaled, unit = (us, "µs") if us < 1000.0 else (us / 1000.0, "ms")
    digits = 2 if scaled < 10.0 else 1 if scaled < 100.0 else 0
    return f"{scaled:.{digits}f} {unit}"


def _share(part: float, total: float) -> str:
    return f"{100.0 * part / total:.1f} %"


def _verdict(is_met: bool) -> str:
    return "met" if is_met else "not met"


def _rich(section: Section) -> Table:
    table = Table(title=section.title, title_justify="left")
    for column in section.columns:
        table.add_column(column)
    for row in section.rows:
        table.add_row(*row)
    return table


def _write(sections: list[Section], effort: Effort) -> None:
    """Replace what stands between the markers of the document."""
    lines = [BEGIN, "", _circumstances(effort)]
    for section in sections:
        lines += ["", f"## {section.title}", "", section.note, ""]
        lines += [f"| {' | '.join(section.columns)} |", f"|{'---|' * len(section.columns)}"]
        lines += [f"| {' | '.join(row)} |" for row in section.rows]
    text = DOCUMENT.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    block = "\n".join(lines)
    DOCUMENT.write_text(f"{before}{block}\n\n{END}{after}", encoding="utf-8")


def _circumstances(effort: Effort) -> str:
    packages = ("numpy", "scipy", "control", "slycot", "python-can", "cantools", "rerun-sdk")
    versions = ", ".join(f"{name} {version(name)}" for name in packages if importlib.util.find_spec(_module(name)))
    now = datetime.now(UTC)
    load = os.getloadavg()[0]
    machine = f"{os.cpu_count()} cores, {_cpu_model()}, {platform.system()} {platform.machine()}"
    return (
        f"{now:%Y-%m-%d}; {machine}, load average {load:.1f} at the end; "
        f"Python {platform.python_version()}, {versions}; {effort.runs} runs, {effort.rounds} rounds."
    )


def _module(package: str) -> str:
    return {"python-can": "can", "rerun-sdk": "rerun"}.get(package, package)


def _cpu_model() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or "unknown processor"
    return next(
        (line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")), "unknown"
    )


if __name__ == "__main__":
    sys.exit(main())
