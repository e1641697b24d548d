"""Runs the tests against mutants: one process loads everything that no mutant can change, a fork takes each mutant."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest

from tools.mutants.generate import Mutant

TIMEOUT_S = 120.0
LEAST_TIMEOUT_S, TIMEOUT_FACTOR = 20.0, 4.0
"""A mutant gets so many times what the unchanged module took."""

OPTIONS = (
    "-x", "-q", "--tb=no", "--assert=plain", "--capture=no", "--no-header", "-W", "ignore",
    *("-p", "no:cacheprovider"), *("-p", "no:xdist"), *("-p", "no:cov"),
)  # fmt: skip
POLL_S = 0.005


class Verdict(Enum):
    """What became of a mutant."""

    KILLED = "killed"
    TIMED_OUT = "timed out"
    SURVIVED = "survived"


@dataclass(frozen=True)
class Bench:
    """The module to change and the tests to run, by their paths below root."""

    root: Path
    module: str
    tests: tuple[str, ...]


def run_all(bench: Bench, mutants: Sequence[Mutant], jobs: int) -> list[Verdict]:
    """The verdict on each, some at a time; file after file of the tests, as long as a mutant survives.

    Raises RuntimeError when the tests fail without any change.
    """
    _preload(bench)
    verdicts = [Verdict.SURVIVED] * len(mutants)
    for test in bench.tests:
        left = [number for number, verdict in enumerate(verdicts) if verdict is Verdict.SURVIVED]
        forks = _Forks(bench, [mutants[number] for number in left], jobs)
        pytest.main([*OPTIONS, "-c", str(bench.root / "pyproject.toml"), str(bench.root / test)], [forks])
        if forks.process == 0:  # a fork, its tests done
            os._exit(0 if forks.passed else 1)
        if not forks.is_sound:
            raise RuntimeError(f"the tests of {bench.module} fail as it is: {test}")
        for number, verdict in zip(left, forks.verdicts, strict=True):
            verdicts[number] = verdict
    return verdicts


class _Forks:
    """A plugin of pytest's: where it would collect the tests, a fork for each mutant goes on to do so."""

    def __init__(self, bench: Bench, mutants: Sequence[Mutant], jobs: int) -> None:
        self._bench, self._mutants, self._jobs = bench, mutants, jobs
        self.verdicts = [Verdict.SURVIVED] * len(mutants)
        self.is_sound = False
        self.process = -1
        self.passed = False

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> bool | None:
        """In the forks go on; in the first process come back when all have ended, with nothing collected."""
        unchanged = (self._bench.root / f"{self._bench.module.replace('.', '/')}.py").read_text(encoding="utf-8")
        started = time.monotonic()
        if self._forked(unchanged):
            return None
        self.is_sound = _wait(self.process, started, TIMEOUT_S) is Verdict.SURVIVED
        timeout_s = max(LEAST_TIMEOUT_S, TIMEOUT_FACTOR * (time.monotonic() - started))
        running: dict[int, tuple[int, float]] = {}
        waiting = list(range(len(self._mutants) - 1, -1, -1)) if self.is_sound else []
        while waiting or running:
            while waiting and len(running) < self._jobs:
                number = waiting.pop()
                if self._forked(self._mutants[number].code):
                    return None
                running[self.process] = number, time.monotonic()
            for process, (number, begun) in list(running.items()):
                verdict = _poll(process, begun, timeout_s)
                if verdict is not None:
                    self.verdicts[number] = verdict
                    del running[process]
            time.sleep(POLL_S)
        return True

    def pytest_sessionfinish(self, exitstatus: int) -> None:
        """Whether every test passed."""
        self.passed = exitstatus == 0

    def _forked(self, code: str) -> bool:
        """Fork; in the fork, which finds this code in place of the module's, True."""
        self.process = os.fork()
        if self.process:
            return False
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        sys.meta_path.insert(0, _Changed(self._bench, code))
        return True


def _preload(bench: Bench) -> None:
    """Import what the tests need; then forget the module and all that was built on it, so that a fork takes it anew."""
    for folder in {str((bench.root / test).parent) for test in bench.tests}:
        sys.path.insert(0, folder)
    names = [Path(test).stem for test in bench.tests]
    for name in names:
        importlib.import_module(name)
    tainted = {bench.module}
    while more := {n for n, m in list(sys.modules.items()) if n not in tainted and _uses(n, m, tainted)}:
        tainted |= more
    for name in tainted | set(names):
        sys.modules.pop(name, None)


def _uses(name: str, module: ModuleType, tainted: set[str]) -> bool:
    """Whether one of ours has anything of a tainted module in its namespace."""
    file = getattr(module, "__file__", None) or ""
    if not (name.startswith(("hil", "firmware_sim")) or "/tests/" in file):
        return False
    for value in vars(module).values():
        home = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
        if home in tainted:
            return True
    return False


def _poll(process: int, started: float, timeout_s: float) -> Verdict | None:
    done, status = os.waitpid(process, os.WNOHANG)
    if done:
        return Verdict.SURVIVED if os.waitstatus_to_exitcode(status) == 0 else Verdict.KILLED
    if time.monotonic() - started > timeout_s:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        return Verdict.TIMED_OUT
    return None


def _wait(process: int, started: float, timeout_s: float) -> Verdict:
    while (verdict := _poll(process, started, timeout_s)) is None:
        time.sleep(POLL_S)
    return verdict


class _Changed(MetaPathFinder, Loader):
    """An importer that has the changed code for one module."""

    def __init__(self, bench: Bench, code: str) -> None:
        self._bench, self._code = bench, code

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:  # noqa: ARG002 - the protocol
        """The changed module, and nothing else."""
        return spec_from_loader(fullname, self) if fullname == self._bench.module else None

    def exec_module(self, module: ModuleType) -> None:
        """Run the changed code."""
        exec(compile(self._code, f"mutant of {self._bench.module}", "exec"), vars(module))  # noqa: S102 - our own module
