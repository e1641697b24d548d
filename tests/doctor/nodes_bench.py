"""Pump nodes with one thing wrong each, as a firmware under development may have it."""

from functools import cache
from typing import Any

import can
import pytest

import firmware_sim.rig
from firmware_sim.faults.base import FaultTable
from firmware_sim.frames import (
    COMMAND_ID,
    DATA_IDS,
    Frame,
    NodeState,
    PumpCommand,
    Rejection,
    TripCause,
    crc8,
    remade,
    sealed,
)
from firmware_sim.pump_node import PumpNode
from hil.conformance.suite import Plan, run_suite
from hil.core.types import Pair
from hil.probe.check_result import Result, Verdict
from tests.doctor.doctor_bench import BOOTED_NS, RIG, LockstepBench


def frame(data: bytes) -> Frame:
    return Frame(0.0, COMMAND_ID, is_extended_id=False, data=data)


class NoWatchdog(PumpNode):
    @property
    def next_event_ns(self) -> int | None:
        return super().next_event_ns if self.state is NodeState.BOOT else None


class IgnoresCrc(PumpNode):
    def receive(self, frame: can.Message, now_ns: int) -> Rejection | None:
        data = bytes(frame.data)
        return super().receive(remade(frame, data=sealed(COMMAND_ID, data[:-1])) if data else frame, now_ns)


class TakesOtherDataIds(PumpNode):
    def receive(self, frame: can.Message, now_ns: int) -> Rejection | None:
        data = bytes(frame.data)
        for can_id in DATA_IDS:
            if data and crc8(can_id, data[:-1]) == data[-1]:
                frame = remade(frame, data=sealed(COMMAND_ID, data[:-1]))
        return super().receive(frame, now_ns)


class TakesAnyLength(PumpNode):
    def receive(self, frame: can.Message, now_ns: int) -> Rejection | None:
        data = bytes(frame.data)
        if data and crc8(COMMAND_ID, data[:-1]) == data[-1]:
            frame = remade(frame, data=sealed(COMMAND_ID, data[:-1].ljust(5, b"\0")[:5]))
        return super().receive(frame, now_ns)


class LooksAtSixBytes(PumpNode):
    def receive(self, frame: can.Message, now_ns: int) -> Rejection | None:
        return super().receive(remade(frame, data=bytes(frame.data)[:6]), now_ns)


class TakesExtended(PumpNode):
    def receive(self, received: can.Message, now_ns: int) -> Rejection | None:
        return super().receive(frame(bytes(received.data)), now_ns)


class TakesRemote(PumpNode):
    def receive(self, received: can.Message, now_ns: int) -> Rejection | None:
        if received.is_remote_frame:
            received = frame(sealed(COMMAND_ID, bytes((0, 0, 0, 0, self.next_counter << 4))))
        return super().receive(received, now_ns)


class ClipsRange(PumpNode):
    def receive(self, received: can.Message, now_ns: int) -> Rejection | None:
        data = bytes(received.data)
        if len(data) == 6 and crc8(COMMAND_ID, data[:-1]) == data[-1]:
            raws = (min(int.from_bytes(data[at : at + 2], "little"), 50_000) for at in (0, 2))
            body = b"".join(raw.to_bytes(2, "little") for raw in raws) + data[4:5]
            received = remade(received, data=sealed(COMMAND_ID, body))
        return super().receive(received, now_ns)


class RefusesSpareBits(PumpNode):
    def receive(self, received: can.Message, now_ns: int) -> Rejection | None:
        if len(received.data) == 6 and received.data[4] & 0b1100:
            return Rejection.RANGE
        return super().receive(received, now_ns)


class TakesAnyCounter(PumpNode):
    def _check_counter(self, *_: int) -> int | Rejection:
        return 0


class TakesRepeated(PumpNode):
    def _check_counter(self, counter: int, now_ns: int) -> int | Rejection:
        verdict = super()._check_counter(counter, now_ns)
        return 0 if verdict is Rejection.DUPLICATE else verdict


class TakesOld(PumpNode):
    def _check_counter(self, counter: int, now_ns: int) -> int | Rejection:
        verdict = super()._check_counter(counter, now_ns)
        return 0 if verdict is Rejection.OLD else verdict


class WantsEveryCounter(PumpNode):
    def _check_counter(self, counter: int, now_ns: int) -> int | Rejection:
        lost = super()._check_counter(counter, now_ns)
        return Rejection.OLD if lost not in (0, Rejection.DUPLICATE) else lost


class NeverResynchronises(PumpNode):
    def _check_counter(self, counter: int, now_ns: int) -> int | Rejection:
        return super()._check_counter(counter, now_ns if self._last is None else self._last[1])


class FedByRefused(PumpNode):
    def receive(self, received: can.Message, now_ns: int) -> Rejection | None:
        refusal = super().receive(received, now_ns)
        if refusal is not None and self._last is not None:
            self._last = (self._last[0], now_ns)
        return refusal


class CountsRefused(PumpNode):
    def receive(self, received: can.Message, now_ns: int) -> Rejection | None:
        refusal = super().receive(received, now_ns)
        self.accepted += refusal is not None
        return refusal


class EchoesNothing(PumpNode):
    def status(self) -> bytes:
        last, self._last = self._last, None
        payload = super().status()
        self._last = last
        return payload


class CountsNothing(PumpNode):
    def status(self) -> bytes:
        self.accepted = 0
        return super().status()


class NotLatched(PumpNode):
    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        if self.state is NodeState.TRIPPED and command.enable:
            self.state, self.trip_cause = NodeState.READY, TripCause.NONE
        super()._execute(command, now_ns)


class MovesWhileTripped(PumpNode):
    """Says tripped, and moves."""

    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        super()._execute(command, now_ns)
        if self.state is NodeState.TRIPPED and command.enable:
            self._enter(now_ns, NodeState.TRIPPED, command.command_V, "command")


class ClearsWhileEnabled(PumpNode):
    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        if self.state is NodeState.TRIPPED and command.clear_trip and command.enable:
            self.state, self.trip_cause = NodeState.READY, TripCause.NONE
            return
        super()._execute(command, now_ns)


class ClearsWithVoltage(PumpNode):
    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        if self.state is NodeState.TRIPPED and command.clear_trip and not command.enable:
            self.state, self.trip_cause = NodeState.READY, TripCause.NONE
            return
        super()._execute(command, now_ns)


class NeverClears(PumpNode):
    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        if self.state is not NodeState.TRIPPED:
            super()._execute(command, now_ns)


class ClearedBySilence(PumpNode):
    def status(self) -> bytes:
        if self.state is NodeState.TRIPPED:
            self.state, self.trip_cause = NodeState.READY, TripCause.NONE
        return super().status()


class KeepsCause(PumpNode):
    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        super()._execute(command, now_ns)
        if self.state is NodeState.READY and command.clear_trip and self.accepted > 0:
            self.trip_cause = TripCause.WATCHDOG


class TripsWhenReady(PumpNode):
    def status(self) -> bytes:
        if self.state is NodeState.READY and self._last is not None and self.is_quiet():
            self.state, self.trip_cause = NodeState.TRIPPED, TripCause.WATCHDOG
        return super().status()

    def receive(self, received: can.Message, now_ns: int) -> Rejection | None:
        self._calls = 0
        return super().receive(received, now_ns)

    def is_quiet(self) -> bool:
        self._calls = getattr(self, "_calls", 0) + 1
        return self._calls > 6


class ClearingTrips(PumpNode):
    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        was_tripped = self.state is NodeState.TRIPPED
        super()._execute(command, now_ns)
        if command.clear_trip and not was_tripped:
            self.state, self.trip_cause = NodeState.TRIPPED, TripCause.WATCHDOG


class ClearingStops(PumpNode):
    """Takes ClearTrip for a stop: it goes to ready, at 0 V."""

    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        super()._execute(command, now_ns)
        if command.clear_trip and self.state is NodeState.RUN:
            self.state, self.applied_V = NodeState.READY, (0.0, 0.0)


class StaysEnabled(PumpNode):
    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        if self.state is NodeState.RUN and not command.enable:
            return
        super()._execute(command, now_ns)


class RunsUnasked(PumpNode):
    def _execute(self, command: PumpCommand, now_ns: int) -> None:
        super()._execute(command, now_ns)
        if self.state is NodeState.READY and not command.clear_trip:
            self.state = NodeState.RUN


class BootsWithVoltage(PumpNode):
    def run_event(self, now_ns: int) -> None:
        super().run_event(now_ns)
        if self.state is NodeState.READY:
            self.applied_V = (3.0, 0.0)


class SwapsOutputs(PumpNode):
    def _enter(self, now_ns: int, state: NodeState, applied_V: Pair, cause: str) -> None:
        super()._enter(now_ns, state, (applied_V[1], applied_V[0]), cause)


class HalfVoltage(PumpNode):
    def _enter(self, now_ns: int, state: NodeState, applied_V: Pair, cause: str) -> None:
        super()._enter(now_ns, state, (applied_V[0] / 2, applied_V[1] / 2), cause)


class HoldsVoltageInTrip(PumpNode):
    """Tripped, but the converter is not told; rest only once it is disabled."""

    def run_event(self, now_ns: int) -> None:
        held_V = self.applied_V
        super().run_event(now_ns)
        if self.state is NodeState.TRIPPED:
            self.applied_V = held_V


class TakesAnyRangeWhileRunning(PumpNode):
    def receive(self, received: can.Message, now_ns: int) -> Rejection | None:
        data = bytes(received.data)
        if self.state is NodeState.RUN and len(data) == 6 and data[4] & 1 and any(data[:4]):
            raws = (min(int.from_bytes(data[at : at + 2], "little"), 50_000) for at in (0, 2))
            body = b"".join(raw.to_bytes(2, "little") for raw in raws) + data[4:5]
            if crc8(COMMAND_ID, data[:-1]) == data[-1]:
                received = remade(received, data=sealed(COMMAND_ID, body))
        return super().receive(received, now_ns)


def tried(
    monkeypatch: pytest.MonkeyPatch,
    node: type[PumpNode],
    *faults: FaultTable,
    with_pumps: bool = False,
    level_node: bool = False,
    **bench: Any,
) -> tuple[dict[str, Result], LockstepBench]:
    """Results by name, and the bench: the node in the place of the emulator's. The same check is made once only."""
    if faults or bench:
        return _tried(monkeypatch, node, *faults, with_pumps=with_pumps, level_node=level_node, **bench)
    same: Any = node  # mypy takes the class for one that can't be hashed
    return _tried_once(same, with_pumps=with_pumps, level_node=level_node)


@cache
def _tried_once(node: type[PumpNode], *, with_pumps: bool, level_node: bool) -> tuple[dict[str, Result], LockstepBench]:
    with pytest.MonkeyPatch.context() as monkeypatch:
        return _tried(monkeypatch, node, with_pumps=with_pumps, level_node=level_node)


def _tried(
    monkeypatch: pytest.MonkeyPatch,
    node: type[PumpNode],
    *faults: FaultTable,
    with_pumps: bool,
    level_node: bool,
    **bench: Any,
) -> tuple[dict[str, Result], LockstepBench]:
    assert {name for name in vars(node) if name.startswith("_") and not name.startswith("__")} <= set(dir(PumpNode)), (
        "a private method that PumpNode no longer has overrides nothing"
    )
    monkeypatch.setattr(firmware_sim.rig, "PumpNode", node)
    there = LockstepBench(**bench).inject(*faults)
    assert there.now_ns() == BOOTED_NS
    plan = Plan(True, level_node, with_pumps, RIG.sensors.range_V)
    try:
        with there.probe() as probe:
            results = run_suite(probe, plan)
    finally:
        there.close()
    return {result.check: result for result in results}, there


def failures(results: dict[str, Result]) -> set[str]:
    return {name for name, result in results.items() if result.verdict is Verdict.FAIL}
