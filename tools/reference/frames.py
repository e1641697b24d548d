"""Page of the frames and signals, from config/bench.dbc."""

from __future__ import annotations

from typing import Any

import cantools

from tools.reference import ROOT
from tools.reference.markdown import code, table


def frames_page() -> str:
    """The whole page."""
    database: Any = cantools.database.load_file(str(ROOT / "config/bench.dbc"), cache_dir=None)
    parts = [
        "# Frames and signals\n\nFrom `config/bench.dbc`. All signals are unsigned and little-endian; bit 0 is the "
        "least significant bit of byte 0. [The wire](wire.md) explains counters, CRCs and checks.\n"
    ]
    for message in database.messages:
        cycle = f", every {message.cycle_time} ms" if message.cycle_time else ""
        parts.append(
            f"\n## {message.name}\n\nIdentifier `0x{message.frame_id:03X}`, {message.length} bytes, sent by "
            f"{code(message.senders[0])}{cycle}. {message.comment or ''}\n\n"
        )
        rows = [_row(signal) for signal in message.signals]
        parts.append(table(("signal", "bits", "step", "range", "unit", "values", "meaning"), rows))
    return "".join(parts)


def _row(signal: Any) -> tuple[str, ...]:
    last = signal.start + signal.length - 1
    bits = str(signal.start) if signal.length == 1 else f"{signal.start}..{last}"
    values = ", ".join(f"{number} {name}" for number, name in sorted((signal.choices or {}).items()))
    limits = f"{_number(signal.minimum)}..{_number(signal.maximum)}"
    return code(signal.name), bits, f"{signal.scale:g}", limits, signal.unit or "–", values, signal.comment or ""


def _number(value: float) -> str:
    return f"{value:g}" if value % 1 else str(int(value))
