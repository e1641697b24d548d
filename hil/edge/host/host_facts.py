"""Reads facts of the computer: clock, limits, governors, disk."""

from __future__ import annotations

import resource
import shutil
import time
from contextlib import suppress
from pathlib import Path

GOVERNORS = "devices/system/cpu/cpu*/cpufreq/scaling_governor"
CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23


def clock_step_s() -> float:
    """Resolution of the monotonic clock."""
    return time.get_clock_info("monotonic").resolution


def limit(which: int) -> float:
    """The soft limit; inf for none."""
    soft = resource.getrlimit(which)[0]
    return float("inf") if soft == resource.RLIM_INFINITY else float(soft)


def has_capability(bit: int, status: Path = Path("/proc/self/status")) -> bool:
    """Whether this process has an effective Linux capability; see capabilities(7)."""
    try:
        lines = status.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return False
    effective = next((line.split()[1] for line in lines if line.startswith("CapEff:")), "0")
    return bool(int(effective, 16) >> bit & 1)


def governors(sys_folder: Path = Path("/sys")) -> tuple[str, ...]:
    """The frequency governors of all cores that have one."""
    names = []
    for file in sorted(sys_folder.glob(GOVERNORS)):
        with suppress(OSError):
            names.append(file.read_text(encoding="ascii").strip())
    return tuple(names)


def disk_free(folder: Path) -> tuple[int, Path]:
    """Bytes free where folder is, or would be made, and which existing folder that is below."""
    folder = folder.resolve()
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free, folder
