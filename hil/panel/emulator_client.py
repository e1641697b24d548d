"""Faults in the emulator by its command socket: one line there, one line back. See docs/how-to/inject-a-fault.md."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Mapping

from hil.core.fault_kinds import FaultKind
from hil.panel.entry_forms import EntryError

ANSWER_S = 5.0
LINE_MAX = 1 << 16
COMPONENTS = {
    "pump": "pump",
    "valve": "valve",
    "reservoir": "reservoir",
    "tank": "tank",
    "sensor": "level",
    "frame": "frames",
    "bus": "bus",
    "node": "node",
}
"""What a kind acts on -> the emulator's word for it."""
NAMES = {"-i": "target", "-v": "value", "-r": "ramp", "-t": "end"}
INSTANCES = {"pump": 2, "valve": 2, "reservoir": 1, "tank": 4, "sensor": 4, "frame": 1, "bus": 1, "node": 2}


class EmulatorClient:
    """Sends commands to the emulator. where : path of a Unix socket, or the number of a TCP port on 127.0.0.1."""

    def __init__(self, where: str) -> None:
        self.where = where

    async def command(self, line: str) -> str:
        """The answer: "ok ..." or "error: ..."."""
        try:
            return await asyncio.wait_for(self._command(line), ANSWER_S)
        except TimeoutError:
            return f"error: the emulator has not answered within {ANSWER_S:g} s"
        except (OSError, ValueError) as error:
            return f"error: no emulator at {self.where}: {getattr(error, 'strerror', None) or error}"

    async def _command(self, line: str) -> str:
        if self.where.isdecimal():
            reader, writer = await asyncio.open_connection("127.0.0.1", int(self.where), limit=LINE_MAX)
        else:
            reader, writer = await asyncio.open_unix_connection(self.where, limit=LINE_MAX)
        try:
            writer.write(line.encode() + b"\n")
            answer = (await reader.readline()).decode("utf-8", "replace").strip()
        finally:
            writer.close()
        return answer or "error: the emulator has closed the connection"


def value_words(kind: FaultKind, help_line: str) -> str:
    """What the emulator's help says of the value of a kind, such as "0 .. 1 share of the flow; -r"; "" for none."""
    found = re.search(rf"[ ,]{re.escape(kind)} \(-v ([^)]*)\)", help_line)
    return found[1] if found else ""


def inject_command(kind: FaultKind, typed: Mapping[str, str]) -> str:
    """The command for a kind and what was typed, by option: target -i, value -v, ramp -r, end -t. Raises EntryError.

    Empty fields are left out. The emulator checks the value itself, and its answer says what is wrong.
    """
    target, highest = typed.get("-i", "").strip(), INSTANCES[kind.acts_on]
    if target and not (target.isdecimal() and 0 <= int(target) <= highest):
        raise EntryError(f"target {target}: must be 1 to {highest}, or 0 for all")
    words = ["failure", COMPONENTS[kind.acts_on], str(kind)]
    for option, text in typed.items():
        if text.strip():
            words += [option, f"{_number(NAMES[option], text.strip()):g}"]
    return " ".join(words)


def end_command(kind: FaultKind) -> str:
    """The command that ends every fault of what a kind acts on."""
    return f"failure {COMPONENTS[kind.acts_on]} ok"


def _number(name: str, text: str) -> float:
    try:
        number = float(text.replace(",", "."))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise EntryError(f"{name} {text}: must be a number")
    return number
