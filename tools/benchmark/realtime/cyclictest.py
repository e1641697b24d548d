"""`cyclictest` of rt-tests, the usual reference for real-time Linux; its histogram is converted to samples."""

from __future__ import annotations

import re
import shutil
import subprocess

import numpy as np
from numpy.typing import NDArray

MAX_US = 50_000
MISSING = "cyclictest is not installed: apt-get install rt-tests; the loop is measured without its reference"


def is_there() -> bool:
    """Whether it is installed."""
    return shutil.which("cyclictest") is not None


def lateness_us(period_s: float, seconds: float, priority: int, cpu: int) -> NDArray[np.float64]:
    """How late its thread woke up, microseconds, (n,). One thread under SCHED_FIFO, memory locked.

    Raises RuntimeError when it can't run.
    """
    command = ["cyclictest", "-q", "-m", "-t", "1", "-p", str(priority), "-a", str(cpu)]
    command += ["-i", str(round(period_s * 1e6)), "-D", str(max(1, round(seconds))), "-h", str(MAX_US)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"cyclictest failed: {(done.stderr or done.stdout).strip()}")
    return samples(done.stdout)


def samples(text: str) -> NDArray[np.float64]:
    """The samples of a histogram of `cyclictest -h`; those beyond its end count as the maximum."""
    counts = [(int(us), int(count)) for us, count in re.findall(r"^(\d+)\s+(\d+)\s*$", text, re.MULTILINE)]
    overflows, largest = (
        int(found.group(1)) if (found := re.search(rf"^# {what}:\s*(\d+)", text, re.MULTILINE)) else 0
        for what in ("Histogram Overflows", "Max Latencies")
    )
    values = np.repeat([us for us, _ in counts], [count for _, count in counts])
    return np.concatenate([values, np.full(overflows, largest)]).astype(np.float64)
