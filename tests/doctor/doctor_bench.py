"""A bench in lockstep: the emulator at the far end of a virtual bus, one simulated clock for both.

Waiting for a frame moves the clock on, to the next thing that happens at the rig.
"""

import itertools
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import can

from firmware_sim import settings as emulator_settings
from firmware_sim.faults.base import Fault, FaultTable
from firmware_sim.faults.catalogue import KINDS
from firmware_sim.ports import BusPort as EmulatorPort
from firmware_sim.pump_node import Change, PumpNode
from firmware_sim.rig import Rig
from hil.bench import assembly
from hil.cli.doctor_command import expectations
from hil.doctor.examination import examine
from hil.edge.can.bus import BusPort
from hil.edge.config.rig_file import load_rig
from hil.probe.bus_probe import Probe
from hil.probe.check_result import Result
from hil.wire.contract import Contract
from hil.wire.frame_check import Frame

CONFIG = Path(__file__).resolve().parents[2] / "config"
RIG = load_rig(CONFIG / "rig.toml")
WANTS = expectations(RIG)
BOOTED_NS = 1_000_000_000
_channels = itertools.count()


@lru_cache(maxsize=1)
def contract() -> Contract:
    return assembly.load_contract(CONFIG / "bench.dbc")


def fault(
    kind: str,
    target: str | int | None = None,
    value: float | None = None,
    *,
    at_s: float = 0.0,
    until_s: float | None = None,
) -> FaultTable:
    given = {"target": target, "value": value, "until_s": until_s}
    return KINDS[kind].model_validate({"kind": kind, "at_s": at_s} | {k: v for k, v in given.items() if v is not None})


class LockstepBench:
    """Port and clock of a probe in one. overlay : keys over emulator.toml, table by table. rig : a class like Rig."""

    def __init__(
        self,
        *,
        overlay: dict[str, dict[str, Any]] | None = None,
        fingerprint: int | None = None,
        seed: int = 1,
        rig: type[Rig] = Rig,
    ) -> None:
        base, _ = emulator_settings.load(CONFIG / "emulator.toml")
        values = base.model_dump()
        for table, keys in (overlay or {}).items():
            values[table] |= keys
        settings = type(base).model_validate(values)
        self.changes: list[Change] = []
        print_of = contract().fingerprint if fingerprint is None else fingerprint
        self.rig = rig(settings, (), seed, print_of, self.changes.append)
        channel = f"doctor {next(_channels)}"
        made: dict[str, Any] = {
            "interface": "virtual",
            "channel": channel,
            "preserve_timestamps": True,
            "ignore_config": True,
        }
        self._ours, self._theirs = can.Bus(**made), can.Bus(**made)
        self.port = BusPort(self._ours)
        self._far = EmulatorPort(self.rig, self._theirs)
        self._now_ns = 0
        self.sent: list[tuple[int, int, bytes]] = []
        self.is_up, self.last_error = True, ""
        self._wait(BOOTED_NS)
        self.port.waiting()

    def now_ns(self) -> int:
        return self._now_ns

    def receive(self, timeout_s: float) -> Frame | None:
        deadline_ns = self._now_ns + max(1, round(timeout_s * 1e9))
        while (frame := self.port.receive(0.0)) is None and self._now_ns < deadline_ns:
            self._wait(min(deadline_ns, max(self.rig.next_event_ns, self._now_ns + 1)))
        return frame

    def arrived_ns(self, message: Frame, now_ns: int) -> int:
        return self.port.arrived_ns(cast(can.Message, message), now_ns)

    def send(self, frame_id: int, data: bytes, timestamp_s: float, **kind: bool) -> bool:
        self.sent.append((self._now_ns, frame_id, data))
        is_sent = self.port.send(frame_id, data, timestamp_s, **kind)
        self._far.read(self._now_ns)
        return is_sent

    def inject(self, *faults: FaultTable) -> "LockstepBench":
        for one in faults:
            self.rig.inject(cast(Fault, one), self._now_ns)
        return self

    def _wait(self, until_ns: int) -> None:
        self._now_ns = until_ns
        self._far.step(until_ns)

    @property
    def pump(self) -> PumpNode:
        return self.rig.pump

    @property
    def highest_voltage(self) -> float:
        """The most that the pump node has ever put out."""
        return max((max(change.applied_V) for change in self.changes if change.node == "pump"), default=0.0)

    def probe(self, stop_reason: Callable[[], str] = lambda: "") -> Probe:
        return Probe(contract(), self, self, stop_reason)

    def close(self) -> None:
        self._ours.shutdown()
        self._theirs.shutdown()


def examined(bench: LockstepBench, seconds: float = 3.0, *, with_pumps: bool = False) -> dict[str, Result]:
    """Results by name; the bench is closed."""
    try:
        with bench.probe() as probe:
            results = examine(probe, WANTS, seconds, with_pumps=with_pumps)
        return {result.check: result for result in results}
    finally:
        bench.close()
