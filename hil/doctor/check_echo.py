"""How long a command takes until the pump node's status echoes it: disabled commands, 0 V, one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.probe.bus_probe import PATIENCE_S, Probe
from hil.probe.observation import STATUS
from hil.probe.result import Result, failed, passed, warned

COMMANDS = 100
STEPS = 10
"""Commands are spread over so many phases of the status frame's period."""
MARGIN_S = 0.01
"""For transport and a busy host, on top of the status frame's period."""


@dataclass(frozen=True, slots=True)
class Echoes:
    """latency_s : of the commands echoed, until the status that echoes it. missing : those not echoed in time.

    uncounted : by how many the node's count of accepted commands differs from those sent.
    """

    latency_s: tuple[float, ...]
    missing: int
    uncounted: int


def measure(probe: Probe, age_max_s: float, commands: int = COMMANDS) -> Echoes:
    """Send them and wait for each echo, for as long as a run would."""
    cycle_s = probe.contract.frames[STATUS].cycle_s
    before = probe.await_status(PATIENCE_S)
    latencies_s: list[float] = []
    for number in range(commands):
        sent_ns = probe.command()
        counter = probe.counter
        echo = probe.await_status(age_max_s, lambda arrival, wanted=counter: arrival.values["Echo"] == wanted)  # type: ignore[misc]
        if echo is not None:
            latencies_s.append((echo.t_ns - sent_ns) * 1e-9)
        probe.listen(number % STEPS / STEPS * cycle_s)
    after = probe.await_status(PATIENCE_S)
    uncounted = commands
    if before is not None and after is not None:
        uncounted = commands - int(after.values["Accepted"] - before.values["Accepted"]) % 256
    return Echoes(tuple(latencies_s), commands - len(latencies_s), uncounted)


def check_echo(echoes: Echoes, cycle_s: float, age_max_s: float) -> Result:
    """Against the status frame's period, and safety.echo_age_max_s, at which a run trips."""
    check = "echo latency"
    sent = len(echoes.latency_s) + echoes.missing
    if not echoes.latency_s:
        return failed(check, f"none of {sent} commands echoed", "does the node hear us? Look at cable and bit rate")
    p50_s, p99_s = np.quantile(echoes.latency_s, (0.5, 0.99))
    found = f"p50 {p50_s * 1e3:.1f} ms, p99 {p99_s * 1e3:.1f} ms of {sent} commands"
    if echoes.uncounted:
        found += f"; {echoes.uncounted} not counted"
        advice = "commands get lost, or the node's Accepted is wrong: hil conformance tells"
        return failed(check, found, advice)
    if echoes.missing:
        found += f"; {echoes.missing} not echoed within {age_max_s:g} s"
        return failed(check, found, "a run would trip: a busy bus, adapter or host (safety.echo_age_max_s)")
    if p99_s > cycle_s + MARGIN_S:
        return warned(check, found, "more than the status frame's period: a busy bus, adapter or host")
    return passed(check, found)
