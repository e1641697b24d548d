"""What the detector carries from one step to the next. It changes in place and belongs to one run.

Why in place: `docs/decisions/0010-numba.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from math import inf, nan
from typing import NamedTuple

import numpy as np

from hil.core.diagnosis.glr import bank, kernels
from hil.core.diagnosis.glr.bank import Bank, Best, MinJumps
from hil.core.diagnosis.glr.filter import PERIOD, StepResult
from hil.core.diagnosis.glr.growth import NO_GROWTH
from hil.core.diagnosis.glr.hypotheses import JUMPS
from hil.core.diagnosis.glr.model import (
    BIAS,
    GAIN,
    LEAK,
    LEVEL,
    PUMP,
    SCALE,
    SPLIT,
    Array,
    FilterModel,
    N,
)
from hil.core.diagnosis.glr.noise_learning import ProcessNoise
from hil.core.diagnosis.glr.prior import prior_of, wide_prior_of
from hil.core.diagnosis.glr.refilter import RING, History, Replays
from hil.core.diagnosis.glr.sensor_statistics import SensorStatistics
from hil.core.diagnosis.glr.tuning import Tuning
from hil.core.sensors import PLAIN, LevelSensors
from hil.core.tanks import TankModel
from hil.core.types import Measurement, Pair, Quad
from hil.core.uncertainty import Uncertainty

EMPTY_STDS = 6.0
"""A reading of fewer standard deviations of the noise may be that of an empty tank."""

MIN_LAG_S = 1e-3
"""The filter divides by the lag."""

UNKNOWN_LEVEL_CM = 5.0
"""Standard deviation of a level of which nothing is known."""

START_LEVEL_STD_V = 0.005
"""How far the first level may be off its reading, besides the noise."""


@dataclass(frozen=True, eq=False)
class DetectorConfig:
    """What doesn't change during a run: tuning, the rig's numbers. All voltages are level signals and drives.

    noise_V : (4,) of a reading. floor_V2 : (4,) smallest variance of a mean of readings. empty_V : (4,) below it a
    converter cuts the noise off, as in an empty tank: see `shows_level`. range_V : (2,) of each pump.
    prior, wide_prior : (N,) standard deviation of the parameters before the first reading, as the rig file has it, and
    for a rig that it does not describe.
    """

    tuning: Tuning
    model: FilterModel
    noise_V: Quad
    floor_V2: Quad
    empty_V: Quad
    range_V: tuple[Pair, Pair]
    prior: Array
    wide_prior: Array

    @classmethod
    def of(
        cls,
        model: TankModel,
        lag_s: Pair,
        noise_V: Quad,
        tuning: Tuning,
        range_V: tuple[Pair, Pair] = ((0.0, 10.0), (0.0, 10.0)),
        sensors: LevelSensors = PLAIN,
        uncertainty: Uncertainty | None = None,
    ) -> DetectorConfig:
        """From the rig file's numbers. uncertainty : None for that of the tuning."""
        walk = np.zeros(N)
        walk[SPLIT:LEAK] = walk[SCALE : SCALE + 2] = tuning.parameter_walk**2
        speed = float(np.sqrt(2.0 * model.gravity_cm_s2))
        filter_model = FilterModel(
            area_cm2=np.array(model.area_cm2),
            outlet_flow=np.array([a * speed for a in model.outlet_cm2]),
            pump_gain_cm3_Vs=np.array(model.pump_gain_cm3_Vs),
            valve_split=np.array(model.valve_split),
            walk=walk,
            lag_s=np.maximum(np.array(lag_s), MIN_LAG_S),
            level_gain_V_cm=model.level_gain_V_cm,
            height_cm=np.array(model.height_cm),
            datum_cm=np.array(model.datum_cm),
        )
        floor_V, prior = tuning.reading_floor_V, prior_of(tuning, uncertainty)
        f1, f2, f3, f4 = (floor**2 for floor in sensors.scaled((floor_V, floor_V, floor_V, floor_V)))
        e1, e2, e3, e4 = (low + EMPTY_STDS * noise for low, noise in zip(sensors.lowest_signals, noise_V, strict=True))
        return cls(
            tuning=tuning,
            model=filter_model,
            noise_V=noise_V,
            floor_V2=(f1, f2, f3, f4),
            empty_V=(e1, e2, e3, e4),
            range_V=range_V,
            prior=prior,
            wide_prior=wide_prior_of(tuning, prior),
        )

    def shows_level(self, i: int, reading_V: float, expected_V: float) -> bool:
        """Whether the reading of sensor i (0 to 3) is used: not where the tank may be empty and the noise is cut off.

        expected_V : by the filter, before the reading. Near the empty tank it decides: a limit on the reading itself
        would keep those of a shallow tank that are too high and drop those that are too low.
        """
        empty_V, near_V = self.empty_V[i], self.empty_V[i] + EMPTY_STDS * self.noise_V[i]
        if expected_V > near_V:
            return reading_V > empty_V
        return expected_V > empty_V or reading_V > near_V

    def filter_beside(self, x: Array, P: Array, entry: Array, target: int) -> float:
        """One step of a filter beside the main one, in place; the log-likelihood of the readings.

        target : what grows in it, see `growth`.
        """
        kernels.grow(x, P, target, entry[PERIOD])
        return kernels.filter_step(self.model, x, P, entry, StepResult.empty())


@dataclass(slots=True)
class Suspicion:
    """An alarm that is not resolved yet.

    number : of the alarm; None as long as it may be about a fault that has one. leader : the likeliest hypothesis, None
    before the replays have found one. is_told : whether it was reported that candidates remain after the time for it.
    sharpen_at : step from which other onsets may be tried again.
    mean_V : (2,) slow mean of the pumps' voltages; moved_s : for how long a pump was away from it.
    is_quiet : whether no alarm was raised because it may be the rig's own, see `first_day`. quiet_s : for how long that
    was so before the alarm. drift : the sensor, from 0, whose drift has been in question since, see `drifting`.
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
    changing at a constant rate.
    """

    pump: int
    number: int
    detected_s: float
    onset_s: float
    until_s: float
    voltage_V: float
    x: Array
    P: Array
    growing_x: Array
    growing_P: Array
    evidence: float = 0.0
    growing_evidence: float = 0.0


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


@dataclass(eq=False)
class Memory:
    """The filter (x, P), the bank and its history, what was learned of the sensors, and what was declared.

    begun_s : run time of the first readings, negative in a start phase. result : of the last filter step. applied_V :
    (2,) at the last step. usual_s : the last period without a gap.
    scale : (4,) by how much the innovations' variance exceeds what the sensors' noise explains. noise : of the
    process. best, max_ratio : the bank's answer, by hypothesis, and the greatest ratio of all. declared : by place in
    JUMPS. stuck_checks : by pump, from 0. scratch : replays for trying onsets. usable : whether the filter uses a
    sensor's readings. lost : the sensors that it does not use. agrees : for how many steps a lost sensor has agreed
    with the filter. noisy : numbers of the alarms of noisy sensors. is_doubtful : whether a sensor that is used repeats
    itself so often that it may be stuck. mean_square : running mean square of the whitened innovations. verdicts_s :
    run times of the latest verdicts. rival : to the latest drift. hidden : see `hidden_level`. checkpoint : from before
    the latest verdict. unproven : the pump that was at rest when the other one failed, and for how long it has been
    driven since; None when both are known to work. strength : pumps that were reported to give another share than the
    file says. steady_s : (2,) for how long a difference from that has been known. is_wide : whether the rig is proven
    not to be as its file says; proven_s : since when. learned : (N,) the state when such a rig had been learned.
    taught_s : when a relearning filter took over the last time.
    calm_squares : mean_square by step modulo RING. told : the latest names. unknown : what nothing explains, while it
    goes on; unknown_s : for how long, fading afterwards; unknown_until_s : run time at which the last was over.
    """

    x: Array
    P: Array
    sensors: list[SensorStatistics]
    noise: ProcessNoise
    t_s: float
    begun_s: float
    now: int = 0
    bank: Bank = field(default_factory=Bank.empty)
    history: History = field(default_factory=History.empty)
    replays: Replays = field(default_factory=Replays.empty)
    scratch: Replays = field(default_factory=Replays.empty)
    times_s: list[float] = field(default_factory=lambda: [nan] * RING)
    result: StepResult = field(default_factory=StepResult.empty)
    applied_V: Pair = (0.0, 0.0)
    usual_s: float = inf
    scale: Array = field(default_factory=lambda: np.ones(4))
    best: Best = field(default_factory=Best.empty)
    max_ratio: float = 0.0
    mean_square: float = 1.0
    usable: list[bool] = field(default_factory=lambda: [True] * 4)
    lost: dict[int, Lost] = field(default_factory=dict)
    agrees: list[int] = field(default_factory=lambda: [0] * 4)
    noisy: dict[int, int] = field(default_factory=dict)
    is_doubtful: bool = False
    declared: dict[int, Declared] = field(default_factory=dict)
    suspicion: Suspicion | None = None
    stuck_checks: dict[int, StuckCheck] = field(default_factory=dict)
    growing: int = NO_GROWTH
    followed_s: float = -inf
    rival: Rival | None = None
    hidden: Hidden | None = None
    alarms: int = 0
    verdicts_s: tuple[float, ...] = ()
    checkpoint: Checkpoint | None = None
    unproven: tuple[int, float] | None = None
    wide: Wide | None = None
    is_wide: bool = False
    strength: dict[int, Strength] = field(default_factory=dict)
    steady_s: list[float] = field(default_factory=lambda: [0.0, 0.0])
    relearned_s: float = 0.0
    proven_s: float = inf
    learned: Array | None = None
    taught_s: float = -inf
    calm_squares: list[float] = field(default_factory=lambda: [1.0] * RING)
    told: tuple[Told, ...] = ()
    unknown: Unknown | None = None
    unknown_s: float = 0.0
    unknown_until_s: float = -inf

    @classmethod
    def begin(cls, config: DetectorConfig, t_s: float, measurement: Measurement, applied_V: Pair) -> Memory:
        """The filter at the first readings, parameters as in the rig file."""
        tuning = config.tuning
        x, variance = np.zeros(N), np.zeros(N)
        x[LEVEL : LEVEL + 4] = np.array(measurement.level_V) / config.model.level_gain_V_cm
        x[PUMP : PUMP + 2] = applied_V
        x[GAIN:LEAK] = 1.0
        x[SCALE : SCALE + 2] = 1.0
        for i, noise_V in enumerate(config.noise_V):
            level_V2 = noise_V**2 / max(measurement.readings, 1) + START_LEVEL_STD_V**2
            variance[LEVEL + i] = level_V2 / config.model.level_gain_V_cm**2
        variance[SPLIT:] = config.prior[SPLIT:] ** 2
        sensors = [SensorStatistics(noise_V**2) for noise_V in config.noise_V]
        noise = ProcessNoise.begin(tuning.min_level_walk)
        memory = cls(x=x, P=np.diag(variance), sensors=sensors, noise=noise, t_s=t_s, begun_s=t_s, applied_V=applied_V)
        memory.times_s[0] = t_s
        memory.open_slot()
        return memory

    @property
    def entry(self) -> Array:
        """The newest entry of the history, see `filter`."""
        newest: Array = self.history.entries[self.now % RING]
        return newest

    def time_of(self, step: int) -> float:
        """Run time of a step, s; of one that the history no longer holds, by the usual period."""
        if self.now - step < RING:
            return self.times_s[step % RING]
        return self.t_s - (self.now - step) * self.usual_s

    def open_slot(self, step: int | None = None) -> None:
        """Let the bank consider jumps from this step (None: now) on, and keep the filter as it stands."""
        self.keep_filter(bank.open_slot(self.now if step is None else step, self.bank))

    def keep_filter(self, slot: int) -> None:
        """Keep the filter as it stands, as that at the onset of a slot."""
        self.history.x[slot] = self.x
        self.history.P[slot] = self.P

    def restart_bank(self, step: int | None = None) -> None:
        """Forget all candidates: the filter has just been corrected, as it stood at a step (None: now)."""
        self.bank.clear()
        self.noise.restart()
        self.wide = None
        self.open_slot(step)
        self.max_ratio = 0.0

    def forget(self, state: int) -> None:
        """Reset a fault's state to zero, with zero variance."""
        self.x[state] = 0.0
        self.P[state, :] = self.P[:, state] = 0.0

    def forget_levels(self) -> None:
        """Take the levels from the next readings alone; what is known of the parameters stays as it is."""
        for state in range(LEVEL, LEVEL + 4):
            self.P[state, :] = self.P[:, state] = 0.0
            self.P[state, state] = UNKNOWN_LEVEL_CM**2
        self.restart_bank()

    def min_jumps(self) -> MinJumps:
        """The smallest jumps that count; what has been declared may also go back."""
        if not self.declared:
            return MIN_JUMPS
        return _min_jumps(tuple([(j, fault.size < 0.0) for j, fault in self.declared.items()]))

    @property
    def trusted(self) -> tuple[bool, bool, bool, bool]:
        """Whether each sensor's reading may be used as it is."""
        trusted = self.usable.copy()
        for j in self.declared:
            if JUMPS[j].state >= BIAS:
                trusted[JUMPS[j].target - 1] = False
        return trusted[0], trusted[1], trusted[2], trusted[3]


MIN_JUMPS = MinJumps(
    rise=np.array([jump.rise[0] if jump.rises else np.inf for jump in JUMPS]),
    fall=np.array([jump.fall[0] if jump.falls else np.inf for jump in JUMPS]),
)


@lru_cache(maxsize=64)
def _min_jumps(declared: tuple[tuple[int, bool], ...]) -> MinJumps:
    """The smallest jumps with these faults declared: place in JUMPS, and whether it went down. Not to be changed."""
    rise, fall = MIN_JUMPS.rise.copy(), MIN_JUMPS.fall.copy()
    for j, has_fallen in declared:
        rise[j], fall[j] = JUMPS[j].rise[0], JUMPS[j].fall[0]
        if has_fallen:
            rise[j] = JUMPS[j].fall[0]
    return MinJumps(rise=rise, fall=fall)
