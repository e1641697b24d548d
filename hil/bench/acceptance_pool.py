"""Scenarios of a test beside each other, in processes of their own; their verdicts in the order that was asked for.

The processes are those of Python's own library, so that a test needs no Dask: it has a dozen runs and not thousands.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait

from hil.bench.acceptance_run import AcceptanceRun, judge_in_lockstep
from hil.review.judged_scenario import JudgedScenario


def judge_all(asked: Sequence[AcceptanceRun], processes: int) -> Generator[JudgedScenario, None, None]:
    """The verdicts in the order of `asked`, each as soon as those before it are there.

    A process that is killed is the error of its scenario and of those that were not done yet. Whatever ends the loop
    over the verdicts ends the processes.
    """
    context = multiprocessing.get_context("spawn")  # the parent has threads, which a fork would not take along
    pool = ProcessPoolExecutor(min(processes, len(asked)), context, _begin)
    try:
        futures = [pool.submit(judge_in_lockstep, one) for one in asked]
        for one, future in zip(asked, futures, strict=True):
            try:
                yield future.result()
            except BrokenProcessPool:
                error = "a process of the test was killed: this run has no verdict"
                yield JudgedScenario(one.out.name, error=error, folder=one.out if one.out.is_dir() else None)
    finally:
        _end(pool)


def _begin() -> None:
    """In a new process. Ctrl-C is the parent's; a process whose parent is gone ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


def _end(pool: ProcessPoolExecutor) -> None:
    """Nothing is left running, also after an interruption: a run in simulated time moves nothing."""
    running = list((pool._processes or {}).values())  # the library has no public way before 3.14
    pool.shutdown(wait=False, cancel_futures=True)
    for process in running:
        process.terminate()
    for process in running:
        process.join()
