"""The panel's connection to a run: it reads what the run says, sends requests, and connects again."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from hil.core.errors import HilError
from hil.panel.run_messages import (
    RunAnswer,
    ShownEvent,
    ShownRun,
    ShownState,
    read_answer,
    read_event,
    read_hello,
    read_state,
)

STATES_HZ = 5.0
ANSWER_S = 2.0
RETRY_S = 0.5
LINE_MAX = 1 << 20
"""Longest line that is read from a run. A line to a run has at most 4096 bytes."""

ENDED = RunAnswer(False, "not sent: the connection to the run is lost")


class RunListener(Protocol):
    """Who is told what a run says."""

    def on_run(self, run: ShownRun) -> None:
        """Connected: the greeting."""

    def on_state(self, state: ShownState) -> None:
        """A state."""

    def on_run_event(self, event: ShownEvent) -> None:
        """A line of the event log."""

    def on_lost(self, reason: str) -> None:
        """The connection was cut off, or can't be made."""


class RunConnection:
    """A connection to the run whose socket `find` names. `follow` does the work until it is cancelled."""

    def __init__(self, find: Callable[[], Path], listener: RunListener, retry_s: float = RETRY_S) -> None:
        self._find, self._listener, self._retry_s = find, listener, retry_s
        self._writer: asyncio.StreamWriter | None = None
        self._waiting: dict[int, asyncio.Future[RunAnswer]] = {}
        self._last_id = 0
        self._refusal = ""

    @property
    def is_open(self) -> bool:
        """Whether requests can be sent."""
        return self._writer is not None

    async def follow(self) -> None:
        """Connect, read, and connect again, until cancelled."""
        while True:
            self._listener.on_lost(await self._read_until_lost())
            await asyncio.sleep(self._retry_s)

    async def request(self, request: Mapping[str, Any], timeout_s: float = ANSWER_S) -> RunAnswer:
        """Send a request and wait for its answer. A failure to send it is an answer, too."""
        if self._writer is None:
            return ENDED
        self._last_id += 1
        number = self._last_id
        answer = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        try:
            self._send({**request, "id": number})
            return await asyncio.wait_for(answer, timeout_s)
        except TimeoutError:
            return RunAnswer(False, f"the run has not answered within {timeout_s:g} s")
        except OSError:
            return ENDED
        finally:
            self._waiting.pop(number, None)

    def _send(self, message: Mapping[str, Any]) -> None:
        if self._writer is None:
            raise ConnectionResetError
        self._writer.write(json.dumps({"v": 1, **message}, ensure_ascii=False).encode(errors="replace") + b"\n")

    async def _read_until_lost(self) -> str:
        """Why the connection was lost."""
        try:
            path, self._refusal = self._find(), ""
        except HilError as error:
            return str(error)
        try:
            reader, self._writer = await asyncio.open_unix_connection(path, limit=LINE_MAX)
            self._send({"do": "subscribe", "rate_hz": STATES_HZ, "events": True})
            while line := await reader.readline():
                self._take(line)
        except (OSError, ValueError) as error:
            return f"{path}: {getattr(error, 'strerror', None) or error}"
        finally:
            self._close()
        return f"the run has closed the connection{self._refusal}"

    def _take(self, line: bytes) -> None:
        """Hand one line on. Raises ValueError for what is not a message."""
        message = json.loads(line)
        if not isinstance(message, dict):
            raise ValueError("not a message of a run")
        if isinstance(hello := message.get("hello"), dict):
            self._listener.on_run(read_hello(hello))
        elif isinstance(state := message.get("state"), dict):
            self._listener.on_state(read_state(state))
        elif isinstance(event := message.get("event"), dict):
            self._listener.on_run_event(read_event(event))
        elif isinstance(number := message.get("id"), int):
            answer = self._waiting.get(number)
            if answer is not None and not answer.done():
                answer.set_result(read_answer(message))
        elif message.get("ok") is False:
            self._refusal = f": {read_answer(message).text}"

    def _close(self) -> None:
        if self._writer is not None:
            with suppress(OSError):
                self._writer.close()
            self._writer = None
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_result(ENDED)
