"""A run that is none: a Unix socket that greets, sends the states it is given, and answers requests as it is told."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

HELLO: dict[str, Any] = {
    "folder": "/data/runs/steps",
    "scenario": "steps",
    "pid": 0,  # no process: none must be signalled
    "duration_s": 500.0,
    "period_s": 0.1,
    "rig": {
        "level_max_cm": 19.0,
        "height_cm": [20.0, 20.0, 20.0, 20.0],
        "level_gain_V_cm": 0.5,
        "range_V": [0.0, 10.0],
        "area_cm2": [28.0, 32.0, 28.0, 32.0],
        "valve_split": [0.7, 0.6],
    },
    "bypassable": ["dry_run"],
    "bypass_max_s": 600.0,
}

ALARM: dict[str, Any] = {
    "key": "alarm:2",
    "title": "pump 1: effectiveness 0.41",
    "priority": "high",
    "state": "active",
    "since_s": 100.4,
    "count": 1,
    "respond_s": 60.0,
    "cause": "pump worn, clogged or its hose is loose",
    "action": "check pump 1, its hose and its supply",
    "shelved_s": 0.0,
}


def state(t_s: float = 123.4, **others: Any) -> dict[str, Any]:
    """A state at the operating point, changed by `others`."""
    return {
        "t_s": t_s,
        "mode": "RUNNING",
        "held": False,
        "starting": False,
        "measured_cm": [12.41, 12.68, 1.63, 1.41],
        "estimated_cm": [12.4, 12.7, 1.63, 1.41],
        "trusted": [True, True, True, True],
        "reference_cm": [12.4, 12.7],
        "target_cm": [12.4, 12.7],
        "command_V": [3.0, 3.0],
        "applied_V": [3.0, 3.0],
        "effectiveness": [1.0, 1.0],
        "pump_flow_cm3_s": [9.99, 10.05],
        "split": [0.7, 0.6],
        "outflow_cm3_s": [11.1, 9.0, 4.02, 3.0],
        "interlock": "",
        "bypassed": {},
        "waits_for": "",
        "iae_Vs": [0.1, 0.1],
        "lateness_s": 0.0001,
        "skipped": 0,
        "next": {"in_s": 26.6, "what": "reference"},
        "alarms": [],
        **others,
    }


class FakeRun:
    """The server. requests : what came, `subscribe` left out. is_deaf : gives no answer."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.hello: dict[str, Any] = HELLO
        self.requests: list[dict[str, Any]] = []
        self.is_deaf = False
        self._clients: list[asyncio.StreamWriter] = []
        self._last: list[dict[str, Any]] = []

    def send(self, **message: Any) -> None:
        """Send a message to every client, and to those that come later."""
        self._last.append(message)
        for client in self._clients:
            self._write(client, message)

    def send_state(self, **others: Any) -> None:
        """Send a state."""
        self.send(state=state(**others))

    def cut_off(self) -> None:
        """Close every connection."""
        for client in self._clients:
            client.close()
        self._clients.clear()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client until it is gone."""
        self._clients.append(writer)
        self._write(writer, {"hello": self.hello})
        for message in self._last:
            self._write(writer, message)
        with suppress(OSError, asyncio.CancelledError):
            while line := await reader.readline():
                request = json.loads(line)
                if request["do"] != "subscribe":
                    self.requests.append({key: request[key] for key in request if key not in ("v", "id")})
                if not self.is_deaf:
                    self._write(writer, {"id": request.get("id"), "ok": True, "t_s": 1.0, "text": request["do"]})

    @staticmethod
    def _write(client: asyncio.StreamWriter, message: dict[str, Any]) -> None:
        if not client.is_closing():
            client.write(json.dumps({"v": 1, **message}).encode() + b"\n")


@asynccontextmanager
async def fake_run(folder: Path) -> AsyncIterator[FakeRun]:
    """A fake run that listens in the folder."""
    fake = FakeRun(folder / "control.sock")
    server = await asyncio.start_unix_server(fake.serve, fake.path)
    try:
        yield fake
    finally:
        server.close()
        fake.cut_off()
