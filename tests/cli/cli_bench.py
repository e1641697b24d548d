"""Helpers of the command-line tests: scenarios, changed configurations, commands called in this process."""

import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

import firmware_sim.cli
import hil.cli.app

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
BIN = Path(sys.executable).parent
MAINS = {"hil": hil.cli.app.main, "firmware-sim": firmware_sim.cli.main}


@dataclass(frozen=True)
class Result:
    """What a command left: exit code, both outputs."""

    code: int
    out: str
    err: str


def scenario_text(*, duration: str = "20.0", name: str = "short", more: str = "") -> str:
    head = f'[scenario]\nname = "{name}"\nduration_s = {duration}\n'
    return more if "[scenario]" in more else f"{head}{more}"


def config_copy(folder: Path, *, file: str = "", old: str = "", new: str = "") -> Path:
    """The shipped configuration with one piece of one file replaced; the piece must be there."""
    copy = shutil.copytree(CONFIG, folder)
    if file:
        path = copy / file
        text = path.read_text()
        assert old in text, f"{old!r} is not in {file}"
        path.write_text(text.replace(old, new, 1))
    return copy


def run_script(name: str, *arguments: str | Path | int, timeout_s: float = 60.0) -> Result:
    """The real console script in its own process."""
    done = subprocess.run(
        [BIN / name, *map(str, arguments)], capture_output=True, text=True, timeout=timeout_s, check=False
    )
    return Result(done.returncode, done.stdout, done.stderr)


def assert_refused(result: Result, *named: str | Path) -> None:
    """Exit code 2 and one plain line on stderr that names all of this."""
    assert result.code == 2, result
    assert re.fullmatch(r"(hil|firmware-sim): [^\n]+\n", result.err), result.err
    for what in named:
        assert str(what) in result.err
    assert len(result.err) < 600, "a line for people"


@dataclass
class CommandLine:
    """Calls a command's main() as its console script does."""

    monkeypatch: pytest.MonkeyPatch
    capfd: pytest.CaptureFixture[str]

    def __call__(self, name: str, *arguments: str | Path | int) -> Result:
        self.monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        self.capfd.readouterr()
        with pytest.raises(SystemExit) as ending:
            MAINS[name]()
        code = ending.value.code
        assert code is None or isinstance(code, int), code
        return Result(0 if code is None else code, *self.capfd.readouterr())
