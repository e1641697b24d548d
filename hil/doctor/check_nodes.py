"""Nodes: heartbeats, states, boot counts and DBC."""

from __future__ import annotations

from hil.core.types import NodeState
from hil.probe.check_result import Result, failed, passed, warned
from hil.probe.observation import HEARTBEATS, STATUS, Observation

EXPECTED = {"pump node": NodeState.READY, "level node": NodeState.RUN}
IN_OTHER_STATES = {
    NodeState.BOOT: "it is booting: wait and check again",
    NodeState.READY: "it does not measure: check its supply and sensors",
    NodeState.RUN: "another sender commands it: stop the other controller",
    NodeState.TRIPPED: "find out why it tripped, then clear the trip: hil run --clear-trip",
}


def check_nodes(observation: Observation) -> list[Result]:
    """Heartbeat, contract and, for the pump node, outputs at rest."""
    results = []
    for node, name in HEARTBEATS.items():
        results += [check_heartbeat(observation, node, name), check_contract(observation, node, name)]
    return [*results, check_rest(observation)]


def check_heartbeat(observation: Observation, node: str, name: str) -> Result:
    """State and boot count; a count that changes means that the node has rebooted."""
    check = f"{node} heartbeat"
    beats = observation.of(name)
    if not beats:
        return failed(
            check, f"none in {observation.duration_s:.1f} s", "is the node switched on and connected to this bus?"
        )
    boots = [int(beat.values["BootCount"]) for beat in beats]
    state = NodeState(int(beats[-1].values["State"]))
    found = f"{state.name.lower()}, boot count {boots[-1]}"
    if len(set(boots)) > 1:
        found = f"boot count went from {boots[0]} to {boots[-1]}"
        return failed(check, found, "it reboots again and again: check its supply and its own watchdog")
    if state is not EXPECTED[node]:
        return warned(check, found, IN_OTHER_STATES[state])
    return passed(check, found)


def check_contract(observation: Observation, node: str, name: str) -> Result:
    """The CRC-32 of the DBC that the node was built with."""
    check, ours = f"{node} contract", observation.contract.fingerprint
    beat = observation.last(name)
    if beat is None:
        return failed(check, "unknown: no heartbeat", "is the node switched on and connected to this bus?")
    theirs = int(beat.values["Contract"])
    if theirs != ours:
        found = f"{theirs:#010x}, this bench.dbc is {ours:#010x}"
        return failed(check, found, "build its firmware with this bench.dbc, or use the DBC that it was built with")
    return passed(check, f"{theirs:#010x}")


def check_rest(observation: Observation) -> Result:
    """Whether both outputs are at 0 V without commands."""
    check = "pump node at rest"
    statuses = observation.of(STATUS)
    if not statuses:
        return failed(check, "no PumpStatus", "is the node switched on and connected to this bus?")
    highest_V = max(max(status.values["Applied1"], status.values["Applied2"]) for status in statuses)
    if highest_V > 0.0:
        return failed(
            check, f"up to {highest_V:.4g} V applied", "cut the pumps' supply: this program has commanded nothing"
        )
    return passed(check, "0 V on both pumps")


def is_free(observation: Observation) -> bool:
    """Whether the pump node waits for commands at 0 V, and no other sender commands it."""
    statuses = observation.of(STATUS)
    return (
        bool(statuses)
        and not observation.of("PumpCommand")
        and all(status.values["Applied1"] == status.values["Applied2"] == 0.0 for status in statuses)
        and NodeState(int(statuses[-1].values["State"])) in (NodeState.READY, NodeState.TRIPPED)
    )
