"""The detector: filter, bank, replays and sensor tests, composed into a `FaultDetector`.

detecting  the filter runs, the bank looks back; a likelihood ratio above `Tuning.detect` raises an alarm
isolating  every hypothesis is replayed from its onset; the alarm names the candidates until one leads by the margin
settled    the winner's filter becomes the filter, and detection continues: for the next fault, or for the recovery

Why this method: `docs/decisions/0009-diagnosis-by-likelihood-ratios.md`. Why the memory changes in place:
`docs/decisions/0010-numba.md`.
"""

from __future__ import annotations

from math import exp, isfinite, nan, sqrt
from typing import Any

from hil.core.diagnosis.glr import (
    ambiguity,
    declaration,
    drift_review,
    first_day,
    hidden_level,
    identified,
    isolation,
    kernels,
    own_verdict,
    possible,
    sensor_monitor,
    strength,
    stuck_check,
    unknown,
    wide_filter,
)
from hil.core.diagnosis.glr.detector_config import DetectorConfig
from hil.core.diagnosis.glr.filter import DOUBT, PERIOD
from hil.core.diagnosis.glr.growth import NO_GROWTH
from hil.core.diagnosis.glr.hypotheses import PUMPS
from hil.core.diagnosis.glr.memory import Memory
from hil.core.diagnosis.glr.model import LAG, LEVEL
from hil.core.diagnosis.glr.refilter import RING
from hil.core.diagnosis.glr.tuning import Tuning
from hil.core.estimator import Estimate
from hil.core.sensors import PLAIN, LevelSensors
from hil.core.tanks import TankModel
from hil.core.types import Alarm, Diagnosis, Measurement, Pair, Quad
from hil.core.uncertainty import Uncertainty

ALL = (True, True, True, True)
MAX_READING_V = 100.0
"""A higher reading is not used, whatever range the rig file gives."""

GAP_PERIODS = 1.5
"""A period longer than so many of the one before has missing control steps in it."""

LONG_GAP_S = 1.5
"""After a longer time without known voltages the levels are learned again; the parameters are kept."""

DROP_V = 0.5
"""A voltage that falls to 0 V by more than this within a period was cut by the pump node or by a trip."""

MAX_MEAN_SQUARE = 30.0
"""One step's mean square innovation counts for no more than this in the divergence test: a single jump is a fault."""


class GlrDetector:
    """Generalised likelihood ratios over onset and hypothesis, isolation by replay. One memory a run."""

    def __init__(
        self,
        model: TankModel,
        lag_s: float | Pair,
        noise_V: float | Quad,
        tuning: Tuning | None = None,
        range_V: tuple[Pair, Pair] = ((0.0, 10.0), (0.0, 10.0)),
        sensors: LevelSensors = PLAIN,
        uncertainty: Uncertainty | None = None,
    ) -> None:
        """lag_s : one, or each pump's. noise_V : of level signals, one, or each sensor's. range_V : of the drives.

        uncertainty : None for that of the tuning. Compiles what is not compiled yet, which takes a quarter of a minute.
        """
        lags_s = lag_s if isinstance(lag_s, tuple) else (lag_s, lag_s)
        noises_V = noise_V if isinstance(noise_V, tuple) else (noise_V, noise_V, noise_V, noise_V)
        self.config = DetectorConfig.of(model, lags_s, noises_V, tuning or Tuning(), range_V, sensors, uncertainty)
        self._warm_up()

    def start(self) -> Memory | None:
        """No memory yet; the first measurement starts the filter."""
        return None

    def step(
        self,
        memory: Any,
        t_s: float,
        measurement: Measurement,
        estimate: Estimate,  # noqa: ARG002 - this detector has a filter of its own
        applied_V: Pair,
    ) -> tuple[Any, Diagnosis]:
        """Verdict at run time t_s, s; applied_V arrived since the last step. `memory` is changed and handed back."""
        if memory is None:
            return Memory.begin(self.config, t_s, measurement, applied_V), Diagnosis()
        m: Memory = memory
        if t_s <= m.t_s:
            return m, self._diagnosis(m, [])
        config = self.config
        self._note(m, t_s, measurement, applied_V)
        alarms = sensor_monitor.examine(config, m, measurement)
        alarms += self._filter(m)
        alarms += drift_review.step(config, m, measurement)
        alarms += unknown.step(config, m)
        if m.lost and m.unknown is None:
            alarms += sensor_monitor.readmit(config, m, measurement)
        is_found = m.suspicion is None and m.unknown is None and own_verdict.is_above_limit(config, m)
        is_found = is_found and not stuck_check.has_found(m)
        if is_found and t_s - m.begun_s >= config.tuning.settle_s and not first_day.explains_alarm(config, m):
            isolation.suspect(config, m)
        ambiguity.watch_movement(m)
        if m.suspicion is not None:
            alarms += isolation.isolate(config, m, m.suspicion)
        alarms += declaration.follow_growth(config, m)
        alarms += declaration.follow_lags(config, m)
        if m.unknown is None and not m.lost and own_verdict.is_learned_on(m):
            alarms += strength.step(m)  # what a pump gives after a fault is not known so well
        declaration.watch_unproven(m)
        return m, self._diagnosis(m, alarms)

    def _note(self, m: Memory, t_s: float, measurement: Measurement, applied_V: Pair) -> None:
        """Write this step's readings into the history."""
        dt = t_s - m.t_s
        m.now += 1
        m.t_s = m.times_s[m.now % RING] = t_s
        n, level_V, usable = measurement.readings, measurement.level_V, m.usable
        floor_V2, gain = self.config.floor_V2, self.config.model.level_gain_V_cm
        scale, expected_cm = m.scale.tolist(), m.x[LEVEL : LEVEL + 4].tolist()
        levels, variances = [nan] * 4, [1.0] * 4
        valid, count, shows_level = measurement.valid, n if n > 1 else 1, self.config.shows_level
        for i, sensor in enumerate(m.sensors):
            if level_V[i] < MAX_READING_V and shows_level(i, level_V[i], gain * expected_cm[i]):
                sensor.learn(measurement, i, is_used=usable[i])
                if n > 0 and usable[i] and valid[i]:
                    levels[i] = level_V[i]
            variances[i] = scale[i] * (sensor.current_variance / count + floor_V2[i])
        mean_age_s = measurement.age_s + 0.5 * dt * (n - 1) / n if n > 0 else 0.0
        doubts = self._voltage_doubts(m, dt, applied_V)
        if max(doubts) > 0.0:  # a mean over a time in which the flow changed at an unknown moment
            levels = [nan] * 4
        # in the order of the layout of an entry, see `filter`
        weight = min(max(1.0 - mean_age_s / dt, 0.0), 1.0)
        walks = [dt * walk for walk in unknown.walk(m).tolist()]
        m.entry[:] = (*applied_V, *levels, *variances, dt, weight, *doubts, *walks)

    def _voltage_doubts(self, m: Memory, dt: float, applied_V: Pair) -> tuple[float, float]:
        """(2,) V, how wrong the lagged voltages are taken to be at the start of a period of dt seconds.

        A pump node reports what it applies now. Where control steps are missing, or where the node itself went to 0 V,
        the moment of the change is unknown; the uncertain volume is put on the lagged voltage.
        """
        before_V, m.applied_V = m.applied_V, applied_V
        is_gap = dt > GAP_PERIODS * m.usual_s
        if not is_gap:
            m.usual_s = dt
        if before_V == applied_V or not (is_gap or 0.0 in applied_V):
            return 0.0, 0.0
        doubts = [0.0, 0.0]
        for j in PUMPS:
            change_V = abs(applied_V[j] - before_V[j])
            if change_V > 0.0 and (is_gap or (applied_V[j] == 0.0 and change_V > DROP_V)):
                lag_s = float(self.config.model.lag_s[j] * m.x[LAG + j])
                doubts[j] = change_V * dt / (lag_s * (1.0 - exp(-dt / lag_s)))
        return doubts[0], doubts[1]

    def _filter(self, m: Memory) -> list[Alarm]:
        """One step of filter and bank."""
        model, entry = self.config.model, m.entry
        if m.growing != NO_GROWTH:
            kernels.grow(m.x, m.P, m.growing, entry[PERIOD])
        if m.is_wide:
            likelihood = wide_filter.step(self.config, m.x, m.P, entry, m.result)
        else:
            likelihood = kernels.filter_step(model, m.x, m.P, entry, m.result)
        m.history.no_jump[m.now % RING] = likelihood
        if m.unknown is None:
            first_day.step(self.config, m, likelihood)
        hidden_level.step(self.config, m, likelihood)
        alarms = stuck_check.step(self.config, m, likelihood)
        slot, m.max_ratio = kernels.update_bank(
            model.level_gain_V_cm, m.now, entry, m.result, m.bank, m.min_jumps(), m.best
        )
        m.keep_filter(slot)
        if float(entry[PERIOD]) > LONG_GAP_S and max(entry[DOUBT : DOUBT + 2]) > 0.0:
            m.forget_levels()
        if m.suspicion is None:
            self._learn_noise(m)
        m.calm_squares[m.now % RING] = m.mean_square
        return alarms

    def _learn_noise(self, m: Memory) -> None:
        """Assume more noise where innovations are larger than expected, but not while a fault may be the reason."""
        tuning = self.config.tuning
        is_calm = m.max_ratio < tuning.calm and m.unknown is None
        entry = m.entry
        period_s = float(entry[PERIOD])
        age_s = m.now * period_s
        is_first = age_s < tuning.first_learning_s and m.unknown is None
        gain = self.config.model.level_gain_V_cm
        kernels.learn_process_noise(gain, entry, m.result, m.noise, age_s, is_calm or is_first)
        pace = tuning.scale_pace if is_calm else 0.0
        square = kernels.learn_scale(entry, m.result, m.scale, pace)
        if square >= 0.0:
            share = min(period_s / tuning.diverged_s, 1.0)
            m.mean_square += share * (min(square, MAX_MEAN_SQUARE) - m.mean_square)

    def _diagnosis(self, m: Memory, alarms: list[Alarm]) -> Diagnosis:
        gain = self.config.model.level_gain_V_cm
        h1, h2, h3, h4 = m.x[LEVEL : LEVEL + 4].tolist()
        level_V = (gain * h1, gain * h2, gain * h3, gain * h4)
        w1, w2, w3, w4 = m.noise.walk.tolist()
        level_walk = (sqrt(w1), sqrt(w2), sqrt(w3), sqrt(w4))
        p1, p2, p3, p4 = m.P.diagonal()[LEVEL : LEVEL + 4].tolist()
        s1, s2, s3, s4 = sqrt(max(p1, 0.0)), sqrt(max(p2, 0.0)), sqrt(max(p3, 0.0)), sqrt(max(p4, 0.0))
        level_std = (gain * s1, gain * s2, gain * s3, gain * s4)
        hidden_cm = hidden_level.levels_cm(self.config, m)
        if not m.declared and not m.lost and not m.strength and m.unknown is None:
            return Diagnosis(
                new_alarms=tuple(alarms),
                level_V=level_V,
                is_diverged=self._is_diverged(m, h1),
                level_walk_cm_sqrt_s=level_walk,
                level_std_V=level_std,
                test_ratio=m.max_ratio,
                test_limit=self.config.tuning.detect,
                open_question=ambiguity.open_question(self.config, m),
                hidden_cm=hidden_cm,
                possible=possible.rigs(self.config, m),
                flow_V=strength.flow_V(m),
            )
        stuck = [j in m.declared and m.declared[j].kind == "pump_stuck_on" for j in PUMPS]
        proven, refuted = [0.0] * 4, [False] * 4
        for i, lost in m.lost.items():
            proven[i], refuted[i] = lost.proven_V, lost.kind != "sensor_drift"
        return Diagnosis(
            effectiveness=declaration.effectiveness(m),
            new_alarms=tuple(alarms),
            trusted=m.trusted,
            level_V=level_V,
            stuck_on=(stuck[0], stuck[1]),
            is_diverged=self._is_diverged(m, h1),
            unproven=declaration.unproven(self.config, m),
            is_blind=declaration.is_blind(m),
            is_unknown=m.unknown is not None,
            unknown_s=m.unknown_s,
            possible_V=unknown.possible_V(self.config, m),
            refuted=(refuted[0], refuted[1], refuted[2], refuted[3]),
            proven_V=(proven[0], proven[1], proven[2], proven[3]),
            valve_split=declaration.valve_split(self.config, m),
            waterways=identified.waterways(self.config, m),
            level_walk_cm_sqrt_s=level_walk,
            level_std_V=level_std,
            test_ratio=m.max_ratio,
            test_limit=self.config.tuning.detect,
            open_question=ambiguity.open_question(self.config, m),
            hidden_cm=hidden_cm,
            possible=possible.rigs(self.config, m),
            flow_V=strength.flow_V(m),
        )

    def _is_diverged(self, m: Memory, level_cm: float) -> bool:
        tuning = self.config.tuning
        has_too_many_verdicts = len(m.verdicts_s) >= tuning.verdicts_max and m.t_s - m.verdicts_s[0] < tuning.diverged_s
        return has_too_many_verdicts or m.mean_square > tuning.diverged or not isfinite(level_cm)

    def _warm_up(self) -> None:
        """Run every compiled function once, so that nothing is compiled while pumps move."""
        reading = Measurement((5.0, 5.0, 1.0, 1.0), ALL, 0.0, 5, (1e-5, 1e-5, 1e-5, 1e-5), (5e-6, 5e-6, 5e-6, 5e-6))
        m = Memory.begin(self.config, 0.0, reading, (0.0, 0.0))
        for number in range(1, 4):
            self._note(m, 0.1 * number, reading, (3.0, 3.0))
            self._filter(m)
        isolation.suspect(self.config, m)
        if m.suspicion is not None:
            isolation.isolate(self.config, m, m.suspicion)
