"""The control steps of a record: when each took place, which frames it had read, and what it sent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan

import numpy as np
import numpy.typing as npt

from hil.core.live_request import LiveRequest
from hil.replay.frame_log import FrameLog
from hil.review.ticks import LoggedEvent

NOTHING = -1


@dataclass(frozen=True, slots=True)
class RecordedStep:
    """One control step.

    now_ns : when it began. until : number of received frames that it had read, from the first one of the log on.
    command : row of the log with what it sent; NOTHING if it sent none. t_s : run time; NaN outside the steps that have
    one. mode : number of its mode in the record; NOTHING for a step that has no row there. stop_reason : who asked for
    a stop; "" for nobody. link_is_up : whether the bus was there. has_channel : whether the control channel was.
    """

    now_ns: int
    until: int
    command: int
    t_s: float = nan
    mode: int = NOTHING
    lateness_s: float = 0.0
    skipped: int = 0
    stop_reason: str = ""
    link_is_up: bool = True
    has_channel: bool = True

    @property
    def is_in_control(self) -> bool:
        """Whether the record has a row for it: from the first step in control on."""
        return self.mode != NOTHING


@dataclass(frozen=True, eq=False)
class RecordedSteps:
    """What is replayed.

    received : rows of the log's frames that the controller received, in the order in which it read them. requests :
    number of the step -> what an operator sent. events : of the record; None for a log that has none. doubts : what is
    not known exactly, in words. missing : numbers of steps before which the log lacks frames or steps.
    """

    log: FrameLog
    received: npt.NDArray[np.int64]
    steps: tuple[RecordedStep, ...]
    requests: Mapping[int, tuple[LiveRequest, ...]] = field(default_factory=dict)
    events: tuple[LoggedEvent, ...] | None = None
    doubts: tuple[str, ...] = ()
    missing: frozenset[int] = frozenset()
