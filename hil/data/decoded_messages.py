"""The signals of a log, message by message, each decoded when it is asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.data.can_log import can_log_blocks, joined
from hil.data.decode import decode
from hil.data.run_tables import message_table

if TYPE_CHECKING:
    from pandas import DataFrame


class DecodedMessages(Mapping[str, "DataFrame"]):
    """Message name -> its signals as a data frame. A message is decoded when it is first asked for, and then kept."""

    def __init__(self, log: Path, database: Any, zero_s: float) -> None:
        self._log, self._database, self._zero_s = log, database, zero_s
        self._tables: dict[str, DataFrame] = {}

    def __getitem__(self, name: str) -> DataFrame:
        if name not in self._tables:
            if name not in set(self):
                raise KeyError(f"the DBC has no message {name!r}; it has {', '.join(self)}")
            self._tables[name] = self._read(name)
        return self._tables[name]

    def __iter__(self) -> Iterator[str]:
        return (message.name for message in self._database.messages)

    def __len__(self) -> int:
        return len(self._database.messages)

    def __repr__(self) -> str:
        return f"<signals of {', '.join(self)}>"

    def _read(self, name: str) -> DataFrame:
        """The frames of one message alone, block by block, so that a long log does not have to fit into memory."""
        frame_id = self._database.get_message_by_name(name).frame_id
        blocks = (block[block.arbitration_id == frame_id] for block in can_log_blocks(self._log))
        tables = (decode(block, self._database, [name])[name] for block in (joined(()), *blocks))
        return message_table(tables, self._zero_s)
