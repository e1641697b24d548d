"""All conformance tests by name, in order, and their results. docs/reference/firmware.md describes each test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from hil.conformance import boot_tests, command_tests, trip_tests, voltage_tests
from hil.conformance.dialogue import ConformanceTest, Dialogue
from hil.core.counted import counted
from hil.core.types import NodeState, Pair
from hil.doctor import check_watchdog
from hil.doctor.check_frames import check_integrity, check_period
from hil.doctor.check_nodes import check_contract
from hil.doctor.check_sensors import check_range
from hil.probe.bus_probe import InterruptedByUserError, Probe, ProbeError
from hil.probe.check_result import Result, Verdict, failed, has_failed, not_checked, passed, warned
from hil.probe.observation import HEARTBEATS, LEVEL_FRAMES, STATUS, Observation

LISTEN_S = 5.0
PERIOD_TOLERANCE = 0.05
MAX_ATTEMPTS = 3
LATE_PERIODS = 2.0
SEE = "docs/reference/firmware.md"

COMMANDS: tuple[tuple[str, ConformanceTest], ...] = (
    ("takes valid commands", command_tests.takes_valid),
    ("runs when enabled", command_tests.runs_when_enabled),
    ("takes a newer counter", command_tests.takes_newer),
    ("refuses a repeated counter", command_tests.refuses_repeated),
    ("refuses an old counter", command_tests.refuses_old),
    ("takes any counter after silence", command_tests.resynchronises),
    ("refuses a wrong CRC", command_tests.refuses_wrong_crc),
    ("refuses every flipped bit", command_tests.refuses_flipped_bits),
    ("refuses another data id", command_tests.refuses_other_data_id),
    ("refuses a wrong length", command_tests.refuses_wrong_length),
    ("refuses an extended frame", command_tests.refuses_extended),
    ("refuses a remote frame", command_tests.refuses_remote),
    ("refuses a voltage out of range", command_tests.refuses_out_of_range),
    ("ignores spare bits", command_tests.ignores_spare_bits),
    ("needs no commands when ready", command_tests.stays_ready),
)
TRIPS: tuple[tuple[str, ConformanceTest], ...] = (
    ("watchdog is not fed by refused frames", trip_tests.is_not_fed_by_refused),
    ("trip is latched", trip_tests.is_latched),
    ("clearing needs rest", trip_tests.clear_must_be_at_rest),
    ("trip is cleared", trip_tests.clears),
    ("clearing is harmless when ready", trip_tests.clear_is_harmless),
    ("clearing is ignored in run", trip_tests.clear_is_ignored_in_run),
)
WITH_PUMPS: tuple[tuple[str, ConformanceTest], ...] = (
    ("applies what is commanded", voltage_tests.applies),
    ("refuses while running", voltage_tests.refuses_while_running),
    ("trips to 0 V", voltage_tests.trips_to_zero),
    ("never moves after a trip", voltage_tests.never_moves_after_a_trip),
)
WATCHDOG, AT_ZERO, BOOTS = "watchdog after 250 ms", "waits at 0 V", "does not reboot"
POWER_CYCLE = "boots at 0 V"
PUMP_FRAMES, LEVEL_NODE_FRAMES = (STATUS, HEARTBEATS["pump node"]), (*LEVEL_FRAMES, HEARTBEATS["level node"])


@dataclass(frozen=True, slots=True)
class Plan:
    """What to test. sensor_range_V : of the rig file. power_cycle_s : time to switch a node off and on; 0: no test."""

    pump_node: bool
    level_node: bool
    with_pumps: bool
    sensor_range_V: Pair
    power_cycle_s: float = 0.0


def run_suite(probe: Probe, plan: Plan, ask: Callable[[str], None] = lambda _: None) -> list[Result]:
    """All results. ask : shows a request to the user. Raises InterruptedByUserError; a bus that fails is a result."""
    results: list[Result] = []
    begin_ns = probe.now_ns
    try:
        observed = probe.listen(LISTEN_S)
        if observed.of("PumpCommand"):
            return [failed("alone on the bus", "another sender commands the pump node", "stop the other controller")]
        if plan.pump_node:
            results += _periodic(observed, "pump node", PUMP_FRAMES)
            results += _command_tests_or_clear(probe, observed, with_pumps=plan.with_pumps)
            results.append(_boots(probe.listener.observed(begin_ns, probe.now_ns), "pump node"))
            if plan.power_cycle_s > 0.0:
                ask(f"Switch the pump node off and on again, within {plan.power_cycle_s:g} s.")
                results.append(_power_cycle(probe, plan.power_cycle_s))
        if plan.level_node:
            results += _periodic(observed, "level node", LEVEL_NODE_FRAMES)
            results += _levels(observed, plan.sensor_range_V)
            results.append(_boots(probe.listener.observed(begin_ns, probe.now_ns), "level node"))
    except ProbeError as error:
        results.append(
            failed("conformance test", f"stopped: {error}", "check adapter, cable, node, and other senders on the bus")
        )
    return results


def _periodic(observed: Observation, node: str, frames: tuple[str, ...]) -> list[Result]:
    """Periods, counters and CRCs of a node's frames, and its contract."""
    results = []
    for name in frames:
        results += [check_period(observed, name, PERIOD_TOLERANCE), _intact(observed, name)]
    return [*results, check_contract(observed, node, HEARTBEATS[node])]


def _intact(observed: Observation, name: str) -> Result:
    """CAN has a CRC of its own, so a refused frame was sent wrong. Lost frames can be the computer's fault."""
    result = check_integrity(observed, name)
    is_wrong = result.verdict is Verdict.WARN and observed.refused(name).total() > 0
    if not is_wrong:
        return result
    advice = f"{SEE}; {result.advice}" if observed.wrong_lengths(name) else SEE
    return failed(result.check, result.found, advice)


def _command_tests_or_clear(probe: Probe, observed: Observation, *, with_pumps: bool) -> list[Result]:
    """After an interruption the node is ready, at 0 V, and not tripped."""
    try:
        return _command_tests(probe, observed, with_pumps=with_pumps)
    except InterruptedByUserError:
        probe.command(clear=True)
        raise


def _command_tests(probe: Probe, observed: Observation, *, with_pumps: bool) -> list[Result]:
    """All tests that need commands."""
    results = [_waits(observed)]
    if has_failed(results):
        return [*results, not_checked("all tests with commands", "the pump node does not wait at 0 V")]
    node = Dialogue(probe)
    results += [_run_test(node, name, test) for name, test in COMMANDS]
    results.append(_watchdog(node))
    results += [_run_test(node, name, test) for name, test in TRIPS]
    if with_pumps:
        for name, test in WITH_PUMPS:
            if has_failed(results):
                results.append(not_checked(name, "no pump is moved after a failed test"))
            else:
                results.append(_run_test(node, name, test))
    node.settle()
    return results


def _power_cycle(probe: Probe, within_s: float) -> Result:
    """Off and on again: it boots at 0 V with the next boot count and nothing accepted, and waits for commands."""
    wrong = boot_tests.boots_at_rest(probe, within_s)
    return failed(POWER_CYCLE, wrong, SEE) if wrong else passed(POWER_CYCLE, "correct")


def _run_test(node: Dialogue, name: str, test: ConformanceTest) -> Result:
    """Run a test; repeat it if status frames were late meanwhile: then the test's own frames may be late too."""
    wrong = ""
    for number in range(MAX_ATTEMPTS):
        begin_ns = node.probe.now_ns
        wrong = test(node) if node.settle() else "the node can't be brought to ready"
        if not wrong and number:
            found = f"correct at attempt {number + 1}; status frames were late before"
            return warned(name, found, "the computer, the bus or the node is busy: test again")
        if not wrong:
            return passed(name, "correct")
        if not _had_late_status(node.probe.listener.observed(begin_ns, node.probe.now_ns)):
            return failed(name, wrong, SEE)
    return failed(name, f"{wrong} (status frames were late, {MAX_ATTEMPTS} times)", SEE)


def _had_late_status(seen: Observation) -> bool:
    """Whether more than two status periods passed without a status frame."""
    cycle_ns = seen.contract.frames[STATUS].cycle_s * 1e9
    times_ns = [seen.begin_ns, *(status.t_ns for status in seen.of(STATUS)), seen.end_ns]
    return max(b - a for a, b in pairwise(times_ns)) > LATE_PERIODS * cycle_ns


def _watchdog(node: Dialogue) -> Result:
    if not node.settle():
        return failed(WATCHDOG, "the node can't be brought to ready", SEE)
    return check_watchdog.check_watchdog(check_watchdog.measure(node.probe), WATCHDOG)


def _waits(observed: Observation) -> Result:
    """Ready or tripped, both outputs at 0 V, in every status frame."""
    statuses = observed.of(STATUS)
    if not statuses:
        return failed(AT_ZERO, "no PumpStatus", SEE)
    states = {NodeState(int(status.values["State"])) for status in statuses}
    highest_V = max(max(status.values["Applied1"], status.values["Applied2"]) for status in statuses)
    found = f"{', '.join(sorted(state.name.lower() for state in states))}, at most {highest_V:.4g} V"
    if highest_V > 0.0 or not states <= {NodeState.BOOT, NodeState.READY, NodeState.TRIPPED}:
        return failed(AT_ZERO, found, SEE)
    return passed(AT_ZERO, found)


def _boots(seen: Observation, node: str) -> Result:
    """The boot count does not change."""
    name = f"{node} {BOOTS}"
    counts = [int(beat.values["BootCount"]) for beat in seen.of(HEARTBEATS[node])]
    if not counts:
        return failed(name, "no heartbeat", SEE)
    if len(set(counts)) > 1:
        return failed(name, f"boot count went from {counts[0]} to {counts[-1]}", SEE)
    return passed(name, f"boot count {counts[0]} in {counted(len(counts), 'heartbeat')}")


def _levels(observed: Observation, range_V: Pair) -> list[Result]:
    """The level node runs; each reading is in range with status OK."""
    beat = observed.last(HEARTBEATS["level node"])
    state = None if beat is None else NodeState(int(beat.values["State"]))
    word = "no heartbeat" if state is None else state.name.lower()
    runs = passed("level node runs", word) if state is NodeState.RUN else failed("level node runs", word, SEE)
    results = [runs]
    for name, tanks in LEVEL_FRAMES.items():
        for tank in tanks:
            arrivals = observed.of(name)
            readings_V = [arrival.values[f"Level{tank}"] for arrival in arrivals]
            statuses = [int(arrival.values[f"Status{tank}"]) for arrival in arrivals]
            results.append(check_range(tank, readings_V, statuses, range_V))
    return results


def conforms(results: list[Result]) -> bool:
    """Whether no test failed and none was left out."""
    return all(result.verdict in (Verdict.PASS, Verdict.WARN) for result in results)
