"""Frames to signals by a DBC, all frames of an identifier at once; the same numbers as cantools' decode gives.

Positions, byte orders, signs, scales, offsets and value tables are those of the cantools database that is handed in. A
value that has a name in a value table stays a number; `choices` has the names.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from cantools.database.can import Database, Message, Signal

from hil.data.can_log import MAX_DATA, CanLog

Array = npt.NDArray[Any]
Flags = npt.NDArray[np.bool_]

PAYLOAD_BITS = 8 * MAX_DATA
SMALL_BITS = 32


@dataclass(frozen=True, eq=False)
class MessageTable:
    """All frames of one message. `table["Level1"]` is a signal's column.

    name : of the message. rows : (n,) numbers of its frames in the log. time_s : (n,) since the epoch. columns : signal
    name -> (n,) values in the signal's unit: int32 (int64, uint64 where that is too small) for whole numbers, float64
    otherwise; NaN in a frame that does not have a multiplexed signal. units : signal name -> unit, "" for none.
    choices : signal name -> its value table, the column's number -> name. too_short : frames that were left out
    since they have fewer bytes than the DBC says.
    """

    name: str
    rows: npt.NDArray[np.intp]
    time_s: npt.NDArray[np.float64]
    columns: Mapping[str, Array]
    units: Mapping[str, str]
    choices: Mapping[str, Mapping[float, str]]
    too_short: int

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, signal: str) -> Array:
        return self.columns[signal]


def decode(log: CanLog, database: Database, messages: Iterable[str] | None = None) -> dict[str, MessageTable]:
    """The signals of all data frames in the log that the database knows, by message name, in the database's order.

    messages : names of those wanted; None: all. A message without a frame in the log has empty columns. Bytes beyond
    the message's length are ignored. Raises KeyError for a name that the database does not have.
    """
    wanted = database.messages if messages is None else [database.get_message_by_name(name) for name in messages]
    is_data = ~(log.is_remote | log.is_error)
    payload = np.ascontiguousarray(log.data).view("<u8")[:, 0]
    return {message.name: _table(log, message, is_data, payload) for message in wanted}


def _table(log: CanLog, message: Message, is_data: Flags, payload: npt.NDArray[np.uint64]) -> MessageTable:
    is_here = is_data & (log.arbitration_id == message.frame_id) & (log.is_extended == message.is_extended_frame)
    rows = np.flatnonzero(is_here)
    is_whole = log.length[rows] >= message.length
    too_short = len(rows) - int(np.count_nonzero(is_whole))
    if too_short:
        rows = rows[is_whole]
    words = payload[rows]
    signals: list[Signal] = message.signals
    fits = message.length <= MAX_DATA  # a message of CAN FD has no frame in the log
    return MessageTable(
        name=message.name,
        rows=rows,
        time_s=log.time_s[rows],
        columns=_columns(message, words) if fits else {signal.name: np.empty(0) for signal in signals},
        units={signal.name: signal.unit or "" for signal in signals},
        choices={signal.name: _names(signal) for signal in signals if signal.choices},
        too_short=too_short,
    )


def _columns(message: Message, words: npt.NDArray[np.uint64]) -> dict[str, Array]:
    """Values of all signals. words : (n,) payloads as numbers, the first byte the lowest."""
    reversed_words = words.byteswap() if any(s.byte_order == "big_endian" for s in message.signals) else words
    raw = {
        signal.name: _raw(signal, words if signal.byte_order == "little_endian" else reversed_words)
        for signal in message.signals
    }
    columns = {}
    for signal in message.signals:
        values = _in_unit(signal, raw[signal.name])
        is_there = _is_there(message, signal, raw)
        columns[signal.name] = values if is_there is None else np.where(is_there, values.astype(np.float64), np.nan)
    return columns


def _raw(signal: Signal, word: npt.NDArray[np.uint64]) -> Array:
    """The signal's bits as numbers: int32 where they fit, uint64, int64 or a float. word : in its byte order."""
    if signal.byte_order == "little_endian":
        shift = signal.start
    else:  # start is the place of the highest bit, counted within each byte from its lowest one
        shift = PAYLOAD_BITS - 8 * (signal.start // 8) - 7 + signal.start % 8 - signal.length
    if shift:
        word = word >> np.uint64(shift)
    if signal.is_float:
        with np.errstate(invalid="ignore"):  # random bits may be a signalling NaN
            return word.astype(f"u{signal.length // 8}").view(f"f{signal.length // 8}").astype(np.float64)
    unused = PAYLOAD_BITS - signal.length
    if signal.is_signed:
        signed = (word << np.uint64(unused)).view(np.int64) >> np.int64(unused)
        return signed.astype(np.int32) if signal.length <= SMALL_BITS else signed
    value = word & np.uint64((1 << signal.length) - 1) if unused else word
    return value.astype(np.int32) if signal.length < SMALL_BITS else value


def _in_unit(signal: Signal, raw: Array) -> Array:
    """Scaled by cantools' own conversion, which does the same arithmetic with an array as with a number."""
    conversion: Any = signal.conversion
    if signal.is_float or not (float(signal.scale).is_integer() and float(signal.offset).is_integer()):
        return np.asarray(conversion.raw_to_scaled(raw, decode_choices=False))
    low, high = (-1 << signal.length - 1, 1 << signal.length - 1) if signal.is_signed else (0, 1 << signal.length)
    ends = [end * int(signal.scale) + int(signal.offset) for end in (low, high - 1)]
    kind = _whole_number_type(min(*ends, low), max(*ends, high - 1))
    return np.asarray(conversion.raw_to_scaled(raw.astype(kind, copy=False), decode_choices=False))


def _names(signal: Signal) -> dict[float, str]:
    """The value table for scaled numbers; the DBC has it for those on the wire."""
    conversion: Any = signal.conversion
    return {conversion.raw_to_scaled(n, decode_choices=False): str(text) for n, text in (signal.choices or {}).items()}


def _whole_number_type(lowest: int, highest: int) -> type[np.generic]:
    """The smallest type that holds the range; float64 where none does."""
    for kind in (np.int32, np.int64, np.uint64):
        if np.iinfo(kind).min <= lowest and highest <= np.iinfo(kind).max:
            return kind
    return np.float64


def _is_there(message: Message, signal: Signal, raw: Mapping[str, Array]) -> Flags | None:
    """In which frames a multiplexed signal is; None for a signal that is in all of them."""
    if signal.multiplexer_signal is None or not signal.multiplexer_ids:
        return None
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    is_selected = np.isin(raw[selector.name], np.array(signal.multiplexer_ids))
    outer = _is_there(message, selector, raw)
    return is_selected if outer is None else is_selected & outer
