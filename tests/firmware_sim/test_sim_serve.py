"""The service on a fake clock: every way out, stalls, a port that stays broken."""

from collections.abc import Callable, Iterable
from typing import NoReturn

import can
import pytest

from firmware_sim.pump_node import Change
from firmware_sim.rig import Rig
from firmware_sim.serve import PortLostError, Service
from tests.firmware_sim.sim_bench import MS, SECOND, command, shipped
from tests.narrowing import not_none


class FakeClock:
    """A monotonic clock that goes on by a step at each look."""

    def __init__(self, step_ns: int) -> None:
        self.now_ns = 10**12
        self._step_ns = step_ns

    def __call__(self) -> int:
        self.now_ns += self._step_ns
        return self.now_ns


class ScriptedPort:
    """A port that does what a list of functions says, one a turn, and then stops the service."""

    def __init__(self, script: Iterable[Callable[[int], bool]]) -> None:
        self.script = list(script)
        self.sent: list[list[can.Message]] = []
        self.is_closed = False
        self.service: Service | None = None

    def filenos(self) -> list[int]:
        return []

    def read(self, now_ns: int) -> bool:
        if not self.script:
            not_none(self.service).stop()
            return True
        return self.script.pop(0)(now_ns)

    def send(self, frames: list[can.Message]) -> None:
        self.sent.append(frames)

    def close(self) -> None:
        self.is_closed = True


def serve(
    script: Iterable[Callable[[int], bool]], changes: list[Change], step_ns: int = MS
) -> tuple[Rig, ScriptedPort, Service]:
    rig, port = Rig(shipped(), (), 1, 0, changes.append), ScriptedPort(script)
    service = Service(rig, port, FakeClock(step_ns))
    port.service = service
    return rig, port, service


def test_stop_puts_out_zero_volts_reports_it_and_closes_the_port() -> None:
    changes: list[Change] = []
    _, port, service = serve([], changes)
    service.serve()
    assert [change.cause for change in changes[-2:]] == ["shutdown", "shutdown"]
    assert port.is_closed


def test_an_exception_puts_out_zero_volts_too() -> None:
    changes: list[Change] = []

    def run_then_fail(now_ns: int) -> NoReturn:
        rig.receive(command(3.0, 3.0), now_ns)
        assert rig.truth().applied_V != (0.0, 0.0)
        raise RuntimeError("broken")

    rig, port, service = serve([lambda now_ns: now_ns > 0] * 200 + [run_then_fail], changes, step_ns=2 * MS)
    with pytest.raises(RuntimeError, match="broken"):
        service.serve()
    assert rig.truth().applied_V == (0.0, 0.0)
    assert (changes[-2].node, changes[-2].cause, changes[-2].applied_V) == ("pump", "shutdown", (0.0, 0.0))
    assert port.is_closed


def test_after_a_stall_only_fresh_frames_are_sent() -> None:
    _, port, service = serve([lambda _now: True], [], step_ns=5 * SECOND)
    service.serve()
    assert service.stale_frames > 100
    assert len(port.sent[0]) < 30


def test_a_port_that_stays_broken_ends_the_service() -> None:
    _, port, service = serve([lambda _now: False] * 1000, [], step_ns=20 * MS)
    with pytest.raises(PortLostError, match="5 s"):
        service.serve()
    assert port.is_closed
