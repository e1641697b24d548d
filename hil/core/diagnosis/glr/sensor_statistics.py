"""What single readings show without any model: a sensor that is stuck, open or noisier than it should be.

Stuck: the same code again and again. How often a sound sensor repeats itself depends on its noise against its
converter's steps, so that share is learned; a run is called stuck when a sound sensor would show it less than once
in STUCK_ODDS readings, doubtful from DOUBTFUL_ODDS on. It also depends on where the signal lies between two codes, so
a run must be LONGER_THAN_EVER, too. A sensor without noise can't be judged this way.
Open: readings that are out of range or disowned by the node, OPEN_RUN in a row.
Noisy: the jitter of the readings within a control period, far above the variance that was learned.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, log

from hil.core.types import Measurement

STUCK_ODDS, DOUBTFUL_ODDS = 1e11, 1e3
LONGER_THAN_EVER = 2
MAX_RUN = 100
"""If a sound sensor may well repeat itself so often, the test says nothing."""

OPEN_RUN = 3
PRIOR_READINGS = 40.0
MEMORY_READINGS = 3000.0
NOISY_MEMORY_READINGS = 100.0
NOISY_JITTER = 5.0
"""A period's jitter so many times the learned variance is out of the ordinary for a handful of readings."""

JITTER_TO_VARIANCE = 1.7
"""The largest step that jitter leaves out, made up for (five readings of white noise)."""

JUMPY_RATIO = 12.0
"""A period with a jump in it, so large a variance, is not learned from."""

NOISY_PERIODS = 3
CALM_RATIO = 2.0
MIN_VARIANCE_V2 = 1e-8
GARBAGE_V, GARBAGE_RATIO = 0.3, 16.0
"""Noise above this is no signal at all, V rms; unless the sensor was known for noise, of which this is a bad moment."""


@dataclass(slots=True)
class SensorStatistics:
    """What has been learned of one sensor; changes in place.

    variance_V2 : of one reading, as learned. repeat_share : how often a reading equals the one before.
    longest_run, last_run : of equal readings, the longest before the present one, and up to the last period.
    noisy_periods : how many in a row were out of the ordinary. loud_V2 : mean variance of those. sound_V2 : the
    variance before the sensor was called noisy, 0 while it isn't. newest_V2 : of the last period that was.
    """

    variance_V2: float
    weight: float = PRIOR_READINGS
    repeat_share: float = 0.2
    longest_run: int = 0
    last_run: int = 0
    noisy_periods: int = 0
    loud_V2: float = 0.0
    sound_V2: float = 0.0
    newest_V2: float = 0.0

    @property
    def current_variance(self) -> float:
        """Variance of one reading of the last period: what was learned, unless the period is out of the ordinary."""
        return max(self.variance_V2, self.newest_V2) if self.noisy_periods else self.variance_V2

    def learn(self, measurement: Measurement, index: int, *, is_used: bool) -> None:
        """Take in one control period's readings; what a sound sensor is like is learned only from one that is used."""
        variance, jitter, n = measurement.variance_V2[index], measurement.jitter_V2[index], measurement.readings
        if not isfinite(variance) or n < 2:
            return
        run = measurement.repeats[index]
        if is_used and run <= self.last_run:
            self.longest_run = max(self.longest_run, self.last_run)
        self.last_run = run
        sound_V2 = max(self.variance_V2, MIN_VARIANCE_V2)
        if jitter > NOISY_JITTER * sound_V2:
            self.noisy_periods += 1
            self.newest_V2 = JITTER_TO_VARIANCE * jitter
            self.loud_V2 += (self.newest_V2 - self.loud_V2) / self.noisy_periods
            return
        self.noisy_periods = 0
        if is_used and variance < JUMPY_RATIO * sound_V2:
            self.weight = min(self.weight + n - 1, NOISY_MEMORY_READINGS if self.sound_V2 else MEMORY_READINGS)
            share = (n - 1) / self.weight
            self.variance_V2 += share * (variance - self.variance_V2)
            self.repeat_share += ((measurement.repeats[index] > 0) - self.repeat_share) * share

    def is_stuck(self, measurement: Measurement, index: int) -> bool:
        """Whether the run of equal readings is too long for chance."""
        run = self._stuck_run()
        return run <= MAX_RUN and measurement.repeats[index] >= run

    def may_be_stuck(self, measurement: Measurement, index: int) -> bool:
        """Whether the run of equal readings makes one wait for the next ones."""
        run = max(self._run_beyond(DOUBTFUL_ODDS), self.longest_run)
        return self._stuck_run() <= MAX_RUN and measurement.repeats[index] >= run

    def _stuck_run(self) -> float:
        return max(self._run_beyond(STUCK_ODDS), LONGER_THAN_EVER * self.longest_run)

    def _run_beyond(self, odds: float) -> float:
        """How long a run of equal readings a sound sensor shows less than once in so many readings."""
        return -log(odds) / log(min(max(self.repeat_share, 0.05), 0.95))

    def is_noisy(self) -> bool:
        """Whether the readings have been out of the ordinary for long enough."""
        return self.noisy_periods >= NOISY_PERIODS

    def is_garbage(self) -> bool:
        """Whether there is no signal in the readings at all; that shows in one period."""
        return self.noisy_periods > 0 and self.newest_V2 > max(GARBAGE_V**2, GARBAGE_RATIO * self.variance_V2)

    def accept_noise(self) -> None:
        """Believe the sensor to be as noisy as it has lately been."""
        self.sound_V2, self.variance_V2, self.weight = self.variance_V2, self.loud_V2, PRIOR_READINGS
        self.noisy_periods = 0

    def forgive(self) -> None:
        """Back to normal."""
        self.sound_V2 = 0.0

    def is_calm(self) -> bool:
        """Whether a sensor once called noisy is as quiet as before."""
        return self.sound_V2 > 0.0 and self.variance_V2 < CALM_RATIO * max(self.sound_V2, MIN_VARIANCE_V2)
