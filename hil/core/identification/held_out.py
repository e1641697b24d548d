"""Which records are fitted, and which are held out to judge what the fit gave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import nan

from hil.core.identification.records import LevelRecord
from hil.core.types import Quad

TRAINING_SHARE = 0.7


def split(
    records: tuple[LevelRecord, ...], held_out: Sequence[LevelRecord] | LevelRecord | None
) -> tuple[tuple[LevelRecord, ...], tuple[LevelRecord, ...]]:
    """The records to fit and the held-out ones.

    held_out : None: the last record, or the last 30 % of the only one.
    """
    if isinstance(held_out, LevelRecord):
        return records, (held_out,)
    if held_out is not None:
        return records, tuple(held_out)
    if not records:
        return (), ()
    if len(records) > 1:
        return records[:-1], records[-1:]
    first, second = _cut(records[0])
    return (first,), (second,)


def _cut(record: LevelRecord) -> tuple[LevelRecord, LevelRecord]:
    """A record's beginning to learn from, and its end to judge by."""
    n = len(record.time_s)
    at = min(max(int(TRAINING_SHARE * n), 2), n - 2)
    cut_s = float(record.time_s[at])

    def part(rows: slice, name: str, initial_cm: Quad, is_first: bool) -> LevelRecord:
        return replace(
            record,
            name=name,
            time_s=record.time_s[rows],
            voltage_V=record.voltage_V[rows],
            reading_V=record.reading_V[rows],
            samples=None if record.samples is None else record.samples[rows],
            initial_cm=initial_cm,
            ruler=tuple(read for read in record.ruler if (read.time_s < cut_s) == is_first),
        )

    if n < 4:
        return record, record
    return (
        part(slice(0, at), record.name, record.initial_cm, True),
        part(slice(at, n), f"{record.name}, held out", (nan, nan, nan, nan), False),
    )
