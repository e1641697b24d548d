"""Runs tests against mutants: one process imports all that a mutant can't change, a fork of it judges each mutant."""

from __future__ import annotations

import ast
import contextlib
import gc
import importlib
import io
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib.abc import InspectLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import resolve_name, spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest

from tools.mutants.generate import Mutant

MAX_TEST_CPU_S, MAX_TEST_S, MAX_MUTANT_S = 90.0, 300.0, 1800.0
"""A mutant is killed by the clock when one test, or all of them, take longer; the slowest test takes 15 s."""

UNUSED = ("junitxml", "pastebin", "doctest", "stepwise", "setuponly", "setupplan", "faulthandler", "legacypath")
"""Plugins of pytest that no test needs to judge a mutant; each fork would set them up."""
OPTIONS = (
    "-x", "-q", "--tb=no", "--assert=plain", "--capture=no", "--no-header", "-W", "ignore",
    *("-p", "no:cacheprovider"), *("-p", "no:unraisableexception"), *("-p", "_hypothesis_pytestplugin"),
    *("-m", "not live and not long and not socketcan"),
    *(word for plugin in UNUSED for word in ("-p", f"no:{plugin}")),
)  # fmt: skip
POLL_S = 0.005
LIKELY = 6
"""So many of the tests that have killed mutants of a module are tried first on the next one."""
OURS = frozenset({"hil", "firmware_sim", "tests"})
TIMED_OUT_EXIT = 99


class Fate(Enum):
    """What became of a mutant."""

    KILLED = "killed"
    TIMED_OUT = "timed out"
    SURVIVED = "survived"


@dataclass(frozen=True)
class Judgement:
    """A mutant's fate, and the test that failed on it ("" if none did)."""

    fate: Fate
    killer: str = ""


@dataclass(frozen=True)
class Target:
    """The module to change and the test files to run in this order, by their paths below root.

    needs_compiler : whether numba compiles code of this module, which then must not come from its cache.
    """

    root: Path
    module: str
    tests: tuple[str, ...]
    needs_compiler: bool = False

    @property
    def path(self) -> Path:
        """The module's file."""
        return self.root / f"{self.module.replace('.', '/')}.py"


def unchanged(target: Target) -> Mutant:
    """The module as it is, to see whether its tests pass at all."""
    return Mutant("none", 0, "", "", target.path.read_text(encoding="utf-8"))


@dataclass(frozen=True)
class _Fork:
    """A fork that judges a mutant: its place in the list, its start, and the pipe on which it names the failed test."""

    number: int
    process: int
    started_s: float
    pipe: int


def run_all(
    work: Sequence[tuple[Target, Mutant]], jobs: int, on_survivor: Callable[[Target, Mutant], None] | None = None
) -> list[Judgement]:
    """The judgement on each mutant, `jobs` at a time, in the order given. on_survivor : is called for each at once."""
    _preload({(target.root, test.partition("::")[0]) for target, _ in work for test in target.tests})
    gc.collect()
    gc.freeze()  # a fork that searches all that was imported for garbage takes twice as long
    judgements = [Judgement(Fate.SURVIVED)] * len(work)
    killers: dict[Target, dict[str, int]] = {}  # by test: the line of the last mutant that it has killed
    running: list[_Fork] = []
    waiting = list(range(len(work) - 1, -1, -1))
    while waiting or running:
        while waiting and len(running) < jobs:
            target, mutant = work[waiting[-1]]
            running.append(_forked(waiting.pop(), target, mutant, _likely(killers.get(target, {}), mutant.line)))
        for fork in list(running):
            fate = _poll(fork)
            if fate is not None:
                target, mutant = work[fork.number]
                with os.fdopen(fork.pipe, encoding="utf-8") as pipe:
                    judgements[fork.number] = Judgement(fate, pipe.readline().rstrip("\n"))
                running.remove(fork)
                if "::" in (killer := judgements[fork.number].killer):
                    killers.setdefault(target, {})[killer] = mutant.line
                if on_survivor is not None and fate is Fate.SURVIVED:
                    on_survivor(target, mutant)
        time.sleep(POLL_S)
    return judgements


def _likely(killers: dict[str, int], line: int) -> list[str]:
    """The tests that have killed the mutants of the nearest lines: most of them kill this one, too."""
    return sorted(killers, key=lambda test: abs(killers[test] - line))[:LIKELY]


def _forked(number: int, target: Target, mutant: Mutant, likely: Sequence[str]) -> _Fork:
    read_end, write_end = os.pipe()
    process = os.fork()
    if not process:
        _judge(target, mutant, likely, write_end)
    os.close(write_end)
    return _Fork(number, process, time.monotonic(), read_end)


def _preload(tests: set[tuple[Path, str]]) -> None:
    """Import the tests, and with them all that they need. Their examples are the same ones in each process."""
    from hypothesis import settings

    settings.register_profile("mutants", derandomize=True, database=None, deadline=None)
    settings.load_profile("mutants")
    for root, test in sorted(tests):
        if str(root) not in sys.path:
            sys.path.insert(0, str(root))
        importlib.import_module(test.removesuffix(".py").replace("/", "."))
    for name in [name for name in sys.modules if name.partition(".")[0] in OURS]:
        _imports(name)  # kept for the forks
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        pytest.main([*OPTIONS, "--version"])  # imports the plugins of pytest


def _judge(target: Target, mutant: Mutant, likely: Sequence[str], pipe: int) -> None:
    """In a fork: run the tests on the mutant, and exit with 0 when all pass; name the one that fails on the pipe.

    likely : tests to run before all others. What is no test of this mutant's any more is no verdict.
    """
    os.setpgid(0, 0)
    quiet = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(quiet, descriptor)
    code, cache = 1, ""
    try:
        if target.needs_compiler:
            cache = tempfile.mkdtemp(prefix="mutant-")
            _use_compiler_cache(cache)
        _forget(target)
        sys.meta_path.insert(0, _Changed(target, mutant.code))
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # a search through all that is installed, for each mutant
        code = _run(target, likely, pipe) if likely else 0
        if code in (0, pytest.ExitCode.USAGE_ERROR):
            for tests in _in_turn(target.tests):
                code = _run(target, tests, pipe)
                if code != 0:
                    break
    finally:
        if cache:
            shutil.rmtree(cache, ignore_errors=True)
        os._exit(0 if code == 0 else 1)


def _run(target: Target, tests: Sequence[str], pipe: int) -> int:
    """Run these tests up to the first that fails; pytest's exit code, 0 where there are none."""
    options = [*OPTIONS, "-c", str(target.root / "pyproject.toml")]
    plugins = [_Watcher(pipe), *([OnlyThese(tests)] if all("::" in test for test in tests) else [])]
    code = int(pytest.main([*options, *(str(target.root / test) for test in tests)], plugins))
    return 0 if code == pytest.ExitCode.NO_TESTS_COLLECTED else code


def _in_turn(tests: Sequence[str]) -> Iterator[Sequence[str]]:
    """The first file, then two, four ...: most mutants fail in the first, and need not wait until all are imported.

    Tests named one by one stay together.
    """
    if any("::" in test for test in tests):
        yield tests
        return
    start, size = 0, 1
    while start < len(tests):
        yield tests[start : start + size]
        start, size = start + size, 2 * size


def _use_compiler_cache(folder: str) -> None:
    import numba

    numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]  # set at import, from the environment


class _Watcher:
    """A plugin of pytest: names the test that fails, and ends the process when a test takes too long."""

    def __init__(self, pipe: int) -> None:
        self._pipe = pipe

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A test has failed, in itself or in its fixtures."""
        if report.failed:
            self._name(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A file could not be imported."""
        if report.failed:
            self._name(report.nodeid)

    def _name(self, failed: str) -> None:
        os.write(self._pipe, f"{failed}\n".encode())

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self) -> None:
        """Start the time of the next test."""
        for number, timer, limit_s in (
            (signal.SIGPROF, signal.ITIMER_PROF, MAX_TEST_CPU_S),
            (signal.SIGALRM, signal.ITIMER_REAL, MAX_TEST_S),
        ):
            signal.signal(number, lambda _number, _frame: os._exit(TIMED_OUT_EXIT))
            signal.setitimer(timer, limit_s)


class OnlyThese:
    """A plugin of pytest for tests named one by one: makes no others of their files, one of which has a thousand.

    Of a class that is named it makes all tests, and of a function those of all its parameters.
    """

    def __init__(self, tests: Sequence[str]) -> None:
        self._names = {test.split("::")[1].partition("[")[0] for test in tests}

    @pytest.hookimpl(tryfirst=True)
    def pytest_pycollect_makeitem(self, collector: pytest.Module | pytest.Class, name: str) -> list[pytest.Item] | None:
        """No tests of what has another name; None leaves it to pytest."""
        return None if isinstance(collector, pytest.Class) or name in self._names else []


def _forget(target: Target) -> None:
    """Drop the module and all that imports it, directly or not, so that the fork imports it again; the tests too."""
    ours = {name for name in list(sys.modules) if name.partition(".")[0] in OURS}
    tests = {test.partition("::")[0] for test in target.tests}
    tainted = {target.module} | {test.removesuffix(".py").replace("/", ".") for test in tests}
    while more := {name for name in ours - tainted if not tainted.isdisjoint(_imports(name))}:
        tainted |= more
    if target.module != "hil":  # a new `hil` would lack the submodules that stay; what it has loaded goes
        tainted.discard("hil")
        for name in getattr(sys.modules.get("hil"), "__all__", ()):
            if not name.startswith("_"):
                vars(sys.modules["hil"]).pop(name, None)
    for name in tainted:
        sys.modules.pop(name, None)
        parent, _, leaf = name.rpartition(".")
        if parent in sys.modules:  # "from parent import leaf" would find it there
            vars(sys.modules[parent]).pop(leaf, None)


@cache
def _imports(name: str) -> frozenset[str]:
    """Full names of what a module imports anywhere; an imported name may be a module or something in one: both."""
    file = getattr(sys.modules.get(name), "__file__", None)
    if not file:
        return frozenset()
    found: set[str] = set()
    for node in ast.walk(ast.parse(Path(file).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = name if Path(file).name == "__init__.py" else name.rpartition(".")[0]
            base = resolve_name("." * node.level + (node.module or ""), package) if node.level else node.module or ""
            found |= {base} | {f"{base}.{alias.name}" for alias in node.names}
    return frozenset(found)


def _poll(fork: _Fork) -> Fate | None:
    done, status = os.waitpid(fork.process, os.WNOHANG)
    if done:
        code = os.waitstatus_to_exitcode(status)
        _kill_group(fork.process)
        return Fate.SURVIVED if code == 0 else Fate.TIMED_OUT if code == TIMED_OUT_EXIT else Fate.KILLED
    if time.monotonic() - fork.started_s > MAX_MUTANT_S:
        _kill_group(fork.process)
        os.waitpid(fork.process, 0)
        return Fate.TIMED_OUT
    return None


def _kill_group(process: int) -> None:
    """End the fork and the programs that its tests have started and not ended."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process, signal.SIGKILL)


class _Changed(MetaPathFinder, InspectLoader):
    """An importer that has the changed code for one module."""

    def __init__(self, target: Target, code: str) -> None:
        self._target, self._code = target, code

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:  # noqa: ARG002 - the protocol
        """The changed module, and no other."""
        if fullname != self._target.module:
            return None
        return spec_from_loader(fullname, self, origin=str(self._target.path))

    def get_source(self, fullname: str) -> str:  # noqa: ARG002 - the protocol
        """The changed code."""
        return self._code

    def exec_module(self, module: ModuleType) -> None:
        """Run the changed code."""
        module.__file__ = str(self._target.path)
        exec(compile(self._code, str(self._target.path), "exec"), vars(module))  # noqa: S102 - our own module
