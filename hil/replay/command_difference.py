"""Recorded commands beside those of today: the first difference beyond the tolerance, and how many there are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan

from hil.replay.open_loop import Replayed
from hil.replay.recorded_steps import NOTHING, RecordedStep
from hil.wire.contract import Contract, Decoded

COMPARED = ("Command1", "Command2", "Enable", "ClearTrip", "StartPhase")
"""Signals of PumpCommand. Counter and Crc say nothing of the controller's behaviour."""

VOLTAGES = ("Command1", "Command2")
SENT = "sent"
"""Stands for a signal where one side sent a command and the other did not: 1 and 0."""


@dataclass(frozen=True, slots=True)
class CommandDifference:
    """One signal of one step that differs. step : its number, from 0. t_s : run time; None before it began.

    recorded, replayed : in V for voltages, otherwise 0 or 1. tolerance : in the same unit.
    """

    signal: str
    step: int
    t_s: float | None
    recorded: float
    replayed: float
    tolerance: float

    def __str__(self) -> str:
        at = f"step {self.step}" if self.t_s is None else f"{self.t_s:.3f} s (step {self.step})"
        if self.signal == SENT:
            first, second = ("a command", "none") if self.recorded else ("no command", "one")
            return f"at {at}: {first} was recorded, {second} is sent today"
        unit = " V" if self.signal in VOLTAGES else ""
        by = f", tolerance {self.tolerance:g}{unit}" if unit else ""
        return f"{self.signal} at {at}: recorded {self.recorded:g}{unit}, today {self.replayed:g}{unit}{by}"


@dataclass(frozen=True, slots=True)
class CommandComparison:
    """All commands of a record.

    compared : commands that both sides sent, or one. differing : those beyond the tolerance. rounded : those that
    differ, but not beyond it. largest_V : largest difference of a voltage.
    """

    compared: int
    differing: int
    rounded: int
    largest_V: float
    first: CommandDifference | None


def compare_commands(
    contract: Contract,
    steps: Sequence[RecordedStep],
    expected: Sequence[bytes],
    replayed: Replayed,
    tolerance_V: float,
) -> CommandComparison:
    """Step by step. expected : payloads; empty where nothing was sent.

    A step that is in ticks.csv and sent nothing is not compared: the bus did not take its command.
    """
    layout = contract.frames["PumpCommand"]
    slack_V = tolerance_V + 1e-9
    compared = differing = rounded = 0
    largest_V, first = 0.0, None
    for number, (step, before, now) in enumerate(zip(steps, expected, replayed.payloads, strict=True)):
        if step.command == NOTHING and not before:
            continue
        compared += 1
        if before == now:
            continue
        t_s = replayed.step_s[number] if isnan(step.t_s) else step.t_s
        found = _all_of(number, t_s, layout.decode(before) if before else None, layout.decode(now) if now else None)
        largest_V = max([largest_V, *(abs(d.recorded - d.replayed) for d in found if d.signal in VOLTAGES)])
        beyond = [d for d in found if d.signal not in VOLTAGES or abs(d.recorded - d.replayed) > slack_V]
        differing += bool(beyond)
        rounded += bool(found) and not beyond
        if beyond and first is None:
            one = beyond[0]
            tolerance = tolerance_V if one.signal in VOLTAGES else 0.0
            first = CommandDifference(one.signal, number, one.t_s, one.recorded, one.replayed, tolerance)
    return CommandComparison(compared, differing, rounded, largest_V, first)


def _all_of(number: int, t_s: float, before: Decoded | None, now: Decoded | None) -> list[CommandDifference]:
    """All signals of a step that differ."""
    if before is None or now is None:
        pairs = [(SENT, float(before is not None), float(now is not None))]
    else:
        pairs = [(name, before[name], now[name]) for name in COMPARED if before[name] != now[name]]
    at_s = None if isnan(t_s) else t_s
    return [CommandDifference(name, number, at_s, old, new, 0.0) for name, old, new in pairs if old != new]
