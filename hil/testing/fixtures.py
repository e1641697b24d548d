"""Fixtures for tests of a bench: `bench`, `emulator`, `run`. They exist where the plugin is on."""

from __future__ import annotations

import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import pytest

import hil
from hil.edge.config.settings_file import SettingsError

BEGIN_S = 60.0
"""How long a loaded machine may take to start the emulator."""
END_S = 5.0

BenchLoader = Callable[..., hil.Bench]
EmulatorStarter = Callable[..., "RunningEmulator"]
Runner = Callable[..., hil.RunResult]


@dataclass(frozen=True)
class RunningEmulator:
    """A firmware-sim in a process of its own: where it is reached, in python-can's words."""

    interface: str
    channel: str


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> BenchLoader:
    """`bench(scenario, ...)`: what `hil.load` takes and gives; files are looked for beside the test first."""
    folder = request.path.parent

    def load(scenario: str | Path, **how: object) -> hil.Bench:
        return hil.load(_beside(folder, scenario), **how)  # type: ignore[arg-type]

    return load


@pytest.fixture
def emulator(request: pytest.FixtureRequest) -> Iterator[EmulatorStarter]:
    """`emulator(scenario=None, rig=None, seed=1)`: starts firmware-sim on a pseudo-terminal; it ends with the test.

    scenario : whose faults it plays.
    """
    folder = request.path.parent
    with ExitStack() as stack:

        def start(scenario: str | Path | None = None, rig: str | Path | None = None, seed: int = 1) -> RunningEmulator:
            options = ["--pty", "--seed", str(seed)]
            options += [] if scenario is None else ["--scenario", str(_beside(folder, scenario))]
            options += [] if rig is None else ["--rig", str(_beside(folder, rig))]
            process = subprocess.Popen(  # noqa: S603 - ourselves
                [sys.executable, "-m", "firmware_sim", *options],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.callback(_end, process)
            return RunningEmulator("slcan", _channel(process))

        yield start


@pytest.fixture
def run(bench: BenchLoader, tmp_path: Path) -> Runner:
    """`run(scenario, on=None, ...)`: a run in lockstep, or in real time on what `emulator` gave.

    scenario : a file beside the test, a shipped name, or what `bench` gave. The others are those of `hil.simulate`, and
    of `hil.run` with `on`. The run in real time leaves its folder in `tmp_path`.
    """
    numbers = count(1)

    def make(scenario: str | Path | hil.Bench, on: RunningEmulator | None = None, **how: object) -> hil.RunResult:
        given = scenario if isinstance(scenario, hil.Bench) else bench(scenario)
        if on is None:
            return hil.simulate(given, **how)  # type: ignore[arg-type]
        out = tmp_path / f"run{next(numbers)}"
        where = {"interface": on.interface, "channel": on.channel}
        return hil.run(given, **{"out": out, **where, **how})  # type: ignore[arg-type]

    return make


def _beside(folder: Path, file: str | Path) -> str | Path:
    """The file beside the test, if there is one; otherwise what was given: a path, or a shipped name."""
    path = folder / file
    return path if path.is_file() else file


def _channel(process: subprocess.Popen[str]) -> str:
    """The emulator's channel, from the line that it writes when it is ready. Raises SettingsError."""
    line = ""
    if process.stdout is not None and select.select([process.stdout], [], [], BEGIN_S)[0]:
        line = process.stdout.readline()
    if "ready: slcan on " not in line:
        process.kill()
        _, error = process.communicate()
        raise SettingsError(f"the emulator did not start: {error.strip()}")
    return line.split()[-1]


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.communicate(timeout=END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
