"""What the full diagnosis costs: a control step quiet and while an alarm is isolated, and that it leaves no litter."""

from __future__ import annotations

import gc
import importlib
import pkgutil
import time
import tracemalloc
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np
from numba.core.registry import CPUDispatcher

import hil.core.diagnosis.glr
from hil.bench import assembly
from hil.core import controller
from hil.core.controller import ControllerConfig, ControllerState
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.ideal import NoDetector
from tools.benchmark import ROOT, SCENARIO
from tools.benchmark.capture import Capture
from tools.benchmark.tables import Section, as_time, as_verdict
from tools.benchmark.timing import TICK_US, Effort

SHARE_TARGET = 0.01
GROWTH_TARGET_KB = 256.0
COUNTED_STEPS = 1000
LEAK = ROOT / "config/scenarios/leak.toml"
"""Its alarms take seconds to isolate, all hypotheses replayed at every step."""


@dataclass
class Times:
    """Step times in us, by what the detector was at."""

    without: list[float] = field(default_factory=list)
    quiet: list[float] = field(default_factory=list)
    isolating: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)


def diagnosis_step(effort: Effort) -> list[Section]:
    """`controller.step` with the diagnosis, beside the same step without a detector, pass by pass."""
    times = Times()
    for scenario in (SCENARIO, LEAK):
        capture = Capture.of_a_run(scenario=scenario)
        config = assembly.controller_config(assembly.load(scenario))
        without = replace(config, loop=replace(config.loop, detector=NoDetector()))
        passes = max(1, effort.steps // (2 * len(capture.inputs)))
        for _ in range(passes):
            plain, quiet, isolating = _pass(without, capture)[0], *_pass(config, capture)
            times.without += plain
            times.quiet += quiet
            times.isolating += isolating
            times.ratios.append(median(quiet) / median(plain))
    found = {
        "no detector": times.without,
        "glr": times.quiet + times.isolating,
        "glr, quiet": times.quiet,
        "glr, isolating": times.isolating,
    }
    rows = [(name, str(len(took)), *_quantiles(took, is_target=name != "no detector")) for name, took in found.items()]
    note = (
        f"All of `controller.step` on the inputs of runs of {SCENARIO.name} and {LEAK.name}. Isolating: an alarm is "
        "raised or not resolved yet, and every hypothesis is replayed. The quiet step takes "
        f"{median(times.ratios):.2f} times the step without a detector. Tick: 100 ms; target: p99 within 1 % of it."
    )
    columns = ("step", "steps", "p50", "p99", "max", "p99, share of a tick", "verdict")
    return [Section("One control step with diagnosis", note, columns, rows), _litter()]


def _pass(config: ControllerConfig, capture: Capture) -> tuple[list[float], list[float]]:
    """Times in us of a run's steps: quiet ones, and those in which an alarm is open."""
    quiet: list[float] = []
    isolating: list[float] = []
    state = ControllerState()
    for number, inputs in enumerate(capture.inputs):
        was_open = _is_open(state)
        started_ns = time.perf_counter_ns()
        state, output = controller.step(config, state, inputs, number * capture.period_ns)
        took_us = (time.perf_counter_ns() - started_ns) * 1e-3
        is_raised = any(event.code == "alarm" for event in output.events)
        (isolating if was_open or is_raised else quiet).append(took_us)
    return quiet, isolating


def _is_open(state: ControllerState) -> bool:
    memory = None if state.loop is None else state.loop.memory
    return isinstance(memory, Memory) and memory.suspicion is not None


def _quantiles(took_us: list[float], *, is_target: bool) -> tuple[str, ...]:
    p50, p99, largest = (float(value) for value in np.percentile(took_us, [50, 99, 100]))
    verdict = as_verdict(p99 <= SHARE_TARGET * TICK_US) if is_target else ""
    return as_time(p50), as_time(p99), as_time(largest), f"{100.0 * p99 / TICK_US:.2f} %", verdict


def _litter() -> Section:
    """What a run compiles and allocates after it has armed: nothing, and little."""
    capture = Capture.of_a_run(250.0, scenario=SCENARIO)
    config = assembly.controller_config(assembly.load(SCENARIO))
    before = _compiled()
    state = ControllerState()
    warm = len(capture.inputs) - COUNTED_STEPS  # the counted steps hold the fault
    for number, inputs in enumerate(capture.inputs[:warm]):
        state, _ = controller.step(config, state, inputs, number * capture.period_ns)
    gc.collect()
    tracemalloc.start()
    try:
        state, _ = controller.step(config, state, capture.inputs[warm], warm * capture.period_ns)
        at_start, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        for number in range(warm + 1, len(capture.inputs)):
            state, _ = controller.step(config, state, capture.inputs[number], number * capture.period_ns)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    peak_kB = (peak - at_start) / 1024.0
    is_all_compiled = _compiled() == before
    rows = [
        ("functions compiled after arming", "0" if is_all_compiled else "some", "0", as_verdict(is_all_compiled)),
        (
            f"most memory above the start, {COUNTED_STEPS} steps",
            f"{peak_kB:.0f} kB",
            f"{GROWTH_TARGET_KB:.0f} kB",
            as_verdict(peak_kB <= GROWTH_TARGET_KB),
        ),
    ]
    note = (
        "Signatures that numba holds before and after a run with a fault; Python's and NumPy's memory by tracemalloc "
        "over the steps around the fault, detection, isolation and reconfiguration among them."
    )
    return Section("What a run compiles and allocates", note, ("what", "found", "target", "verdict"), rows)


def _compiled() -> dict[str, int]:
    """Signatures that each compiled function of the diagnosis has been compiled for."""
    found = {}
    for info in pkgutil.iter_modules(hil.core.diagnosis.glr.__path__):
        module = importlib.import_module(f"hil.core.diagnosis.glr.{info.name}")
        for name, value in vars(module).items():
            if isinstance(value, CPUDispatcher):
                found[f"{info.name}.{name}"] = len(value.signatures)
    return found
