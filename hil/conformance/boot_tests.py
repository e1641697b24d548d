"""The pump node after its power returns. A person has to switch it off and on."""

from __future__ import annotations

from hil.core.types import NodeState
from hil.probe.bus_probe import Probe
from hil.probe.observation import HEARTBEATS, STATUS

HEARTBEAT = HEARTBEATS["pump node"]
SETTLE_S = 2.0
"""Time for a node to boot."""


def boots_at_rest(probe: Probe, within_s: float) -> str:
    """Wait for another boot count; return "" if the node is correct from then on, otherwise what is wrong."""
    before = probe.listener.newest(HEARTBEAT)
    if before is None:
        return "no heartbeat before"
    count = int(before.values["BootCount"])
    begin_ns = probe.now_ns
    deadline_ns = begin_ns + round(within_s * 1e9)
    beat = probe.listen_until(deadline_ns, lambda a: a.name == HEARTBEAT and int(a.values["BootCount"]) != count)
    if beat is None:
        return f"no other boot count within {within_s:g} s"
    if (wanted := (count + 1) % 65536) != (seen := int(beat.values["BootCount"])):
        return f"boot count {seen} after {count}, must be {wanted}"
    probe.listen(SETTLE_S)
    statuses = probe.listener.observed(begin_ns, probe.now_ns).of(STATUS)
    if any(max(status.values["Applied1"], status.values["Applied2"]) > 0.0 for status in statuses):
        return "it applied a voltage"
    states = [NodeState(int(status.values["State"])) for status in statuses]
    if not states or NodeState.RUN in states or states[-1] is not NodeState.READY:
        return f"in state {states[-1].name.lower() if states else '?'} {SETTLE_S:g} s later, must be ready"
    if int(statuses[-1].values["Accepted"]) != 0 or int(statuses[-1].values["TripCause"]) != 0:
        return "it still has commands or a trip from before"
    return ""
