"""The time from a command to its echo in the pump node's status; disabled commands of 0 V, one at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.core.counted import counted
from hil.probe.bus_probe import STATUS_WAIT_S, Probe
from hil.probe.check_result import Result, failed, passed, warned
from hil.probe.observation import STATUS

COMMANDS = 100
STEPS = 10
"""The commands are sent at so many different phases of the status frame's period."""
MARGIN_S = 0.01
"""For transport and a busy computer, in addition to the status frame's period."""


@dataclass(frozen=True, slots=True)
class Echoes:
    """latency_s : from each echoed command to the status with its echo. missing : number not echoed in time.

    uncounted : number of commands sent minus the node's count of accepted commands.
    """

    latency_s: tuple[float, ...]
    missing: int
    uncounted: int


def measure(probe: Probe, age_max_s: float, commands: int = COMMANDS) -> Echoes:
    """Send commands and wait for each echo, as long as a run would."""
    cycle_s = probe.contract.frames[STATUS].cycle_s
    before = probe.await_status(STATUS_WAIT_S)
    latencies_s: list[float] = []
    for number in range(commands):
        sent_ns = probe.command()
        counter = probe.counter
        echo = probe.await_status(age_max_s, lambda arrival, wanted=counter: arrival.values["Echo"] == wanted)  # type: ignore[misc]
        if echo is not None:
            latencies_s.append((echo.t_ns - sent_ns) * 1e-9)
        probe.listen(number % STEPS / STEPS * cycle_s)
    after = probe.await_status(STATUS_WAIT_S)
    uncounted = commands
    if before is not None and after is not None:
        uncounted = commands - int(after.values["Accepted"] - before.values["Accepted"]) % 256
    return Echoes(tuple(latencies_s), commands - len(latencies_s), uncounted)


def check_echo(echoes: Echoes, cycle_s: float, age_max_s: float) -> Result:
    """Compare with the status frame's period, and with safety.echo_age_max_s, at which a run trips."""
    check = "echo latency"
    sent = len(echoes.latency_s) + echoes.missing
    if not echoes.latency_s:
        return failed(
            check,
            f"none of {counted(sent, 'command')} echoed",
            "the node receives no commands: check cable and bit rate",
        )
    p50_s, p99_s = np.quantile(echoes.latency_s, (0.5, 0.99))
    found = f"p50 {p50_s * 1e3:.1f} ms, p99 {p99_s * 1e3:.1f} ms of {counted(sent, 'command')}"
    if echoes.uncounted:
        found += f"; {echoes.uncounted} not counted"
        advice = "commands are lost, or the node's Accepted is wrong: run hil conformance"
        return failed(check, found, advice)
    if echoes.missing:
        found += f"; {echoes.missing} not echoed within {age_max_s:g} s"
        return failed(
            check, found, "a run would trip: the bus, the adapter or the computer is too busy (safety.echo_age_max_s)"
        )
    if p99_s > cycle_s + MARGIN_S:
        return warned(
            check, found, "longer than the status frame's period: the bus, the adapter or the computer is busy"
        )
    return passed(check, found)
