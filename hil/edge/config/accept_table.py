"""`[[accept]]` of a scenario: limits that a run has to keep, each with a name."""

from __future__ import annotations

import re
from difflib import get_close_matches
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from hil.core.fault_kinds import FaultKind, fault_kind
from hil.core.types import NAMELESS, TripCause
from hil.edge.config.settings_file import Finite, NotNegative, Positive, Section

PATH = re.compile(r"[A-Za-z_]\w*(\.\w+|\[\d+\])*", re.ASCII)
ALARM = re.compile(r"([a-z0-9_]+)(?: (\w+))?", re.ASCII)
TARGETS = {"pump": 2, "valve": 2, "tank": 4, "sensor": 4}
"""How many there are of what a fault acts on."""


def _figure_path(path: str) -> str:
    """Raise ValueError for what is no path."""
    if not PATH.fullmatch(path):
        raise ValueError("must be a path in kpi.json, such as iae_Vs.gain_fall[0]")
    return path


def _alarm_name(name: str) -> str:
    """Raise ValueError for what no alarm can be named. A detector of a package may have kinds of its own."""
    match = ALARM.fullmatch(name)
    if match is None:
        raise ValueError("must be kind and target of an alarm, such as 'pump_effectiveness 1'")
    kinds = [kind for kind in FaultKind if kind.is_of_the_process]
    kind = fault_kind(match[1])
    if kind is None:
        close = get_close_matches(match[1], [*kinds, *NAMELESS], n=1, cutoff=0.85)
        if close and close[0] != match[1]:
            raise ValueError(f"there is no kind {match[1]!r}; is {str(close[0])!r} meant?")
    elif kind not in kinds:
        raise ValueError(f"no alarm is named so: it must be one of {', '.join(kinds)}, or the kind of a detector's own")
    elif (count := TARGETS.get(kind.acts_on)) and match[2] not in map(str, range(1, count + 1)):
        raise ValueError(f"must be {kind} and the number of the {kind.acts_on}, from 1 to {count}")
    return name


def _cause(name: str) -> str:
    """Raise ValueError for what is no cause of a trip."""
    if name not in set(TripCause):
        raise ValueError(f"must be one of {', '.join(TripCause)}")
    return name


Cause = Annotated[str, AfterValidator(_cause)]

FigurePath = Annotated[str, AfterValidator(_figure_path), Field(max_length=200)]
"""Where a figure stands in `kpi.json`: `iae_Vs.gain_fall[0]`."""

FaultName = Annotated[str, AfterValidator(_alarm_name), Field(max_length=80)]
"""As an alarm names it: kind and target, `pump_effectiveness 1`."""

CHECKS = (
    "iae_V_s", "settling_s", "overshoot_cm", "detected_within_s", "named", "no_alarm", "no_trip", "trip",
    "level_max_cm", "skipped_max", "lateness_p99_s", "figure",
)  # fmt: skip

OF_A_WINDOW = ("iae_V_s", "settling_s", "overshoot_cm")
"""Limits that need `window`."""


class AcceptTable(Section):
    """One limit: exactly one of `CHECKS`.

    iae_V_s, settling_s, overshoot_cm : of both outputs in `window`, see `hil.review.kpi`.
    detected_within_s : the latest first report of each injected fault, s after its onset.
    named : the faults that alarms name, no more and no less. no_alarm, no_trip : none at all.
    trip : the cause of the first trip. level_max_cm : of all tanks. skipped_max : skipped steps.
    lateness_p99_s : of the steps. figure : any number of `kpi.json` by its path, with `min`, `max` (both may be given)
    or `equals`.
    """

    name: Annotated[str, Field(min_length=1, max_length=120)]
    window: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    iae_V_s: Positive | None = None
    settling_s: NotNegative | None = None
    overshoot_cm: NotNegative | None = None
    detected_within_s: Positive | None = None
    named: tuple[FaultName, ...] | None = None
    no_alarm: Literal[True] | None = None
    no_trip: Literal[True] | None = None
    trip: Cause | None = None
    level_max_cm: Positive | None = None
    skipped_max: Annotated[int, Field(ge=0)] | None = None
    lateness_p99_s: NotNegative | None = None
    figure: FigurePath | None = None
    min: Finite | None = None
    max: Finite | None = None
    equals: Finite | bool | str | None = None

    @property
    def check(self) -> str:
        """Which of `CHECKS`."""
        return next(key for key in CHECKS if getattr(self, key) is not None)

    @model_validator(mode="after")
    def _has_one_check(self) -> Self:
        given = [key for key in CHECKS if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"has {', '.join(given) or 'none'} of {', '.join(CHECKS)}: give one")
        if (self.window is not None) != (given[0] in OF_A_WINDOW):
            raise ValueError(f"{', '.join(OF_A_WINDOW)} need window, other limits have none")
        has_range = self.min is not None or self.max is not None
        if self.figure is None and (has_range or self.equals is not None):
            raise ValueError("min, max and equals are for figure")
        if self.figure is not None and has_range == (self.equals is not None):
            raise ValueError("figure needs min or max (or both), or equals")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min {self.min:g} is above max {self.max:g}")
        return self
