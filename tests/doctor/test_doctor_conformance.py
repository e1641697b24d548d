"""The conformance check: the emulator passes it; every broken node fails the test that is meant for it."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from firmware_sim.faults.base import FaultTable
from firmware_sim.frames import NodeState
from firmware_sim.pump_node import PumpNode
from hil.conformance import suite
from hil.probe.bus_probe import InterruptedByUserError
from hil.probe.check_result import Result, Verdict
from hil.wire.frame_check import Frame
from tests.doctor import nodes_bench as nodes
from tests.doctor.doctor_bench import RIG, LockstepBench, contract, fault
from tests.doctor.nodes_bench import failures, tried

BROKEN = {
    nodes.NoWatchdog: "watchdog after 250 ms",
    nodes.IgnoresCrc: "refuses a wrong CRC",
    nodes.TakesOtherDataIds: "refuses another data id",
    nodes.TakesAnyLength: "refuses a wrong length",
    nodes.LooksAtSixBytes: "refuses a wrong length",
    nodes.TakesExtended: "refuses an extended frame",
    nodes.TakesRemote: "refuses a remote frame",
    nodes.ClipsRange: "refuses a voltage out of range",
    nodes.RefusesSpareBits: "ignores spare bits",
    nodes.TakesAnyCounter: "refuses an old counter",
    nodes.TakesRepeated: "refuses a repeated counter",
    nodes.TakesOld: "refuses an old counter",
    nodes.WantsEveryCounter: "takes a newer counter",
    nodes.NeverResynchronises: "takes any counter after silence",
    nodes.FedByRefused: "watchdog is not fed by refused frames",
    nodes.CountsRefused: "refuses a wrong CRC",
    nodes.EchoesNothing: "takes valid commands",
    nodes.CountsNothing: "takes valid commands",
    nodes.NotLatched: "trip is latched",
    nodes.ClearsWhileEnabled: "clearing needs rest",
    nodes.ClearsWithVoltage: "clearing needs rest",
    nodes.NeverClears: "trip is cleared",
    nodes.ClearedBySilence: "trip is latched",
    nodes.KeepsCause: "trip is cleared",
    nodes.TripsWhenReady: "needs no commands when ready",
    nodes.ClearingTrips: "clearing is harmless when ready",
    nodes.ClearingStops: "clearing is ignored in run",
    nodes.StaysEnabled: "runs when enabled",
    nodes.RunsUnasked: "takes valid commands",
    nodes.BootsWithVoltage: "waits at 0 V",
}
BROKEN_AT_VOLTAGE = {
    nodes.SwapsOutputs: "applies what is commanded",
    nodes.HalfVoltage: "applies what is commanded",
    nodes.TakesAnyRangeWhileRunning: "refuses while running",
    nodes.HoldsVoltageInTrip: "trips to 0 V",
    nodes.MovesWhileTripped: "never moves after a trip",
}
FEEDING = (
    nodes.ClipsRange,
    nodes.IgnoresCrc,
    nodes.TakesRepeated,
    nodes.TakesOld,
    nodes.TakesAnyLength,
    nodes.LooksAtSixBytes,
)


def by_name(node: type[PumpNode]) -> str:
    return node.__name__


def test_the_emulator_conforms_at_rest_and_no_pump_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    results, bench = tried(monkeypatch, PumpNode, level_node=True)
    assert {result.verdict for result in results.values()} == {Verdict.PASS}, results
    assert suite.conforms(list(results.values()))
    assert bench.highest_voltage == 0.0
    assert (bench.pump.state, bench.pump.applied_V) == (NodeState.READY, (0.0, 0.0))


def test_the_emulator_conforms_with_pumps_and_ends_at_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    results, bench = tried(monkeypatch, PumpNode, with_pumps=True)
    assert {result.verdict for result in results.values()} == {Verdict.PASS}, results
    assert set(BROKEN_AT_VOLTAGE.values()) <= set(results)
    assert bench.highest_voltage == pytest.approx(1.0, abs=0.01)
    assert (bench.pump.state, bench.pump.applied_V) == (NodeState.READY, (0.0, 0.0))


def test_at_rest_no_frame_asks_for_a_voltage_not_even_a_broken_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that takes what it must refuse shall not move a pump by it."""
    _, bench = tried(monkeypatch, PumpNode)
    assert len(bench.sent) > 200
    for _, _, data in bench.sent:
        is_enabled = len(data) >= 6 and data[4] & 1
        assert not (is_enabled and any(data[:4])), data.hex()


@pytest.mark.parametrize("node", BROKEN, ids=by_name)
def test_a_broken_node_fails_its_test_and_moves_no_pump(monkeypatch: pytest.MonkeyPatch, node: type[PumpNode]) -> None:
    results, bench = tried(monkeypatch, node)
    assert BROKEN[node] in failures(results)
    assert not suite.conforms(list(results.values()))
    if node is not nodes.BootsWithVoltage:
        assert bench.highest_voltage == 0.0
        assert bench.pump.applied_V == (0.0, 0.0)


@pytest.mark.parametrize("node", BROKEN_AT_VOLTAGE, ids=by_name)
def test_what_only_shows_at_a_voltage_is_found_with_pumps(
    monkeypatch: pytest.MonkeyPatch, node: type[PumpNode]
) -> None:
    results, _ = tried(monkeypatch, node, with_pumps=True)
    assert failures(results) == {BROKEN_AT_VOLTAGE[node]}
    results, bench = tried(monkeypatch, node)
    assert failures(results) == set()
    assert bench.highest_voltage == 0.0


@pytest.mark.parametrize("node", FEEDING, ids=by_name)
def test_a_watchdog_fed_by_what_must_be_refused_is_found(monkeypatch: pytest.MonkeyPatch, node: type[PumpNode]) -> None:
    results, _ = tried(monkeypatch, node)
    assert "prevents the trip" in results["watchdog is not fed by refused frames"].found


@pytest.mark.parametrize("node", [nodes.IgnoresCrc, nodes.NotLatched], ids=by_name)
def test_a_node_that_fails_at_rest_gets_no_voltage_with_pumps(
    monkeypatch: pytest.MonkeyPatch, node: type[PumpNode]
) -> None:
    results, bench = tried(monkeypatch, node, with_pumps=True)
    assert {results[name].verdict for name in BROKEN_AT_VOLTAGE.values()} == {Verdict.NOT_CHECKED}
    assert bench.highest_voltage == 0.0


@pytest.mark.parametrize(
    ("watchdog_s", "passes"), [(0.2, False), (0.225, False), (0.24, True), (0.26, True), (0.285, False), (0.4, False)]
)
def test_the_watchdog_is_timed(monkeypatch: pytest.MonkeyPatch, watchdog_s: float, passes: bool) -> None:
    results, _ = tried(monkeypatch, PumpNode, overlay={"nodes": {"watchdog_s": watchdog_s}})
    assert (results["watchdog after 250 ms"].verdict is Verdict.PASS) is passes, results["watchdog after 250 ms"]


def test_a_slow_watchdog_is_not_blamed_on_refused_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """A watchdog of 400 ms made the check say that a wrong CRC prevents the trip. Nor is its absence."""
    results, _ = tried(monkeypatch, PumpNode, overlay={"nodes": {"watchdog_s": 0.4}})
    assert "watchdog after 250 ms" in failures(results)
    assert results["watchdog is not fed by refused frames"].verdict is Verdict.PASS
    results, _ = tried(monkeypatch, nodes.NoWatchdog)
    assert "silence" in results["watchdog is not fed by refused frames"].found
    results, _ = tried(monkeypatch, nodes.IgnoresCrc, overlay={"nodes": {"watchdog_s": 0.4}})
    assert "a wrong CRC prevents" in results["watchdog is not fed by refused frames"].found


def test_clearing_in_run_only_fails_its_own_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that takes ClearTrip in run for a stop passed every test."""
    results, _ = tried(monkeypatch, nodes.ClearingStops)
    assert failures(results) == {"clearing is ignored in run"}


def test_a_tripped_node_is_cleared_by_the_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("firmware_sim.rig.PumpNode", PumpNode)
    bench = LockstepBench()
    with bench.probe() as probe:
        probe.listen(0.2)
        probe.command(enable=True)
        probe.listen(0.5)
        assert bench.pump.state is NodeState.TRIPPED
        results = suite.run_suite(probe, suite.Plan(True, False, False, RIG.sensors.range_V))
    assert suite.conforms(results), results
    bench.close()


FAULTY = [
    (fault("node_silent", "pump"), "waits at 0 V"),
    (fault("heartbeat_stop", "pump"), "PumpHeartbeat period"),
    (fault("counter_stuck", "PumpStatus"), "PumpStatus integrity"),
    (fault("frame_corrupt", "PumpHeartbeat", 0.04), "PumpHeartbeat integrity"),
    (fault("node_reboot", "pump", at_s=9.0), "pump node does not reboot"),
    (fault("node_silent", "level"), "LowerLevels period"),
    (fault("heartbeat_stop", "level"), "LevelHeartbeat period"),
    (fault("counter_stuck", "UpperLevels"), "UpperLevels integrity"),
    (fault("frame_corrupt", "LowerLevels", 0.02), "LowerLevels integrity"),
    (fault("wrong_length", "UpperLevels"), "UpperLevels period"),
    (fault("sensor_open", 3), "sensor 3 range"),
    (fault("node_reboot", "level", at_s=3.0), "level node does not reboot"),
    (fault("foreign_command", "PumpCommand", 0.0), "alone on the bus"),
]


@pytest.mark.parametrize(("what", "name"), FAULTY, ids=lambda case: getattr(case, "kind", case))
def test_faults_of_frames_and_nodes_are_found(monkeypatch: pytest.MonkeyPatch, what: FaultTable, name: str) -> None:
    results, _ = tried(monkeypatch, PumpNode, what, level_node=True)
    assert name in failures(results), results


@pytest.mark.parametrize(
    ("keys", "name"),
    [
        ({"levels_period_s": 0.022}, "LowerLevels period"),
        ({"status_period_s": 0.053}, "PumpStatus period"),
        ({"heartbeat_period_s": 0.09}, "LevelHeartbeat period"),
        ({"boot_s": 30.0}, "level node runs"),
    ],
)
def test_wrong_timing_is_found(monkeypatch: pytest.MonkeyPatch, keys: dict[str, float], name: str) -> None:
    results, _ = tried(monkeypatch, PumpNode, level_node=True, overlay={"nodes": keys})
    assert name in failures(results), results


def test_nodes_of_another_dbc_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    results, _ = tried(monkeypatch, PumpNode, level_node=True, fingerprint=1)
    assert {"pump node contract", "level node contract"} <= failures(results)


def test_an_unknown_sender_ends_the_check_with_one_command_of_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    results, bench = tried(monkeypatch, PumpNode, fault("foreign_command", "PumpCommand", 0.0, at_s=8.0))
    assert "another sender commands" in results["conformance test"].found
    after = [data for t_ns, _, data in bench.sent if t_ns >= 9_000_000_000]
    assert len(after) == 1
    assert not any(after[0][:4])
    assert not after[0][4] & 0b11


def test_json_is_what_the_table_says(tmp_path: Path) -> None:
    from hil.cli.conformance_command import ConformanceOptions, _write
    from hil.edge.can.bus import BusAddress
    from hil.probe.check_result import failed, passed

    file = tmp_path / "node.json"
    results = [passed("one", "1 V"), failed("two", "2 V", "fix it")]
    _write(file, BusAddress("virtual", "x", 500_000), contract(), ConformanceOptions(node="pump"), results)
    told = json.loads(file.read_text())
    assert told["conforms"] is False
    assert told["node"] == "pump"
    assert told["results"][1] == {"check": "two", "verdict": "fail", "found": "2 V", "advice": "fix it"}


@pytest.mark.parametrize("after_s", [6.3, 8.0, 9.6, 11.1, 14.0, 17.0, 19.5, 20.0, 22.0, 24.05, 26.0])
def test_a_host_that_stands_still_for_a_moment_makes_no_healthy_node_fail(
    monkeypatch: pytest.MonkeyPatch, after_s: float
) -> None:
    monkeypatch.setattr("firmware_sim.rig.PumpNode", PumpNode)
    bench = LockstepBench()
    receive = bench.receive
    stalls: list[int] = []

    def stalling(timeout_s: float) -> Frame | None:
        if not stalls and bench.now_ns() >= after_s * 1e9:
            stalls.append(bench.now_ns())
            bench._wait(bench.now_ns() + 400_000_000)  # frames pile up and come all at once
        return receive(timeout_s)

    vars(bench)["receive"] = stalling
    with bench.probe() as probe:
        results = suite.run_suite(probe, suite.Plan(True, False, False, RIG.sensors.range_V))
    assert stalls
    assert suite.conforms(results), [result for result in results if result.verdict is not Verdict.PASS]
    bench.close()


@pytest.mark.parametrize("after_s", [3.0, 9.7, 14.2, 19.3, 21.1, 23.0, 24.4, 26.2, 31.0])
def test_whenever_it_is_interrupted_the_node_ends_ready_at_zero(
    monkeypatch: pytest.MonkeyPatch, after_s: float
) -> None:
    monkeypatch.setattr("firmware_sim.rig.PumpNode", PumpNode)
    bench = LockstepBench()
    until_ns = bench.now_ns() + round(after_s * 1e9)
    with (
        pytest.raises(InterruptedByUserError, match="SIGTERM"),
        bench.probe(lambda: "SIGTERM" if bench.now_ns() >= until_ns else "") as probe,
    ):
        suite.run_suite(probe, suite.Plan(True, False, True, RIG.sensors.range_V))
    bench.rig.advance(bench.now_ns() + 400_000_000)
    assert (bench.pump.state, bench.pump.applied_V) == (NodeState.READY, (0.0, 0.0))
    bench.close()


def cycled(
    monkeypatch: pytest.MonkeyPatch,
    what: Callable[[LockstepBench], object],
    *,
    node: type[PumpNode] = PumpNode,
    within_s: float = 10.0,
) -> Result:
    """The last test alone: somebody is asked to switch the node off and on, and does `what`."""
    monkeypatch.setattr("firmware_sim.rig.PumpNode", node)
    bench = LockstepBench()
    asked: list[str] = []

    def ask(text: str) -> None:
        asked.append(text)
        what(bench)

    with bench.probe() as probe:
        plan = suite.Plan(True, False, False, RIG.sensors.range_V, power_cycle_s=within_s)
        results = {result.check: result for result in suite.run_suite(probe, plan, ask)}
    bench.close()
    assert len(asked) == 1
    return results["boots at 0 V"]


def off_and_on(bench: LockstepBench) -> None:
    bench.inject(fault("node_reboot", "pump", at_s=1.0, until_s=3.0))


class BootsRunning(PumpNode):
    def reboot(self, now_ns: int, power_ns: int) -> None:
        super().reboot(now_ns, power_ns)
        self._wakes = True

    def run_event(self, now_ns: int) -> None:
        was_boot = self.state is NodeState.BOOT
        super().run_event(now_ns)
        if was_boot and self.state is NodeState.READY and getattr(self, "_wakes", False):
            self.applied_V = (2.0, 2.0)


class KeepsTrip(PumpNode):
    def reboot(self, now_ns: int, power_ns: int) -> None:
        super().reboot(now_ns, power_ns)
        self.accepted = 7


class ForgetsToCount(PumpNode):
    def reboot(self, now_ns: int, power_ns: int) -> None:
        super().reboot(now_ns, power_ns)
        self._boot_count += 1


def test_a_power_cycle_shows_how_the_node_boots(monkeypatch: pytest.MonkeyPatch) -> None:
    assert cycled(monkeypatch, off_and_on).verdict is Verdict.PASS


@pytest.mark.parametrize(
    ("node", "word"),
    [
        (BootsRunning, "applied a voltage"),
        (KeepsTrip, "still has"),
        (ForgetsToCount, "boot count 3 after 1, must be 2"),
    ],
)
def test_a_node_that_boots_wrongly_is_found(monkeypatch: pytest.MonkeyPatch, node: type[PumpNode], word: str) -> None:
    result = cycled(monkeypatch, off_and_on, node=node)
    assert result.verdict is Verdict.FAIL
    assert word in result.found


def test_nobody_switches_it_off(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "no other boot count" in cycled(monkeypatch, lambda _: None, within_s=3.0).found
