"""Real time for the control loop: applied and given back, or refused with a line that says what is missing."""

import os
import subprocess
import sys

import pytest

from hil.edge.host.clock import MonotonicClock
from hil.edge.host.realtime import RealTime, RealTimeError, parse_request

UNPRIVILEGED = 65534


def may_use_fifo() -> bool:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


needs_fifo = pytest.mark.skipif(not may_use_fifo(), reason="this user may not use SCHED_FIFO (CAP_SYS_NICE)")


@pytest.mark.parametrize("priority", [1, 50, 99])
def test_a_request_within_range_is_taken_as_it_is(priority: int) -> None:
    assert parse_request(True, priority, None) == RealTime(priority, None)
    assert parse_request(True, None, min(os.sched_getaffinity(0))) == RealTime(80, min(os.sched_getaffinity(0)))
    assert parse_request(False, None, None) is None


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((True, 0, None), "--priority 0 is outside 1..99"),
        ((True, 100, None), "--priority 100 is outside 1..99"),
        ((True, None, 4096), "--cpu 4096 is not one of this process's processors: "),
        ((True, None, -1), "--cpu -1 is not one of"),
        ((False, 80, None), "--priority and --cpu belong to --realtime"),
        ((False, None, 0), "--priority and --cpu belong to --realtime"),
    ],
)
def test_a_request_that_no_privilege_allows_is_one_line(
    arguments: tuple[bool, int | None, int | None], says: str
) -> None:
    with pytest.raises(RealTimeError, match=says):
        parse_request(*arguments)


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two processors")
def test_a_processor_that_is_kept_free_can_be_asked_for() -> None:
    """With `isolcpus` no process begins there, and `--cpu` was refused for it."""
    own = os.sched_getaffinity(0)
    others = own - {max(own)}
    os.sched_setaffinity(0, others)
    try:
        assert parse_request(True, None, max(own)) == RealTime(80, max(own))
        assert os.sched_getaffinity(0) == others, "asking moves nothing"
    finally:
        os.sched_setaffinity(0, own)


GRANTED = """
import os, threading
from hil.edge.host import realtime
cpu, before, seen = min(os.sched_getaffinity(0)), os.sched_getaffinity(0), []
with realtime.applied(realtime.RealTime(42, cpu)):
    assert os.sched_getscheduler(0) == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    assert os.sched_getparam(0).sched_priority == 42
    assert os.sched_getaffinity(0) == {cpu}
    thread = threading.Thread(target=lambda: seen.append(os.sched_getscheduler(0)))
    thread.start()
    thread.join()
assert seen == [os.SCHED_OTHER], "what it starts is ordinary"
assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
assert os.sched_getaffinity(0) == before
"""


@needs_fifo
def test_what_is_granted_holds_for_this_thread_and_is_given_back() -> None:
    """In a process of its own: to lock all memory of one that runs other tests takes seconds."""
    done = subprocess.run([sys.executable, "-c", GRANTED], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


GARBAGE = """
import gc
from hil.edge.host import realtime
class Knot:
    def __init__(self):
        self.me = self
with realtime.applied(realtime.RealTime()) as applied:
    assert not gc.isenabled()
    assert gc.get_freeze_count() > 0
    Knot()
    for _ in range(realtime.STEPS_PER_COLLECTION):
        applied.housekeeping()
    assert not [one for one in gc.get_objects() if isinstance(one, Knot)]
assert gc.isenabled()
assert gc.get_freeze_count() == 0
"""


def test_what_was_there_at_the_start_is_not_searched_for_garbage_and_the_rest_is() -> None:
    """In a process of its own: to lock all memory of the tests' process takes seconds."""
    subprocess.run([sys.executable, "-c", GARBAGE], check=True)


@pytest.mark.skipif(os.getuid() != 0, reason="gives privileges up, which only root has")
def test_without_privileges_each_refusal_names_what_is_missing_and_the_run_goes_on() -> None:
    script = (
        "import os, resource\n"
        "from hil.edge.host import realtime\n"
        "resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))\n"
        "resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))\n"
        f"os.setuid({UNPRIVILEGED})\n"
        "with realtime.applied(realtime.RealTime(80)) as applied:\n"
        "    print(*applied.refusals, sep='\\n')\n"
        "    print(os.sched_getscheduler(0) == os.SCHED_OTHER)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    memory, schedule, goes_on = done.stdout.splitlines()
    assert all(word in memory for word in ("CAP_IPC_LOCK", "RLIMIT_MEMLOCK", "64 kB", "memlock unlimited"))
    assert all(word in schedule for word in ("CAP_SYS_NICE", "RLIMIT_RTPRIO of 80", "rtprio 80"))
    assert goes_on == "True"


@pytest.mark.parametrize("ahead_ms", [-5, 0, 1, 20])
def test_the_clock_never_returns_before_a_deadline(ahead_ms: int) -> None:
    clock = MonotonicClock()
    deadline_ns = clock.now_ns() + ahead_ms * 1_000_000
    clock.sleep_until(deadline_ns)
    assert clock.now_ns() >= deadline_ns
