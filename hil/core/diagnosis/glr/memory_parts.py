"""Parts of the detector's memory: a record of each question that it has open, and of each that it has answered.

Most change in place, see `memory`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, nan
from typing import NamedTuple

from hil.core.diagnosis.glr.model import Array
from hil.core.diagnosis.glr.refilter import RING


@dataclass(slots=True)
class Suspicion:
    """An alarm that is not resolved yet.

    number : of the alarm; None as long as it may be about a fault that has one. leader : the likeliest hypothesis, None
    before the replays have found one. is_told : whether it was reported that candidates remain after the time for it.
    sharpen_at : step from which other onsets may be tried again.
    mean_V : (2,) slow mean of the pumps' voltages; moved_s : for how long a pump was away from it.
    is_quiet : whether no alarm was raised because it may be the rig's own, see `first_day`, or because it is weak on a
    rig that is not as its file says. quiet_s : for how long that was so before the alarm. drift : the sensor, from 0,
    whose drift has been in question since, see `drifting`.
    """

    number: int | None
    detected_s: float
    is_quiet: bool = False
    quiet_s: float = 0.0
    leader: int | None = None
    is_told: bool = False
    sharpen_at: int = 0
    mean_V: Array | None = None
    moved_s: float = 0.0
    drift: int | None = None


class Lost(NamedTuple):
    """A sensor that is no longer used: kind and number of its alarm, the run time since when.

    proven_V : by how much a movement of the pumps has proven that it reads too high.
    """

    kind: str
    number: int
    since_s: float
    proven_V: float = 0.0


class Told(NamedTuple):
    """A name that was given: its run time, kind and target, alarm, and the filter from before."""

    t_s: float
    name: str
    number: int
    checkpoint: Checkpoint


@dataclass(eq=False, slots=True)
class Unknown:
    """Something that no hypothesis explains, while it goes on; see `unknown`.

    number, detected_s : of its alarm. x, P : the filter from before it. model_x, model_P : that filter continued
    without readings. trials : filters that try whether the model explains the readings again, with their levels' walks
    (4,), cm^2/s. sums, squares, count : (trials, 4) of their whitened innovations since step `tried`.
    """

    number: int
    detected_s: float
    x: Array
    P: Array
    model_x: Array
    model_P: Array
    trials: list[tuple[Array, Array, Array]]
    sums: Array
    squares: Array
    count: Array
    tried: int


@dataclass(eq=False, slots=True)
class Drifting:
    """A wide filter that has room for drifts of sensors as well, see `drifting`: its state.

    lead : by step modulo RING, log-likelihood ratio against the wide filter beside which it began.
    """

    x: Array
    P: Array
    lead: list[float] = field(default_factory=lambda: [0.0] * RING)


@dataclass(eq=False, slots=True)
class Wide:
    """The filter of a rig that its file does not describe, see `first_day`.

    x, P : its state. lead : by step modulo RING, log-likelihood ratio against the main filter since it began, at step
    `began`. relearned_s : age at which a part of what was learned was forgotten the last time. refuted_s : since when
    the main filter refutes the rig file, inf if it does not. drifting : the same with room for drifts of sensors, None
    as long as the main filter believes the rig file.
    """

    x: Array
    P: Array
    began: int
    lead: list[float] = field(default_factory=lambda: [0.0] * RING)
    drifting: Drifting | None = None
    relearned_s: float = 0.0
    refuted_s: float = inf

    def gained(self, lead: list[float], onset: int, now: int) -> float:
        """By how much a lead, its own or that of the filter beside it, has risen since a step, or since it began."""
        return lead[now % RING] - lead[max(onset, self.began, now - RING + 1) % RING]

    def lowest(self, onset: int, now: int) -> int:
        """The step since another at which its lead was least; the first of them."""
        return min(range(max(onset, self.began, now - RING + 1), now + 1), key=lambda step: self.lead[step % RING])


class Strength(NamedTuple):
    """A pump that was reported to give another share than its file says, see `strength`: its alarm, and that share."""

    number: int
    detected_s: float
    share: float


@dataclass(slots=True)
class StuckCheck:
    """A pump whose gain has changed, checked for being stuck, with the filter of a pump whose flow stays as it is.

    pump : 0 or 1. voltage_V : at which it gave that flow. evidence : log-likelihood ratio against the main filter.
    until_s : run time at which the check ends. growing_x, growing_P, growing_evidence : the same of a gain that goes on
    changing at a constant rate. moved_since_s : since when the voltage has been elsewhere, inf if it is not.
    patience_s : for so long it has to be there.
    """

    pump: int
    number: int
    detected_s: float
    onset_s: float
    until_s: float
    voltage_V: float
    patience_s: float
    x: Array
    P: Array
    growing_x: Array
    growing_P: Array
    evidence: float = 0.0
    growing_evidence: float = 0.0
    moved_since_s: float = inf


@dataclass(slots=True)
class Rival:
    """The alternative to the drift for which a sensor is no longer used, with the filters of both.

    number : of the rival hypothesis. suspicion : the drift's, with its alarm's number. sensor : from 0. onset, before :
    of the rival's jump. own_x, own_P : the drift's filter; both continue with the sensor's readings. lead : of the
    drift, log-likelihood ratio; moved_lead : what it has gained while the pumps moved. mean_V : (2,) slow mean of their
    voltages. until_s : run time at which the drift is accepted.
    """

    number: int
    suspicion: Suspicion
    sensor: int
    onset: int
    before: Array
    x: Array
    P: Array
    own_x: Array
    own_P: Array
    lead: float
    until_s: float
    target: int
    mean_V: Array
    moved_lead: float = 0.0


@dataclass(slots=True)
class Hidden:
    """The filter of a drift downwards of a lower sensor that is not excluded although another fault was declared.

    tank : from 0. lead : of the declared fault, log-likelihood ratio; above limit the drift is excluded. target : what
    grows in the filter.
    """

    tank: int
    x: Array
    P: Array
    lead: float
    target: int
    limit: float


@dataclass(slots=True)
class Declared:
    """A fault that has been declared.

    healthy : the state before any fault. size : the jump since then, in the unit of the state. number, detected_s : of
    its alarm. declared_s : run time of the verdict. shown : the size that was reported last. grows :
    whether it was declared as growing.
    """

    kind: str
    size: float
    healthy: float
    number: int
    detected_s: float
    declared_s: float
    shown: float = nan
    grows: bool = False


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The filter some steps before a fault that has been declared, to return to if a sensor turns out to be the fault.

    onset : step at which that fault is thought to have begun. step, x, P : the filter at an earlier one. declared :
    what had been declared until then.
    """

    onset: int
    step: int
    x: Array
    P: Array
    declared: dict[int, Declared]
