"""Every check of the bench: a healthy one passes it, a fault of the emulator fails it. No pump moves."""

import json
from functools import cache
from typing import Any

import pytest
from can import Message

from firmware_sim.faults.base import FaultTable
from firmware_sim.faults.catalogue import KINDS
from firmware_sim.frames import Frame as NodeFrame
from firmware_sim.frames import NodeState
from firmware_sim.rig import Rig
from hil.doctor.check_link import check_lines
from hil.doctor.examination import examine
from hil.probe.bus_probe import InterruptedByUserError
from hil.probe.check_result import Result, Verdict
from hil.wire.frame_check import Frame
from tests.doctor.doctor_bench import WANTS, LockstepBench, contract, examined, fault

PASS, WARN, FAIL, NOT_CHECKED = Verdict.PASS, Verdict.WARN, Verdict.FAIL, Verdict.NOT_CHECKED
FRAMES = ("PumpStatus", "LowerLevels", "UpperLevels", "PumpHeartbeat", "LevelHeartbeat")
SENSORS = (1, 2, 3, 4)

ALL_CHECKS = {
    "commands of others",
    "error frames",
    "pump node heartbeat",
    "pump node contract",
    "level node heartbeat",
    "level node contract",
    "pump node at rest",
    *(f"{name} {what}" for name in FRAMES for what in ("period", "integrity")),
    *(f"sensor {tank} {what}" for tank in SENSORS for what in ("range", "noise")),
    "watchdog",
    "echo latency",
}


def test_a_healthy_bench_passes_every_check_and_moves_no_pump() -> None:
    bench = LockstepBench()
    results = examined(bench)
    assert set(results) == ALL_CHECKS
    assert {result.verdict for result in results.values()} == {PASS}, results
    assert bench.highest_voltage == 0.0
    assert bench.pump.state is NodeState.READY
    assert all(not any(data[:4]) for _, _, data in bench.sent)


WRONG = [
    # fault, check, verdict
    (fault("foreign_command", "PumpCommand", 0.0), "commands of others", FAIL),
    (fault("error_frames", "all", 1.0), "error frames", WARN),
    (fault("error_frames", "all", 50.0), "error frames", FAIL),
    (fault("error_frames", "all", 18.0), "error frames", WARN),
    (fault("error_frames", "all", 30.0, at_s=1.0, until_s=1.7), "error frames", FAIL),
    (fault("heartbeat_stop", "pump"), "pump node heartbeat", FAIL),
    (fault("heartbeat_stop", "pump"), "pump node contract", FAIL),
    (fault("heartbeat_stop", "level"), "level node heartbeat", FAIL),
    (fault("heartbeat_stop", "level"), "level node contract", FAIL),
    (fault("node_reboot", "pump", at_s=1.0), "pump node heartbeat", FAIL),
    (fault("node_reboot", "level", at_s=1.0), "level node heartbeat", FAIL),
    (fault("node_reboot", "level", at_s=0.0, until_s=2.9), "level node heartbeat", WARN),
    (fault("foreign_command", "PumpCommand", 2.0), "pump node at rest", FAIL),
    (fault("foreign_command", "PumpCommand", 0.0), "pump node heartbeat", WARN),
    *(
        (fault("node_silent", "pump"), f"{name} {what}", FAIL)
        for name in FRAMES[::3]
        for what in ("period", "integrity")
    ),
    *((fault("node_silent", "level"), f"{name} period", FAIL) for name in ("LowerLevels", "UpperLevels")),
    (fault("node_silent", "pump"), "pump node at rest", FAIL),
    (fault("node_silent", "level"), "sensor 3 range", FAIL),
    (fault("node_silent", "level"), "sensor 3 noise", NOT_CHECKED),
    *((fault("frame_loss", name, 0.3), f"{name} integrity", FAIL) for name in FRAMES),
    (fault("frame_loss", "LowerLevels", 0.02), "LowerLevels integrity", WARN),
    *((fault("frame_corrupt", name, 0.3), f"{name} integrity", FAIL) for name in FRAMES),
    (fault("frame_corrupt", "UpperLevels", 0.02), "UpperLevels integrity", WARN),
    *((fault("counter_stuck", name), f"{name} integrity", FAIL) for name in FRAMES),
    (fault("wrong_length", "PumpStatus"), "PumpStatus integrity", FAIL),
    (fault("frame_duplicate", "LowerLevels"), "LowerLevels integrity", FAIL),
    (fault("frame_reorder", "UpperLevels"), "UpperLevels integrity", FAIL),
    *((fault("sensor_open", tank), f"sensor {tank} range", FAIL) for tank in SENSORS),
    *((fault("sensor_bias", tank, -8.0), f"sensor {tank} range", FAIL) for tank in SENSORS),
    *((fault("sensor_noise", tank, 0.01), f"sensor {tank} noise", WARN) for tank in SENSORS),
    *((fault("sensor_noise", tank, 0.05), f"sensor {tank} noise", FAIL) for tank in SENSORS),
    *((fault("sensor_stuck", tank), f"sensor {tank} noise", FAIL) for tank in SENSORS),
    (fault("sensor_garbage", 2), "sensor 2 noise", FAIL),
    (fault("frame_loss", "PumpCommand", 0.2), "echo latency", FAIL),
    (fault("frame_delay", "PumpStatus", 0.1), "echo latency", WARN),
    (fault("frame_delay", "PumpCommand", 0.03), "echo latency", WARN),
]


def name_of(case: object) -> str:
    return f"{case.kind} {case.target}" if hasattr(case, "kind") and hasattr(case, "target") else str(case)


def with_foreign_frames(rate_per_s: int, can_id: int, data: bytes) -> type[Rig]:
    """A class of rigs beside which somebody sends the same frame so many times a second, behind frames of the rig."""

    class Foreign(Rig):
        foreign_ns = 0

        def advance(self, to_ns: int) -> list[Message]:
            frames = super().advance(to_ns)
            while self.foreign_ns <= to_ns:
                frames.append(NodeFrame(self.foreign_ns * 1e-9, can_id, is_extended_id=False, data=data))
                self.foreign_ns += round(1e9 / rate_per_s)
            return frames

    return Foreign


@pytest.mark.parametrize("rate_per_s", [10, 1000])
@pytest.mark.parametrize(("can_id", "name"), [(0x701, "PumpHeartbeat"), (0x702, "LevelHeartbeat")])
def test_foreign_heartbeats_are_named_by_identifier_cause_and_what_to_do(
    can_id: int, name: str, rate_per_s: int
) -> None:
    """The doctor used to advise to look at cable and termination; CAN itself protects the length of a frame."""
    results = examined(LockstepBench(rig=with_foreign_frames(rate_per_s, can_id, b"\x05")))
    result = results[f"{name} integrity"]
    assert result.verdict is FAIL
    assert f" frames of {can_id:#05x} " in result.found
    assert "refused: length (1 byte instead of 8, like a CANopen heartbeat)" in result.found
    assert result.advice == (
        f"another node on the bus uses the identifier {can_id:#05x}: "
        f"give it another CANopen node id than {can_id - 0x700}, or take it off this bus"
    )
    assert results[f"{name} period"].verdict is PASS


def test_frames_of_a_foreign_node_under_the_command_s_identifier_are_named() -> None:
    """They move nothing, and used not to be shown at all."""
    result = examined(LockstepBench(rig=with_foreign_frames(10, 0x201, b"\x01\x02")))["commands of others"]
    assert result.verdict is WARN
    assert result.found.startswith("frames of 0x201 rejected: ")
    assert "length (2 bytes instead of 6); another node on the bus uses the identifier 0x201" in result.found


@pytest.mark.parametrize(
    ("counts", "verdict", "found"),
    [
        ({}, NOT_CHECKED, "not an slcan adapter"),
        ({"refused": 0, "dropped": 0}, PASS, "none rejected, no command refused"),
        ({"refused": 3, "dropped": 0}, WARN, "3 commands refused by the adapter"),
        ({"refused": 0, "dropped": 0, "rejected_payload": 1668}, FAIL, "1,668 lines rejected: 1,668 payload"),
    ],
)
def test_lines_that_an_adapter_spoils_are_shown(counts: dict[str, int], verdict: Verdict, found: str) -> None:
    """They used to be shown by a run's last event only; the doctor blamed cable and termination."""
    result = check_lines(counts)
    assert (result.verdict, result.found) == (verdict, found)
    assert bool(result.advice) == (verdict in (WARN, FAIL))


@cache
def examined_with(what: str) -> dict[str, Result]:
    """Results of a bench with this fault, whose table is JSON; no pump was asked to move."""
    given = json.loads(what)
    bench = LockstepBench().inject(KINDS[given["kind"]].model_validate(given))
    results = examined(bench)
    assert all(not any(data[:4]) for _, _, data in bench.sent)
    return results


@pytest.mark.parametrize(("what", "check", "verdict"), WRONG, ids=name_of)
def test_a_fault_is_found(what: FaultTable, check: str, verdict: Verdict) -> None:
    result = examined_with(what.model_dump_json())[check]
    assert result.verdict is verdict, result
    assert result.advice or verdict is NOT_CHECKED


@pytest.mark.parametrize(
    ("keys", "check", "verdict"),
    [
        ({"levels_period_s": 0.0215}, "LowerLevels period", WARN),
        ({"levels_period_s": 0.03}, "UpperLevels period", FAIL),
        ({"status_period_s": 0.08}, "PumpStatus period", FAIL),
        ({"heartbeat_period_s": 0.11}, "PumpHeartbeat period", WARN),
        ({"heartbeat_period_s": 0.5}, "LevelHeartbeat period", FAIL),
        ({"watchdog_s": 0.15}, "watchdog", FAIL),
        ({"watchdog_s": 0.24}, "watchdog", PASS),
        ({"watchdog_s": 0.26}, "watchdog", PASS),
        ({"watchdog_s": 0.29}, "watchdog", FAIL),
        ({"watchdog_s": 10.0}, "watchdog", FAIL),
    ],
)
def test_wrong_timing_is_found(keys: dict[str, float], check: str, verdict: Verdict) -> None:
    results = examined(LockstepBench(overlay={"nodes": keys}))
    assert results[check].verdict is verdict, results[check]


def test_unsteady_frames_are_found() -> None:
    delays = [fault("frame_delay", "LowerLevels", 0.015, at_s=0.1 * k, until_s=0.1 * k + 0.05) for k in range(40)]
    results = examined(LockstepBench().inject(*delays))
    assert results["LowerLevels period"].verdict is WARN
    assert results["UpperLevels period"].verdict is PASS


def test_the_watchdog_is_not_timed_by_unsteady_status_frames() -> None:
    delays = [fault("frame_delay", "PumpStatus", 0.03, at_s=0.2 * k, until_s=0.2 * k + 0.1) for k in range(200)]
    results = examined(LockstepBench().inject(*delays))
    assert results["watchdog"].verdict is WARN, results["watchdog"]


def test_nodes_of_another_dbc_are_found() -> None:
    results = examined(LockstepBench(fingerprint=contract().fingerprint ^ 1))
    for check in ("pump node contract", "level node contract"):
        assert results[check].verdict is FAIL
        assert f"{contract().fingerprint:#010x}" in results[check].found


@pytest.mark.parametrize(("noise_V", "verdict"), [(0.0005, WARN), (0.004, PASS), (0.006, PASS)])
def test_noise_is_held_against_the_rig_file(noise_V: float, verdict: Verdict) -> None:
    results = examined(LockstepBench(overlay={"sensors": {"noise_V": noise_V, "adc_bits": 16}}))
    assert {results[f"sensor {tank} noise"].verdict for tank in SENSORS} == {verdict}


def test_an_empty_tank_is_not_taken_for_a_stuck_sensor() -> None:
    results = examined(LockstepBench(overlay={"tanks": {"start_V": (0.0, 0.0)}, "sensors": {"noise_V": 0.001}}))
    assert {results[f"sensor {tank} noise"].verdict for tank in SENSORS} == {NOT_CHECKED}


EMPTY = {"tanks": {"start_V": (0.0, 0.0), "hold_until_run": False}}
"""Tanks that are empty, and whose outlets are open."""


@pytest.mark.parametrize("tank", SENSORS)
def test_the_zero_of_an_empty_tank_is_checked(tank: int) -> None:
    """A sensor that shows 0.15 V in an empty tank passed: any reading in range did."""
    results = examined(LockstepBench(overlay=EMPTY).inject(fault("sensor_bias", tank, 0.15)))
    found = results[f"sensor {tank} range"]
    assert found.verdict is WARN
    assert "zero" in found.advice
    assert float(found.found.split()[0]) == pytest.approx(0.15, abs=0.005)
    others = [results[f"sensor {other} range"].verdict for other in SENSORS if other != tank]
    assert others == [PASS] * 3


def test_little_water_that_drains_is_no_wrong_zero() -> None:
    overlay = {"tanks": {"start_V": (0.5, 0.5), "hold_until_run": False}}
    results = examined(LockstepBench(overlay=overlay))
    assert {results[f"sensor {tank} range"].verdict for tank in SENSORS} == {PASS}, results


def test_a_draining_tank_adds_no_noise() -> None:
    results = examined(LockstepBench(overlay={"tanks": {"hold_until_run": False}}))
    assert {results[f"sensor {tank} noise"].verdict for tank in SENSORS} == {PASS}


def tripped_bench() -> LockstepBench:
    bench = LockstepBench()
    with bench.probe() as probe:
        probe.listen(0.2)
        probe.command(enable=True)
        probe.listen(0.5)
    assert bench.pump.state is NodeState.TRIPPED
    bench.sent.clear()
    return bench


def test_a_trip_that_was_there_before_is_left_alone() -> None:
    bench = tripped_bench()
    results = examined(bench)
    assert results["pump node heartbeat"].verdict is WARN
    assert "--clear-trip" in results["pump node heartbeat"].advice
    assert results["watchdog"].verdict is NOT_CHECKED
    assert results["echo latency"].verdict is PASS
    assert bench.pump.state is NodeState.TRIPPED
    assert all(not data[4] & 0b11 for _, _, data in bench.sent)


@pytest.mark.parametrize("volts", [0.0, 2.0])
def test_nothing_is_sent_to_a_node_that_somebody_else_commands(volts: float) -> None:
    bench = LockstepBench().inject(fault("foreign_command", "PumpCommand", volts))
    results = examined(bench)
    assert results["watchdog"].verdict is NOT_CHECKED
    assert results["echo latency"].verdict is NOT_CHECKED
    assert bench.sent == []


def test_nothing_is_sent_to_a_node_that_is_not_heard() -> None:
    bench = LockstepBench().inject(fault("node_silent", "pump"))
    examined(bench)
    assert bench.sent == []


def test_somebody_who_commands_in_the_midst_ends_it_with_one_command_of_zero() -> None:
    bench = LockstepBench().inject(fault("foreign_command", "PumpCommand", 0.0, at_s=5.0))
    results = examined(bench)
    assert "another sender" in results["examination"].found
    assert len([t_ns for t_ns, _, _ in bench.sent if t_ns >= 6_100_000_000]) == 0


def test_a_bus_that_goes_away_is_a_failed_check() -> None:
    bench = LockstepBench()
    receive = bench.receive

    def cut(timeout_s: float) -> Frame | None:
        if bench.now_ns() > 5_000_000_000:
            bench.is_up, bench.last_error = False, "cable pulled"
            return None
        return receive(timeout_s)

    vars(bench)["receive"] = cut
    results = examined(bench)
    assert results["examination"].verdict is FAIL
    assert "cable pulled" in results["examination"].found


WITH_PUMPS = ("pump 1 voltage", "pump 1 to tank 1", "pump 1 to tank 4")
MORE_PUMPS = ("pump 2 voltage", "pump 2 to tank 2", "pump 2 to tank 3")


def test_with_pumps_each_is_moved_and_seen_in_its_two_tanks() -> None:
    bench = LockstepBench()
    results = examined(bench, with_pumps=True)
    assert {results[name].verdict for name in (*WITH_PUMPS, *MORE_PUMPS)} == {PASS}, results
    assert bench.highest_voltage == pytest.approx(3.0, abs=0.01)
    assert bench.pump.applied_V == (0.0, 0.0)
    assert not any(all(change.applied_V) for change in bench.changes if change.node == "pump"), "one at a time"


@pytest.mark.parametrize("draining", [True, False])
def test_with_pumps_the_response_is_that_of_the_pump_whatever_drains(draining: bool) -> None:
    bench = LockstepBench(overlay={"tanks": {"hold_until_run": not draining, "start_V": (2.0, 2.0)}})
    results = examined(bench, with_pumps=True)
    assert {results[name].verdict for name in (*WITH_PUMPS, *MORE_PUMPS)} == {PASS}, results


@pytest.mark.parametrize(
    ("what", "check", "verdict"),
    [
        (fault("pump_dead", 1), "pump 1 to tank 1", FAIL),
        (fault("pump_dead", 2), "pump 2 to tank 3", FAIL),
        (fault("pump_effectiveness", 1, 0.4), "pump 1 to tank 4", WARN),
        (fault("pump_effectiveness", 2, 0.4), "pump 2 to tank 2", WARN),
        (fault("reservoir_low"), "pump 1 to tank 1", FAIL),
        (fault("valve_split", 1, 0.1), "pump 1 to tank 1", FAIL),
    ],
    ids=name_of,
)
def test_with_pumps_a_weak_or_dead_pump_is_found(what: FaultTable, check: str, verdict: Verdict) -> None:
    bench = LockstepBench().inject(what)
    results = examined(bench, with_pumps=True)
    assert results[check].verdict is verdict, results
    assert bench.pump.applied_V == (0.0, 0.0)


@pytest.mark.parametrize(("gain", "advice", "other"), [(0.4, "weak", "more water"), (3.14, "more water", "weak")])
def test_with_pumps_the_advice_is_about_the_right_direction(gain: float, advice: str, other: str) -> None:
    """A pump with 314 % of the expected rise was said to be weak."""
    given = (3.33 * gain, 3.35)
    overlay = {"pumps": {"gain_cm3_Vs": given}, "tanks": {"start_V": (1.0, 1.0)}}
    results = examined(LockstepBench(overlay=overlay), with_pumps=True)
    for check in ("pump 1 to tank 1", "pump 1 to tank 4"):
        assert results[check].verdict is WARN, results[check]
        assert advice in results[check].advice
        assert other not in results[check].advice


def test_with_pumps_a_status_that_stays_away_ends_it_at_zero() -> None:
    bench = LockstepBench()
    send = bench.send

    def sending(frame_id: int, data: bytes, timestamp_s: float, **kind: Any) -> bool:
        if any(data[:4]) and not bench.rig.truth().faults:
            bench.inject(fault("frame_loss", "PumpStatus", 1.0))
        return send(frame_id, data, timestamp_s, **kind)

    vars(bench)["send"] = sending
    results = examined(bench, with_pumps=True)
    assert results["pump 1 voltage"].verdict is FAIL
    assert results["pumps"].verdict is NOT_CHECKED
    assert bench.pump.applied_V == (0.0, 0.0)


@pytest.mark.parametrize("what", [fault("sensor_open", 2), fault("frame_loss", "PumpCommand", 0.3)], ids=name_of)
def test_no_pump_is_moved_after_a_failed_check(what: FaultTable) -> None:
    bench = LockstepBench().inject(what)
    results = examined(bench, with_pumps=True)
    assert results["pumps"].verdict is NOT_CHECKED
    assert bench.highest_voltage == 0.0


def test_no_pump_is_moved_over_a_full_tank() -> None:
    bench = LockstepBench(overlay={"tanks": {"start_V": (3.6, 3.6)}}).inject(fault("outlet_block", 1, 1.0))
    results = examined(bench, with_pumps=True)
    assert results["pumps"].found == "a tank is nearly full"
    assert bench.highest_voltage == 0.0


def test_no_pump_is_moved_while_the_node_is_tripped() -> None:
    bench = tripped_bench()
    results = examined(bench, with_pumps=True)
    assert results["pumps"].verdict is NOT_CHECKED
    assert bench.highest_voltage == 0.0


@pytest.mark.parametrize("after_s", [0.5, 3.2, 3.7, 4.1, 4.6, 7.0, 9.0, 11.5, 12.6, 13.5, 15.0, 17.5, 19.0, 21.0])
def test_whenever_it_is_interrupted_the_node_ends_ready_at_zero(after_s: float) -> None:
    bench = LockstepBench()
    until_ns = bench.now_ns() + round(after_s * 1e9)
    with (
        pytest.raises(InterruptedByUserError, match="SIGINT"),
        bench.probe(lambda: "SIGINT" if bench.now_ns() >= until_ns else "") as probe,
    ):
        examine(probe, WANTS, 3.0, with_pumps=True)
    bench.rig.advance(bench.now_ns() + 400_000_000)
    assert (bench.pump.state, bench.pump.applied_V) == (NodeState.READY, (0.0, 0.0))
    bench.close()


@pytest.mark.parametrize("after_s", [4.0, 13.5, 15.0, 19.5])
def test_whatever_raises_the_node_ends_at_zero(after_s: float) -> None:
    bench = LockstepBench()
    until_ns, receive = bench.now_ns() + round(after_s * 1e9), bench.receive

    def failing(timeout_s: float) -> Frame | None:
        if bench.now_ns() >= until_ns:
            raise RuntimeError("a bug")
        return receive(timeout_s)

    vars(bench)["receive"] = failing
    with pytest.raises(RuntimeError, match="a bug"), bench.probe() as probe:
        examine(probe, WANTS, 3.0, with_pumps=True)
    assert bench.pump.applied_V == (0.0, 0.0)
    last = bench.sent[-1][2]
    assert not any(last[:4])
    assert not last[4] & 1
    bench.close()


@pytest.mark.parametrize("after_s", [1.5, 4.6, 5.2, 5.9, 6.4, 7.7, 9.1, 10.0, 11.0])
def test_a_host_that_stands_still_for_a_moment_makes_no_check_fail(after_s: float) -> None:
    bench = LockstepBench()
    receive = bench.receive
    stalls: list[int] = []

    def stalling(timeout_s: float) -> Frame | None:
        if not stalls and bench.now_ns() >= after_s * 1e9:
            stalls.append(bench.now_ns())
            bench._wait(bench.now_ns() + 400_000_000)  # frames pile up and come all at once
        return receive(timeout_s)

    vars(bench)["receive"] = stalling
    results = examined(bench)
    assert stalls
    assert not [result for result in results.values() if result.verdict is FAIL]
    assert bench.pump.state is NodeState.READY
