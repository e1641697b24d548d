"""What the detector carries from one step to the next. It changes in place and belongs to one run.

Why in place: `docs/decisions/0010-numba.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from math import inf, nan

import numpy as np

from hil.core.diagnosis.glr import bank
from hil.core.diagnosis.glr.bank import Bank, Best, MinJumps
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import StepResult
from hil.core.diagnosis.glr.growth import NO_GROWTH
from hil.core.diagnosis.glr.hypotheses import JUMPS
from hil.core.diagnosis.glr.memory_parts import (
    Checkpoint,
    Declared,
    Hidden,
    Lost,
    Rival,
    Strength,
    StuckCheck,
    Suspicion,
    Told,
    Unknown,
    Wide,
)
from hil.core.diagnosis.glr.model import BIAS, GAIN, LEAK, LEVEL, PUMP, SCALE, SPLIT, Array, N
from hil.core.diagnosis.glr.noise_learning import ProcessNoise
from hil.core.diagnosis.glr.refilter import RING, History, Replays
from hil.core.diagnosis.glr.sensor_statistics import SensorStatistics
from hil.core.types import Measurement, Pair

UNKNOWN_LEVEL_CM = 5.0
"""Standard deviation of a level of which nothing is known."""

START_LEVEL_STD_V = 0.005
"""How far the first level may be off its reading, besides the noise."""


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
    not to be as its file says; proven_s : since when. learned : (N,) what such a rig's splits and outlets were when
    they had been learned, not a number before; None before any. is_keep_due, is_kept_again : whether
    they are to be taken again, and have been after the start phase.
    taught_s : when a relearning filter took over the last time. driven_V : the least and the greatest voltage of each
    pump so far.
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
    is_keep_due: bool = False
    is_kept_again: bool = False
    driven_V: list[Pair] = field(default_factory=lambda: [(inf, -inf)] * 2)
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
