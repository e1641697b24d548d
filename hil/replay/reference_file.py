"""A reference: what a controller made of a record, kept beside it as text, so that a later one is compared with that.

Frames of a rig can't be made again. When a change of behaviour is wanted, the reference says so from then on.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hil.core.counted import counted
from hil.edge.record.file_writing import write_atomically
from hil.replay.command_difference import COMPARED
from hil.replay.frame_log import ReplayError
from hil.review.alarms import Finding
from hil.version import __version__
from hil.wire.contract import Contract

FORMAT = 1


@dataclass(frozen=True, eq=False)
class ReplayReference:
    """payloads : of each step, counter 0; b"" where nothing was sent. version : of the program that made it."""

    payloads: tuple[bytes, ...]
    alarms: tuple[Finding, ...]
    version: str


def reference_path(record: Path) -> Path:
    """Where the reference of a run folder or log is kept."""
    return record / "reference.json" if record.is_dir() else record.with_name(record.name + ".reference.json")


def read_reference(path: Path, contract: Contract, steps: int) -> ReplayReference | None:
    """None if there is none. steps : of the record. Raises ReplayError for one that does not fit."""
    if not path.is_file():
        return None
    layout = contract.frames["PumpCommand"]
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
        if raw["format"] != FORMAT:
            raise ReplayError(f"{path} has format {raw['format']}, this program reads {FORMAT}")
        payloads = tuple(
            layout.encode({**dict(zip(COMPARED, row, strict=True)), "Counter": 0.0}) if row else b""
            for row in raw["commands"]
        )
        alarms = tuple(_finding(one) for one in raw["alarms"])
        version = str(raw["version"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        if isinstance(error, ReplayError):
            raise
        raise ReplayError(f"{path} is no reference of a replay: {error}; --update makes a new one") from None
    if len(payloads) != steps:
        raise ReplayError(
            f"{path} is of another record: it has {counted(len(payloads), 'step')}, the record {steps}; "
            "--update makes a new one"
        )
    return ReplayReference(payloads, alarms, version)


def write_reference(path: Path, contract: Contract, payloads: Sequence[bytes], alarms: Sequence[Finding]) -> None:
    """Replace the reference; a line for each command, so that a comparison of versions shows what has changed.

    Raises IncompleteRecordError.
    """
    layout = contract.frames["PumpCommand"]
    rows = []
    for payload in payloads:
        values = layout.decode(payload) if payload else None
        rows.append(json.dumps([] if values is None else [_short(values[name]) for name in COMPARED]))
    head = {"format": FORMAT, "version": __version__, "signals": COMPARED, "alarms": [asdict(one) for one in alarms]}
    text = json.dumps(head, indent=1)[:-2] + ',\n "commands": [\n' + ",\n".join(rows) + "\n]}\n"
    write_atomically(path, text)


def _short(value: float) -> float:
    return round(value, 6)


def _finding(raw: dict[str, Any]) -> Finding:
    names = ("candidates", "first_candidates")
    return Finding(**{**raw, **{name: tuple(raw[name]) for name in names}})
