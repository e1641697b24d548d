"""What a run says on its control channel, as records that the panel can show. See docs/reference/control-channel.md.

A message of a later version may have keys more, or lack some: what is missing is shown as unknown and is no error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hil.core.types import Pair, Quad

PRIORITIES = ("high", "medium", "low")
"""In the order of the alarm list."""


@dataclass(frozen=True, slots=True)
class ShownRun:
    """The greeting of a run: what stays the same as long as it lasts.

    duration_s : nan for a run that ends by hand. level_max_cm : level above which the run trips. height_cm : (4,) rims.
    level_gain_V_cm : of the level signals. range_V : of the pumps' commands. bypass_max_s : longest bypass.
    attended_s : after so long without an operator the run gives an alarm; 0 for never.
    """

    folder: str = ""
    scenario: str = ""
    pid: int = 0
    duration_s: float = math.nan
    level_max_cm: float = 20.0
    height_cm: Quad = (20.0, 20.0, 20.0, 20.0)
    level_gain_V_cm: float = 0.5
    range_V: Pair = (0.0, 10.0)
    bypassable: tuple[str, ...] = ()
    bypass_max_s: float = 0.0
    attended_s: float = 0.0


@dataclass(frozen=True, slots=True)
class ShownAlarm:
    """A row of the alarm list. Times in s; since_s on the run's clock."""

    key: str
    title: str
    priority: str = "low"
    state: str = "active"
    since_s: float = math.nan
    count: int = 1
    respond_s: float = math.nan
    cause: str = ""
    action: str = ""
    shelved_s: float = 0.0

    @property
    def rank(self) -> tuple[int, int, float]:
        """Where it is in the list: not acknowledged before acknowledged before shelved, then priority, then age."""
        states = ("active", "returned", "acknowledged", "shelved")
        state = states.index(self.state) if self.state in states else 0
        priority = PRIORITIES.index(self.priority) if self.priority in PRIORITIES else 0
        return (max(state - 1, 0), priority, self.since_s if math.isfinite(self.since_s) else 0.0)


@dataclass(frozen=True, slots=True)
class ShownState:
    """The run at one step. Levels and flows in tank order 1 .. 4; a number that is not known is nan."""

    t_s: float = math.nan
    mode: str = "?"
    is_held: bool = False
    is_starting: bool = False
    measured_cm: Quad = (math.nan,) * 4
    estimated_cm: Quad = (math.nan,) * 4
    trusted: tuple[bool, bool, bool, bool] = (True, True, True, True)
    reference_cm: Pair = (math.nan,) * 2
    target_cm: Pair = (math.nan,) * 2
    command_V: Pair = (math.nan,) * 2
    applied_V: Pair = (math.nan,) * 2
    effectiveness: Pair = (math.nan,) * 2
    pump_flow_cm3_s: Pair = (math.nan,) * 2
    split: Pair = (math.nan,) * 2
    outflow_cm3_s: Quad = (math.nan,) * 4
    interlock: str = ""
    bypassed: Mapping[str, float] = field(default_factory=dict)
    waits_for: str = ""
    lateness_s: float = math.nan
    skipped: int = 0
    next_in_s: float = math.nan
    next_what: str = ""
    alarms: tuple[ShownAlarm, ...] = ()


@dataclass(frozen=True, slots=True)
class ShownEvent:
    """A line of the event log."""

    t_s: float
    severity: str
    code: str
    text: str


@dataclass(frozen=True, slots=True)
class RunAnswer:
    """The answer to a request. text : for the operator."""

    is_ok: bool
    text: str


def read_hello(data: Mapping[str, Any]) -> ShownRun:
    """The greeting."""
    rig = _mapping(data.get("rig"))
    low_V, high_V = _numbers(rig.get("range_V", [0.0, 10.0]), 2)
    h1, h2, h3, h4 = _numbers(rig.get("height_cm", [20.0] * 4), 4)
    return ShownRun(
        folder=_text(data.get("folder")),
        scenario=_text(data.get("scenario")),
        pid=_whole(data.get("pid")),
        duration_s=_number(data.get("duration_s")),
        level_max_cm=_number(rig.get("level_max_cm", 20.0)),
        height_cm=(h1, h2, h3, h4),
        level_gain_V_cm=_number(rig.get("level_gain_V_cm", 0.5)),
        range_V=(low_V, high_V),
        bypassable=tuple(_text(name) for name in _sequence(data.get("bypassable"))),
        bypass_max_s=_number(data.get("bypass_max_s", 0.0)),
        attended_s=_number(data.get("attended_s", 0.0)),
    )


def read_state(data: Mapping[str, Any]) -> ShownState:
    """A state."""
    after = _mapping(data.get("next"))
    alarms = (read_alarm(_mapping(one)) for one in _sequence(data.get("alarms")))
    trusted = [one is not False for one in _sequence(data.get("trusted"))] + [True] * 4
    return ShownState(
        t_s=_number(data.get("t_s")),
        mode=_text(data.get("mode")) or "?",
        is_held=data.get("held") is True,
        is_starting=data.get("starting") is True,
        measured_cm=_quad(data.get("measured_cm")),
        estimated_cm=_quad(data.get("estimated_cm")),
        trusted=(trusted[0], trusted[1], trusted[2], trusted[3]),
        reference_cm=_pair(data.get("reference_cm")),
        target_cm=_pair(data.get("target_cm")),
        command_V=_pair(data.get("command_V")),
        applied_V=_pair(data.get("applied_V")),
        effectiveness=_pair(data.get("effectiveness")),
        pump_flow_cm3_s=_pair(data.get("pump_flow_cm3_s")),
        split=_pair(data.get("split")),
        outflow_cm3_s=_quad(data.get("outflow_cm3_s")),
        interlock=_text(data.get("interlock")),
        bypassed={str(name): _number(left_s) for name, left_s in _mapping(data.get("bypassed")).items()},
        waits_for=_text(data.get("waits_for")),
        lateness_s=_number(data.get("lateness_s")),
        skipped=_whole(data.get("skipped")),
        next_in_s=_number(after.get("in_s")),
        next_what=_text(after.get("what")),
        alarms=tuple(sorted(alarms, key=lambda alarm: alarm.rank)),
    )


def read_alarm(data: Mapping[str, Any]) -> ShownAlarm:
    """A row of the alarm list."""
    return ShownAlarm(
        key=_text(data.get("key")),
        title=_text(data.get("title")) or _text(data.get("key")),
        priority=_text(data.get("priority")) or "low",
        state=_text(data.get("state")) or "active",
        since_s=_number(data.get("since_s")),
        count=_whole(data.get("count", 1)),
        respond_s=_number(data.get("respond_s")),
        cause=_text(data.get("cause")),
        action=_text(data.get("action")),
        shelved_s=_number(data.get("shelved_s", 0.0)),
    )


def read_event(data: Mapping[str, Any]) -> ShownEvent:
    """A line of the event log."""
    return ShownEvent(
        _number(data.get("t_s")), _text(data.get("severity")), _text(data.get("code")), _text(data.get("text"))
    )


def read_answer(data: Mapping[str, Any]) -> RunAnswer:
    """The answer to a request."""
    return RunAnswer(data.get("ok") is True, _text(data.get("text")) or _text(data.get("reason")))


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _whole(value: object) -> int:
    number = _number(value)
    return int(number) if math.isfinite(number) else 0


def _text(value: object) -> str:
    """The text on one line, without what could command a terminal."""
    return "".join(c if c.isprintable() else " " for c in value) if isinstance(value, str) else ""


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _sequence(value: object) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) else ()


def _numbers(value: object, count: int) -> tuple[float, ...]:
    given = [_number(one) for one in _sequence(value)][:count]
    return (*given, *[math.nan] * (count - len(given)))


def _pair(value: object) -> Pair:
    first, second = _numbers(value, 2)
    return first, second


def _quad(value: object) -> Quad:
    one, two, three, four = _numbers(value, 4)
    return one, two, three, four
