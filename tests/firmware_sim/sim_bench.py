"""Helpers of the emulator's tests: paths, settings with changed keys, command frames."""

import io
import struct
import subprocess
import sys
import tomllib
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from can import Message

from firmware_sim import cli
from firmware_sim.frames import COMMAND_ID, sealed
from firmware_sim.settings import EmulatorSettings, load

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
GOLDEN = tomllib.loads((ROOT / "tests/golden/frames.toml").read_text())["frame"]
MS = 1_000_000
SECOND = 1_000_000_000


def run_emulator(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """The command, called in this process as its console script does."""
    words, out, err = ["firmware-sim", *map(str, arguments)], io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as ending:
            cli.main()
    code = ending.value.code
    assert isinstance(code, int)
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())


def emulator(**tables: dict[str, Any]) -> EmulatorSettings:
    """emulator.toml of the project with some keys changed: emulator(pumps={"lag_s": 0.0})."""
    values = tomllib.loads((CONFIG / "emulator.toml").read_text())
    for table, keys in tables.items():
        values[table] |= keys
    return EmulatorSettings.model_validate(values)


def shipped() -> EmulatorSettings:
    return load(CONFIG / "emulator.toml")[0]


def command_bytes(
    v1: float = 0.0,
    v2: float = 0.0,
    *,
    enable: bool = True,
    clear: bool = False,
    counter: int = 0,
    starts: bool = False,
) -> bytes:
    flags = enable | clear << 1 | starts << 2 | counter << 4
    return sealed(COMMAND_ID, struct.pack("<HHB", round(v1 * 5000), round(v2 * 5000), flags))


def frame_of(data: bytes, can_id: int = COMMAND_ID, **kind: Any) -> Message:
    return Message(arbitration_id=can_id, data=data, **({"is_extended_id": False} | kind))


def command(v1: float = 0.0, v2: float = 0.0, **flags: Any) -> Message:
    return frame_of(command_bytes(v1, v2, **flags))
