"""While a client sends anything whatever, no control step is later than in the same run while it sends nothing.

Phases in which it sends and in which it only thinks what it would send take turns in one run, half a second each, so
that both have the same load of the computer.
`CONTROL_FUZZ_SECONDS=600 pytest -m long tests/control/test_control_fuzz_timing.py` takes ten minutes.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from hil.core.types import Mode
from hil.edge.host.realtime import DEFAULT_PRIORITY
from tests.control.control_bench import Bench, control_bench
from tests.control.test_control_fuzz import MAX_MEMORY_KB, memory_kb

SECONDS = float(os.environ.get("CONTROL_FUZZ_SECONDS", "8"))
PERIOD_S, PHASE_STEPS, SETTLE_STEPS = 0.02, 25, 3
ALLOWED = {True: 1.05, False: 1.5}
"""Of the 99 % quantile of the lateness and of the steps skipped, with the client over without it; as the steps have
SCHED_FIFO or not. Without it a client is one more program on a computer that is perhaps full."""

RESOLUTION_S = 0.01 * PERIOD_S
SKIPPED_SHARE = 0.001
RESAMPLES, CONFIDENCE = 300, 0.025


def phase(bench: Bench) -> tuple[list[float], list[float], int]:
    """Lateness and processor time of the steps, s, and the steps skipped, of one phase."""
    late, used, skipped = [], [], 0
    deadline_s = time.monotonic() + PERIOD_S
    for number in range(PHASE_STEPS):
        time.sleep(max(deadline_s - time.monotonic(), 0.0))
        late_s = time.monotonic() - deadline_s
        begin_s = time.thread_time()
        bench.step()
        if number >= SETTLE_STEPS:
            late.append(late_s)
            used.append(time.thread_time() - begin_s)
            skipped += int(late_s // PERIOD_S)
        deadline_s += PERIOD_S * (1 + late_s // PERIOD_S)
        assert bench.state.supervision.cause is None, "no request trips the rig"
        if bench.state.supervision.mode not in (Mode.RUNNING, Mode.MANUAL):
            bench.restart()
            deadline_s = time.monotonic() + PERIOD_S
    return late, used, skipped


@contextmanager
def first_of_all() -> Iterator[bool]:
    """SCHED_FIFO for this thread, where it is granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(DEFAULT_PRIORITY))
    except PermissionError:
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def excess(of: Callable[[np.ndarray], float], quiet: np.ndarray, fuzzed: np.ndarray, allowed: float) -> float:
    """How much a figure of the phases with the client exceeds `allowed` times that of those without: the low end of its
    confidence interval, from pairs of phases drawn again with replacement.

    quiet, fuzzed : a row for each pair.
    """
    draws = np.random.default_rng(1)
    found = []
    for _ in range(RESAMPLES):
        pairs = draws.integers(0, len(quiet), len(quiet))
        found.append(of(fuzzed[pairs]) - allowed * of(quiet[pairs]))
    return float(np.quantile(found, CONFIDENCE))


@pytest.mark.long
def test_a_client_that_sends_anything_makes_no_step_late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    late: list[list[list[float]]] = [[], []]
    used: list[list[float]] = [[], []]
    skipped: list[list[int]] = [[], []]
    requests = 0
    with control_bench(tmp_path, period_s=PERIOD_S) as bench:
        command = [sys.executable, "-m", "tests.control.fuzz_client", f"{bench.path}"]
        with ExitStack() as stack, subprocess.Popen(command, start_new_session=True) as client:
            try:
                while "operator" not in bench.codes():  # until it sends
                    bench.step()
                    time.sleep(PERIOD_S)
                end_s = time.monotonic() + SECONDS
                allowed = ALLOWED[stack.enter_context(first_of_all())]
                while time.monotonic() < end_s:
                    for is_fuzzed, number in ((False, signal.SIGUSR1), (True, signal.SIGUSR2)):
                        client.send_signal(number)
                        lateness, processor, steps = phase(bench)
                        late[is_fuzzed].append(lateness)
                        used[is_fuzzed] += processor
                        skipped[is_fuzzed].append(steps)
                    assert bench.channel._process.poll() is None
                    assert client.poll() is None
                    assert memory_kb(bench.channel._process.pid) < MAX_MEMORY_KB
                    assert "control_lost" not in bench.codes()
                    requests += bench.codes().count("operator")
                    bench.events.clear()
            finally:
                client.kill()
    quiet, fuzzed = np.array(late[0]), np.array(late[1])
    p99 = [float(np.percentile(values, 99)) for values in (quiet, fuzzed, used[0], used[1])]
    sys.stdout.write(
        f"allowed {allowed}, {quiet.size} steps each, {requests} requests taken; "
        f"lateness p99 {p99[0] * 1e3:.3f} ms without and "
        f"{p99[1] * 1e3:.3f} with the client, processor time of a step {p99[2] * 1e3:.3f} and {p99[3] * 1e3:.3f} ms, "
        f"skipped {sum(skipped[0])} and {sum(skipped[1])}\n"
    )
    assert requests > 0
    assert excess(lambda phases: float(np.percentile(phases, 99)), quiet, fuzzed, allowed) <= RESOLUTION_S
    share = [np.array(steps) / (PHASE_STEPS - SETTLE_STEPS) for steps in skipped]
    assert excess(lambda phases: float(phases.mean()), share[0], share[1], allowed) <= SKIPPED_SHARE
    assert p99[3] <= 3.0 * p99[2], "what a step takes from clients is bounded"
