"""Statistics of single readings, without any model: a sensor that is stuck, open or noisier than it should be.

Stuck: the same code again and again. How often a healthy sensor repeats a code depends on its noise relative to its
converter's steps, so that share is learned; a run of equal codes means stuck when a healthy sensor would show it less
than once in STUCK_ODDS readings, doubtful from DOUBTFUL_ODDS on. It also depends on where the signal is between two
codes, so a run must also be RUN_FACTOR times the longest one before. A sensor without noise can't be judged this way.
Open: readings that are out of range or invalid by the node's status, OPEN_RUN in a row.
Noisy: the jitter of the readings within a control period, far above the variance that was learned.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, log

from hil.core.types import Measurement

STUCK_ODDS, DOUBTFUL_ODDS = 1e11, 1e3
STUCK_LOG, DOUBTFUL_LOG = log(STUCK_ODDS), log(DOUBTFUL_ODDS)
RUN_FACTOR = 2
MAX_RUN = 100
"""If a healthy sensor may well repeat a code so often, the test is not applied."""

OPEN_RUN = 3
PRIOR_READINGS = 40.0
MEMORY_READINGS = 3000.0
NOISY_MEMORY_READINGS = 100.0
NOISY_JITTER = 5.0
"""A period is noisy when its jitter is this many times the learned variance."""

JITTER_TO_VARIANCE = 1.7
"""Corrects for the largest step, which jitter leaves out (five readings of white noise)."""

JUMPY_RATIO = 12.0
"""A period with a larger ratio of variance has a jump in it; it is not learned from."""

NOISY_PERIODS, NOISY_READINGS = 3, 12
"""A sensor is noisy after so many noisy periods in a row with so many readings. Three periods of two or three readings
each are noisy by chance once in some 90 h of four healthy sensors."""
CALM_RATIO = 2.0
MIN_VARIANCE_V2 = 1e-8
GARBAGE_V, GARBAGE_RATIO = 0.3, 16.0
"""With noise above both, V rms and times the learned variance, a reading contains no signal."""


@dataclass(slots=True)
class SensorStatistics:
    """What has been learned of one sensor; changes in place.

    variance_V2 : of one reading, as learned. repeat_share : how often a reading equals the one before.
    longest_run, last_run : of equal readings, the longest before the present one, and up to the last period.
    noisy_periods, noisy_readings : how many in a row were noisy. noisy_V2 : mean variance of those. healthy_V2 : the
    variance before the sensor was declared noisy, 0 while it isn't. newest_V2 : of the last noisy period.
    """

    variance_V2: float
    weight: float = PRIOR_READINGS
    repeat_share: float = 0.2
    longest_run: int = 0
    last_run: int = 0
    noisy_periods: int = 0
    noisy_readings: int = 0
    noisy_V2: float = 0.0
    healthy_V2: float = 0.0
    newest_V2: float = 0.0

    @property
    def current_variance(self) -> float:
        """Variance of one reading of the last period: the learned one, unless the period was noisy."""
        return max(self.variance_V2, self.newest_V2) if self.noisy_periods else self.variance_V2

    def learn(self, measurement: Measurement, index: int, *, is_used: bool) -> None:
        """Take in one control period's readings; what is normal is learned only while the sensor is used."""
        variance, jitter, n = measurement.variance_V2[index], measurement.jitter_V2[index], measurement.readings
        if not isfinite(variance) or n < 2:
            return
        run = measurement.repeats[index]
        if is_used and run <= self.last_run and self.last_run > self.longest_run:
            self.longest_run = self.last_run
        self.last_run = run
        healthy_V2 = self.variance_V2 if self.variance_V2 > MIN_VARIANCE_V2 else MIN_VARIANCE_V2
        if jitter > NOISY_JITTER * healthy_V2:
            self.noisy_periods += 1
            self.noisy_readings += n
            self.newest_V2 = JITTER_TO_VARIANCE * jitter
            self.noisy_V2 += (self.newest_V2 - self.noisy_V2) / self.noisy_periods
            return
        self.noisy_periods = self.noisy_readings = 0
        if is_used and variance < JUMPY_RATIO * healthy_V2:
            self.weight = min(self.weight + n - 1, NOISY_MEMORY_READINGS if self.healthy_V2 else MEMORY_READINGS)
            share = (n - 1) / self.weight
            self.variance_V2 += share * (variance - self.variance_V2)
            self.repeat_share += ((run > 0) - self.repeat_share) * share

    def is_stuck(self, measurement: Measurement, index: int) -> bool:
        """Whether the run of equal readings is too long for chance."""
        if measurement.repeats[index] == 0:
            return False
        run = self._stuck_run()
        return run <= MAX_RUN and measurement.repeats[index] >= run

    def may_be_stuck(self, measurement: Measurement, index: int) -> bool:
        """Whether the run of equal readings is so long that a verdict should wait for the next ones."""
        if measurement.repeats[index] == 0:
            return False
        run = max(self._run_beyond(DOUBTFUL_LOG), self.longest_run)
        return self._stuck_run() <= MAX_RUN and measurement.repeats[index] >= run

    def _stuck_run(self) -> float:
        return max(self._run_beyond(STUCK_LOG), RUN_FACTOR * self.longest_run)

    def _run_beyond(self, log_odds: float) -> float:
        """The run of equal readings, above 0, that a healthy sensor shows less than once in so many readings."""
        return -log_odds / log(min(max(self.repeat_share, 0.05), 0.95))

    def is_unremarkable(self, measurement: Measurement, index: int) -> bool:
        """Whether no test of this module can find anything in this period: no reading repeated, not valid or noisy."""
        return not (self.noisy_periods or measurement.repeats[index] or measurement.invalid_run[index])

    def is_noisy(self) -> bool:
        """Whether the readings have been noisy for long enough."""
        return self.noisy_periods >= NOISY_PERIODS and self.noisy_readings >= NOISY_READINGS

    def is_garbage(self) -> bool:
        """Whether there is no signal in the readings; one period is enough to see that."""
        return self.noisy_periods > 0 and self.newest_V2 > max(GARBAGE_V**2, GARBAGE_RATIO * self.variance_V2)

    def accept_noise(self) -> None:
        """Use the variance of the latest, noisy periods from now on."""
        self.healthy_V2, self.variance_V2, self.weight = self.variance_V2, self.noisy_V2, PRIOR_READINGS
        self.noisy_periods = self.noisy_readings = 0

    def end_noise(self) -> None:
        """The sensor is as quiet as before."""
        self.healthy_V2 = 0.0

    def is_calm(self) -> bool:
        """Whether a sensor that was declared noisy is as quiet as before."""
        return self.healthy_V2 > 0.0 and self.variance_V2 < CALM_RATIO * max(self.healthy_V2, MIN_VARIANCE_V2)
