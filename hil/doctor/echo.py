"""How long a command takes until the pump node's status echoes it: disabled commands, 0 V, one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.doctor.observation import STATUS
from hil.doctor.probe import Probe
from hil.doctor.result import Result, failed, passed, warned

COMMANDS = 100
PATIENCE_S = 0.3
STEPS = 10
"""Commands are spread over so many phases of the status frame's period."""
MARGIN_S = 0.01
"""For transport and a busy host, on top of the status frame's period."""


@dataclass(frozen=True, slots=True)
class Echoes:
    """latency_s : of the commands echoed, until the status that echoes it. missing : commands never echoed.

    uncounted : by how many the node's count of accepted commands differs from those sent.
    """

    latency_s: tuple[float, ...]
    missing: int
    uncounted: int


def measure(probe: Probe, commands: int = COMMANDS) -> Echoes:
    """Send them and wait for each echo."""
    cycle_s = probe.contract.frames[STATUS].cycle_s
    before = probe.await_status(4 * cycle_s)
    latencies_s: list[float] = []
    for number in range(commands):
        sent_ns = probe.command()
        counter = probe.counter
        echo = probe.await_status(PATIENCE_S, lambda arrival, wanted=counter: arrival.values["Echo"] == wanted)  # type: ignore[misc]
        if echo is not None:
            latencies_s.append((echo.t_ns - sent_ns) * 1e-9)
        probe.listen(number % STEPS / STEPS * cycle_s)
    after = probe.await_status(4 * cycle_s)
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
    if echoes.missing or echoes.uncounted:
        found += f"; {echoes.missing} not echoed, {echoes.uncounted} not counted"
        advice = "commands get lost, or the node's Echo and Accepted are wrong: hil conformance tells"
        return failed(check, found, advice)
    if p99_s > age_max_s:
        return failed(check, found, f"a run trips at {age_max_s:g} s (safety.echo_age_max_s)")
    if p99_s > cycle_s + MARGIN_S:
        return warned(check, found, "more than the status frame's period: a busy bus, adapter or host")
    return passed(check, found)
