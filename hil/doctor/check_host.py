"""The computer: clock, scheduling rights, disk space. The values read from it are passed in as `HostFacts`."""

from __future__ import annotations

from dataclasses import dataclass

from hil.probe.check_result import Result, failed, not_checked, passed, warned

MAX_CLOCK_STEP_S = 1e-6
MIN_LOCKED_BYTES = 512 * 2**20
"""Sufficient for the controller with its libraries."""
DISK_WARN_BYTES, DISK_FAIL_BYTES = 2**30, 64 * 2**20


@dataclass(frozen=True, slots=True)
class HostFacts:
    """clock_step_s : resolution of the monotonic clock. rtprio, memlock_bytes : limits of this user; inf for none.

    is_nice, may_lock : whether a capability removes the limit. governors : of all cores that report one.
    disk_free_bytes : free below disk_folder, where runs are recorded.
    """

    clock_step_s: float
    rtprio: float
    memlock_bytes: float
    is_nice: bool
    may_lock: bool
    governors: tuple[str, ...]
    disk_free_bytes: int
    disk_folder: str


def check_host(facts: HostFacts) -> list[Result]:
    """All checks of the computer."""
    return [_clock(facts), _rtprio(facts), _memlock(facts), _governor(facts), _disk(facts)]


def _clock(facts: HostFacts) -> Result:
    check, found = "monotonic clock", f"steps of {facts.clock_step_s * 1e9:g} ns"
    if facts.clock_step_s > MAX_CLOCK_STEP_S:
        return warned(check, found, "boot a kernel with high-resolution timers")
    return passed(check, found)


def _rtprio(facts: HostFacts) -> Result:
    check = "real-time priority"
    if facts.is_nice:
        return passed(check, "allowed (CAP_SYS_NICE)")
    if facts.rtprio < 1:
        advice = "for SCHED_FIFO: '@realtime - rtprio 80' in /etc/security/limits.d, join the group, log in again"
        return warned(check, "not allowed (RLIMIT_RTPRIO 0)", advice)
    return passed(check, f"up to {facts.rtprio:g}")


def _memlock(facts: HostFacts) -> Result:
    check = "locked memory"
    if facts.may_lock or facts.memlock_bytes == float("inf"):
        return passed(check, "unlimited")
    found = f"up to {facts.memlock_bytes / 2**20:.0f} MiB"
    if facts.memlock_bytes < MIN_LOCKED_BYTES:
        advice = "for mlockall: '@realtime - memlock unlimited' in /etc/security/limits.d, log in again"
        return warned(check, found, advice)
    return passed(check, found)


def _governor(facts: HostFacts) -> Result:
    check = "CPU governor"
    if not facts.governors:
        return not_checked(check, "this kernel reports none")
    found = ", ".join(sorted(set(facts.governors)))
    if set(facts.governors) != {"performance"}:
        return warned(check, found, "for steady wake-ups: cpupower frequency-set -g performance")
    return passed(check, found)


def _disk(facts: HostFacts) -> Result:
    check, found = "disk space", f"{facts.disk_free_bytes / 2**30:.1f} GiB free below {facts.disk_folder}"
    if facts.disk_free_bytes < DISK_FAIL_BYTES:
        return failed(check, found, "a run would lose its record: make room, or use --out elsewhere")
    if facts.disk_free_bytes < DISK_WARN_BYTES:
        return warned(check, found, "make room before long runs")
    return passed(check, found)
