"""Soft real time for the control loop's thread, as far as the system grants it.

    SCHED_FIFO      before every ordinary process; what the thread starts is ordinary again
    memory locked   no page of the process is fetched from a disk, present or future
    one processor   if wanted
    gc frozen       objects of the start-up are not searched again; the others now and then, after a step

What is refused is one line that names the privilege and how to grant it; the run goes on without. Everything is given
back at the end, so that the report is not drawn before all other processes.
"""

from __future__ import annotations

import ctypes
import gc
import os
import resource
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from hil.core.errors import HilError

DEFAULT_PRIORITY = 80
"""Above every ordinary process and Linux's threaded interrupts (50), below its watchdogs and migration (99)."""

STEPS_PER_COLLECTION = 256

MCL_CURRENT, MCL_FUTURE = 1, 2
CAP_IPC_LOCK = 14


@dataclass(frozen=True, slots=True)
class RealTime:
    """What to ask for. priority : of SCHED_FIFO, 1..99. cpu : the processor to stay on; None: any."""

    priority: int = DEFAULT_PRIORITY
    cpu: int | None = None


class RealTimeError(HilError, ValueError):
    """A request that no privilege makes possible."""


def parse_request(is_wanted: bool, priority: int | None, cpu: int | None) -> RealTime | None:
    """What the command line asks for, checked. Raises RealTimeError for a priority or processor that there is not.

    numpy, loaded afterwards, starts no threads of its own: matrices of six rows gain nothing by them.
    """
    if not is_wanted:
        if priority is not None or cpu is not None:
            raise RealTimeError("--priority and --cpu belong to --realtime")
        return None
    wanted = RealTime(DEFAULT_PRIORITY if priority is None else priority, cpu)
    _check(wanted)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return wanted


def _check(wanted: RealTime) -> None:
    low, high = os.sched_get_priority_min(os.SCHED_FIFO), os.sched_get_priority_max(os.SCHED_FIFO)
    if not low <= wanted.priority <= high:
        raise RealTimeError(f"--priority {wanted.priority} is outside {low}..{high}")
    if wanted.cpu is not None and not _may_run_on(wanted.cpu):
        allowed = [cpu for cpu in range(os.cpu_count() or 1) if _may_run_on(cpu)]
        raise RealTimeError(f"--cpu {wanted.cpu} is not one of this process's processors: {_listed(allowed)}")


def _may_run_on(cpu: int) -> bool:
    """Whether the system lets this thread run there: one that is kept free (`isolcpus`) is not among its own now."""
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {cpu})
    except (OSError, ValueError, OverflowError):
        return False
    os.sched_setaffinity(0, before)
    return True


@dataclass(slots=True)
class Applied:
    """What the system granted. refusals : one line each. housekeeping : to be called after each step."""

    refusals: tuple[str, ...]
    steps: int = 0

    def housekeeping(self) -> None:
        """Collect garbage once in `STEPS_PER_COLLECTION` calls; it takes some 50 us, since few objects are new."""
        self.steps += 1
        if self.steps % STEPS_PER_COLLECTION == 0:
            gc.collect()


@contextmanager
def applied(wanted: RealTime) -> Iterator[Applied]:
    """Real time for the calling thread while the context lasts."""
    with ExitStack() as stack:
        refusals = [
            _stay_on(wanted.cpu, stack),
            _lock_memory(stack),
            _schedule(wanted.priority, stack),
        ]
        _freeze(stack)
        yield Applied(tuple(refusal for refusal in refusals if refusal))


def _schedule(priority: int, stack: ExitStack) -> str:
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        return (
            f"no SCHED_FIFO {priority}: CAP_SYS_NICE, or an RLIMIT_RTPRIO of {priority} (ulimit -r; it is "
            f"{resource.getrlimit(resource.RLIMIT_RTPRIO)[0]}), is missing; grant it with '@GROUP - rtprio {priority}' "
            f"in /etc/security/limits.d, or LimitRTPRIO={priority} of a systemd unit; going on without"
        )
    stack.callback(os.sched_setscheduler, 0, policy, parameters)
    return ""


def _lock_memory(stack: ExitStack) -> str:
    """Lock all pages. Under a finite limit it is not tried: the lock might hold now and an allocation fail later."""
    if not _may_lock_any():
        limit_kB = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] // 1024
        return (
            f"memory not locked: CAP_IPC_LOCK, or an unlimited RLIMIT_MEMLOCK (ulimit -l; it is {limit_kB} kB), is "
            "missing; grant it with '@GROUP - memlock unlimited' in /etc/security/limits.d, or LimitMEMLOCK=infinity "
            "of a systemd unit; going on without"
        )
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
        return f"memory not locked: {os.strerror(ctypes.get_errno())}; going on without"
    stack.callback(libc.munlockall)
    return ""


def _stay_on(cpu: int | None, stack: ExitStack) -> str:
    if cpu is None:
        return ""
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError as error:
        return f"not bound to processor {cpu}: {error.strerror}; going on without"
    stack.callback(os.sched_setaffinity, 0, before)
    return ""


def _freeze(stack: ExitStack) -> None:
    """Collect once, exclude the existing objects from later searches, and search only on request."""
    gc.collect()
    gc.freeze()
    stack.callback(gc.unfreeze)
    if gc.isenabled():
        gc.disable()
        stack.callback(gc.enable)


def _may_lock_any() -> bool:
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        return True
    try:
        status = Path("/proc/self/status").read_text(encoding="utf-8")
    except OSError:
        return False
    effective = next((line.split()[1] for line in status.splitlines() if line.startswith("CapEff:")), "0")
    return bool(int(effective, 16) >> CAP_IPC_LOCK & 1)


def _listed(numbers: list[int]) -> str:
    return ", ".join(str(number) for number in numbers)
