"""The detector: filter, bank, replays and channel tests, composed into a `FaultDetector`.

watching   the filter runs, the bank looks back; a likelihood ratio above DETECT raises an alarm
isolating  every hypothesis is replayed from its onset; the alarm names the candidates until one is ahead by MARGIN
settled    the winner's filter becomes the filter, and watching goes on: for the next fault, or for the recovery
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import exp, inf, isfinite, nan, sqrt
from typing import Any

import numpy as np

from hil.core.estimator import Estimate
from hil.core.glr import bank, process, replay
from hil.core.glr.bank import Bank, Ints
from hil.core.glr.channels import OPEN_RUN, Channel
from hil.core.glr.hypotheses import BOTH, JUMPS, PUMPS, H
from hil.core.glr.process import BIAS, DRIFT, GAIN, LAG, LEAK, LEVEL, MOVING, PUMP, Array, N
from hil.core.glr.replay import History, Replays
from hil.core.tanks import TankModel
from hil.core.types import UNRESOLVED, Alarm, Diagnosis, Measurement, Pair, Quad

DETECT = 20.0
"""Log-likelihood ratio that raises an alarm."""

MARGIN = 5.0
"""By how much the likeliest hypothesis must lead."""

BOTH_LEAD = 3.0
"""Both pumps include each single one: by how much they must lead for a single one not to be believed yet."""

SECOND_PUMP_STD = 0.04
"""A single pump is believed once a loss of the other would be known as well as this."""

SETTLE_S = 1.0
"""No alarm before the filter has settled."""

RESOLVE_WITHIN_S = 20.0
"""After so long the likeliest is taken without the margin."""

REPLAY_BUDGET = 600
"""Filter steps of the replays in one control period; what is left waits for the next."""

PARAMETER_STD = 0.03
"""How far gains, splits and outlets may be off the rig file's at the start, relative."""

LAG_STD = 0.5
PARAMETER_WALK = 2e-5
LEVEL_WALK_CM = 2e-4
"""What levels and parameters may move by themselves in a control period (standard deviation)."""

LEAST_STEPS = 2
"""Steps after the onset before anything is settled: the first holds part of the fault only."""

REFINED_ONSETS = 5
SIZE_DOUBT, PRIOR_DOUBT = 0.1, 0.05
"""How wrong a size may be for reasons that its variance doesn't know: shares of itself and of its prior."""

READING_FLOOR_V = 1e-3
"""A mean of readings is never trusted to less than this: converters have steps."""

SCALE_PACE = 0.003
"""How fast the believed noise follows innovations that are larger than expected."""

CALM = 8.0
"""Below this ratio the innovations are taken for those of a sound rig, and noise is learned from them."""


@dataclass
class Suspicion:
    """An alarm that is not resolved yet."""

    number: int
    detected_s: float


@dataclass
class Memory:
    """All that the detector knows; changes in place, and belongs to one run."""

    x: Array
    P: Array
    bank: Bank
    history: History
    replays: Replays
    channels: list[Channel]
    A: Array = field(default_factory=lambda: np.zeros((MOVING, N)))
    K: Array = field(default_factory=lambda: np.zeros((N, 4)))
    white: Array = field(default_factory=lambda: np.zeros((4, 4)))
    innovation: Array = field(default_factory=lambda: np.zeros(4))
    scale: list[float] = field(default_factory=lambda: [1.0] * 4)
    ratio: Array = field(default_factory=lambda: np.zeros(H + 1))
    slot: Ints = field(default_factory=lambda: np.zeros(H + 1, dtype=np.int64))
    statistic: float = 0.0
    now: int = 0
    times_s: list[float] = field(default_factory=lambda: [nan] * replay.RING)
    t_s: float = nan
    usable: list[bool] = field(default_factory=lambda: [True] * 4)
    sound_gain: dict[int, float] = field(default_factory=dict)
    declared: dict[int, tuple[str, float]] = field(default_factory=dict)
    suspicion: Suspicion | None = None
    alarms: int = 0
    stuck_on: list[bool] = field(default_factory=lambda: [False, False])


class GlrDetector:
    """Generalised likelihood ratios over onset and hypothesis, isolation by replay."""

    def __init__(self, model: TankModel, lag_s: float, noise_V: float) -> None:
        """Compiles what is not compiled yet: seconds, the first time on a machine."""
        self._c = process.constants(model, lag_s)
        self._noise_V = noise_V
        walk = np.zeros(N)
        walk[LEVEL : LEVEL + 4] = LEVEL_WALK_CM**2
        walk[GAIN:LEAK] = PARAMETER_WALK**2
        self._walk = walk
        self._warm_up()

    def start(self) -> Memory | None:
        """Nothing known; the first measurement starts the filter."""
        return None

    def step(
        self, memory: Any, t_s: float, measurement: Measurement, estimate: Estimate, applied_V: Pair
    ) -> tuple[Any, Diagnosis]:
        """Verdict at run time t_s, s; applied_V held since the last step."""
        del estimate
        if memory is None:
            return self._begin(t_s, measurement, applied_V), Diagnosis()
        m: Memory = memory
        dt = t_s - m.t_s
        if dt <= 0.0:
            return m, self._verdict(m, ())
        self._enter(m, t_s, dt, measurement, applied_V)
        alarms: list[Alarm] = []
        self._test_channels(m, measurement, alarms)
        self._filter(m)
        if m.suspicion is None and m.statistic >= DETECT and t_s >= SETTLE_S:
            self._suspect(m)
        if m.suspicion is not None:
            alarms += self._isolate(m)
        return m, self._verdict(m, tuple(alarms))

    # -- watching

    def _begin(self, t_s: float, measurement: Measurement, applied_V: Pair) -> Memory:
        x, P = np.zeros(N), np.zeros((N, N))
        x[LEVEL : LEVEL + 4] = np.array(measurement.level_V) / self._c[13]
        x[PUMP : PUMP + 2] = applied_V
        x[GAIN:LEAK] = 1.0
        diagonal = np.zeros(N)
        n = max(measurement.readings, 1)
        diagonal[LEVEL : LEVEL + 4] = self._noise_V**2 / n / self._c[13] ** 2 + 0.01**2
        diagonal[GAIN:LEAK] = PARAMETER_STD**2
        diagonal[LAG : LAG + 2] = LAG_STD**2
        np.fill_diagonal(P, diagonal)
        channels = [Channel(self._noise_V**2) for _ in range(4)]
        m = Memory(x, P, Bank.empty(), History.empty(), Replays.empty(), channels)
        m.t_s = t_s
        m.times_s[0] = t_s
        self._open_slot(m)
        return m

    def _enter(self, m: Memory, t_s: float, dt: float, measurement: Measurement, applied_V: Pair) -> None:
        """Write this step's readings into the history."""
        m.now += 1
        m.t_s = t_s
        m.times_s[m.now % replay.RING] = t_s
        entry = m.history.entries[m.now % replay.RING]
        n = measurement.readings
        mean_age = measurement.age_s + 0.5 * dt * (n - 1) / max(n, 1)
        for i, channel in enumerate(m.channels):
            channel.learn(measurement, i)
            is_there = n > 0 and m.usable[i] and measurement.valid[i]
            entry[2 + i] = measurement.level_V[i] if is_there else nan
            entry[6 + i] = m.scale[i] * (channel.variance_V2 / max(n, 1) + READING_FLOOR_V**2)
        entry[0:2] = applied_V
        entry[10] = dt
        entry[11] = min(max(1.0 - mean_age / dt, 0.0), 1.0)

    def _filter(self, m: Memory) -> None:
        at = m.now % replay.RING
        entry = m.history.entries[at]
        m.history.none[at] = process.step(self._c, self._walk, m.x, m.P, entry, m.A, m.K, m.white, m.innovation)
        b = m.bank
        bank.advance(self._c[13], entry, m.A, m.K, m.white, m.innovation, b.effect, b.energy, b.match, b.cross)
        self._open_slot(m)
        rise, fall = self._least(m)
        m.statistic = bank.best(rise, fall, b.onset, b.energy, b.match, b.cross, m.ratio, m.slot)
        if m.statistic < CALM and m.suspicion is None:
            self._learn_scale(m)

    def _learn_scale(self, m: Memory) -> None:
        for i in range(4):
            if isfinite(m.history.entries[m.now % replay.RING][2 + i]):
                white = sum(m.white[i, j] * m.innovation[j] for j in range(i + 1))
                m.scale[i] = min(max(m.scale[i] * exp(SCALE_PACE * (min(white * white, 9.0) - 1.0)), 1.0), 25.0)

    def _open_slot(self, m: Memory) -> None:
        b = m.bank
        slot = bank.open_slot(m.now, bank.STATES, b.onset, b.effect, b.energy, b.match, b.cross)
        m.history.x[slot] = m.x
        m.history.P[slot] = m.P

    def _least(self, m: Memory) -> tuple[Array, Array]:
        """Smallest jumps up and down that count; what has been declared may also go back."""
        rise, fall = _LEAST_RISE.copy(), _LEAST_FALL.copy()
        for j, (_, size) in m.declared.items():
            rise[j], fall[j] = JUMPS[j].least_rise, JUMPS[j].least_fall
            if size < 0.0:
                rise[j] = JUMPS[j].least_fall
        return rise, fall

    # -- isolating

    def _suspect(self, m: Memory) -> None:
        m.alarms += 1
        m.suspicion = Suspicion(m.alarms, m.t_s)
        leader = int(np.argmax(m.ratio))
        for number in range(H + 1):
            slot = int(m.slot[number]) if m.slot[number] >= 0 else int(m.slot[leader])
            self._begin_replay(m, number, number, slot)

    def _begin_replay(self, m: Memory, row: int, number: int, slot: int) -> None:
        reach = np.zeros(4)
        for j in PUMPS if number == BOTH else (number,):
            energy = m.bank.energy[j, slot]
            size = min(max(m.bank.match[j, slot] / energy, -1.0), 1.0) if energy > 0.0 else 0.0
            reach += size * m.A[:4, JUMPS[j].state]
        m.replays.begin(row, number, m.history, slot, int(m.bank.onset[slot]), reach)

    def _catch_up(self, m: Memory, rows: int, budget: int) -> int:
        r = m.replays
        return replay.catch_up(
            self._c, self._walk, m.history.entries, m.history.none, r.x, r.P, r.evidence, r.seen, r.onset, m.now,
            budget, r.bias, rows,
        )  # fmt: skip

    def _isolate(self, m: Memory) -> list[Alarm]:
        suspicion, r = m.suspicion, m.replays
        assert suspicion is not None  # noqa: S101
        left = self._catch_up(m, H + 1, REPLAY_BUDGET)
        is_new = suspicion.detected_s == m.t_s
        if left:
            return [self._unresolved(m, [int(np.argmax(m.ratio))])] if is_new else []
        evidence = np.array([value if self._is_possible(m, j) else -inf for j, value in enumerate(r.evidence)])
        order = [int(j) for j in np.argsort(-evidence)]
        is_bias = order[0] != BOTH and BIAS <= JUMPS[order[0]].state < DRIFT
        is_seen = is_bias or m.now - int(r.onset[order[0]]) >= LEAST_STEPS
        winner = self._winner(m, evidence, order) if is_seen else None
        if winner is None and m.t_s - suspicion.detected_s > RESOLVE_WITHIN_S:
            winner = order[0]
        if winner is not None:
            return self._settle(m, winner)
        if not is_new:
            return []
        likely = [j for j in order if evidence[j] >= evidence[order[0]] - MARGIN]
        return [self._unresolved(m, likely + [j for j in range(H) if m.ratio[j] >= m.statistic - MARGIN])]

    def _winner(self, m: Memory, evidence: Array, order: list[int]) -> int | None:
        """The hypothesis that leads by enough, or None."""
        singles = [j for j in order if j != BOTH]
        first, second = singles[0], singles[1]
        if first in PUMPS:
            other = PUMPS[1 - first]
            rival = max((evidence[j] for j in singles[1:] if j not in PUMPS), default=-inf)
            if evidence[BOTH] - evidence[first] >= BOTH_LEAD:
                return BOTH if evidence[BOTH] - max(rival, evidence[first]) >= MARGIN else None
            state = JUMPS[other].state
            is_alone = sqrt(m.replays.P[BOTH][state, state]) < SECOND_PUMP_STD
            return first if is_alone and evidence[first] - evidence[second] >= MARGIN else None
        if evidence[BOTH] - evidence[first] >= MARGIN:
            return BOTH
        rival = max(evidence[second], evidence[BOTH])
        return first if evidence[first] - rival >= MARGIN else None

    def _is_possible(self, m: Memory, number: int) -> bool:
        """Whether the size found has a sign that the fault can have."""
        rise, fall = self._least(m)
        sizes = [(j, self._jump(m, number, j)) for j in (PUMPS if number == BOTH else (number,))]
        if any(abs(size) < (rise[j] if size > 0.0 else fall[j]) for j, size in sizes):
            return False
        return len({size > 0.0 for _, size in sizes}) == 1

    def _jump(self, m: Memory, number: int, j: int) -> float:
        state = JUMPS[j].state
        return float(m.replays.x[number, state] - m.replays.before[number, state])

    # -- settled

    def _settle(self, m: Memory, winner: int) -> list[Alarm]:
        suspicion, r = m.suspicion, m.replays
        assert suspicion is not None  # noqa: S101
        m.suspicion = None
        row = self._refine(m, winner)
        m.x[:], m.P[:] = r.x[row], r.P[row]
        before, onset = r.before[row], int(r.onset[row])
        self._loosen(m, winner, before)
        alarms = []
        for index, j in enumerate(PUMPS if winner == BOTH else (winner,)):
            if index:
                m.alarms += 1
            alarms.append(self._declare(m, j, before, onset, suspicion, m.alarms if index else suspicion.number))
        m.bank.clear()
        self._open_slot(m)
        return alarms

    def _refine(self, m: Memory, winner: int) -> int:
        """Try the onsets around the winner's own; the row of the replay that explains the readings best."""
        onset = int(m.replays.onset[winner])
        slots = sorted(
            (s for s in range(bank.SLOTS) if m.bank.onset[s] >= 0), key=lambda s: abs(int(m.bank.onset[s]) - onset)
        )
        near = [s for s in slots[:REFINED_ONSETS] if m.bank.onset[s] < m.now - 1]
        if not near or all(m.bank.onset[s] != onset for s in near):
            return winner
        for row, slot in enumerate(near):
            self._begin_replay(m, row, winner, slot)
        self._catch_up(m, len(near), 1 << 40)
        # each is judged against no jump from its own onset on, so the ratios compare as they are
        return int(np.argmax(m.replays.evidence[: len(near)]))

    def _loosen(self, m: Memory, winner: int, before: Array) -> None:
        """An onset off by part of a step has left its mark on levels and size: let the readings correct it."""
        for j in PUMPS if winner == BOTH else (winner,):
            state = JUMPS[j].state
            size = float(m.x[state] - before[state])
            m.P[state, state] += (SIZE_DOUBT * abs(size) + PRIOR_DOUBT * JUMPS[j].prior) ** 2
            m.P[range(4), range(4)] += (size * m.A[:4, state]) ** 2

    def _declare(self, m: Memory, j: int, before: Array, onset: int, suspicion: Suspicion, number: int) -> Alarm:
        jump = JUMPS[j]
        state = jump.state
        size = float(m.x[state] - before[state])
        std = float(sqrt(m.P[state, state]))
        known = m.declared.get(j)
        kind = known[0] if known else (jump.rises if size > 0.0 else jump.falls)
        total = size + (known[1] if known else 0.0)
        is_recovery = known is not None and abs(total) < max(3.0 * std, 3.0 * jump.least_fall)
        shown = total
        if kind in ("pump_effectiveness", "pump_stuck_on"):
            sound = m.sound_gain.setdefault(state, float(before[state]))
            shown = float(m.x[state]) / sound
            total = shown - 1.0
            is_recovery = known is not None and abs(total) < max(3.0 * std, 0.03)
        elif kind in ("outlet_block", "leak") and state < LEAK:
            shown = abs(total / float(before[state]))
        elif kind == "valve_split":
            shown = float(m.x[state] * self._c[10 + jump.target - 1])
        elif kind == "pump_lag":
            shown = float(m.x[state] * self._c[12])
        if is_recovery:
            m.declared.pop(j, None)
            m.sound_gain.pop(state, None)
        else:
            m.declared[j] = (kind, total)
        m.stuck_on = [m.declared.get(p, ("", 0.0))[0] == "pump_stuck_on" for p in PUMPS]
        return Alarm(
            suspicion.detected_s,
            kind,
            jump.target,
            shown,
            size_std=std,
            onset_s=m.times_s[onset % replay.RING],
            isolated_s=m.t_s,
            candidates=(f"{kind} {jump.target}",),
            number=number,
            is_recovery=is_recovery,
        )

    def _unresolved(self, m: Memory, numbers: list[int]) -> Alarm:
        assert m.suspicion is not None  # noqa: S101
        names: list[str] = []
        for number in numbers:
            for j in PUMPS if number == BOTH else (number,):
                size = (
                    self._jump(m, number, j)
                    if number == BOTH or m.replays.seen[number] == m.now
                    else m.bank.match[j, m.slot[j]]
                )
                name = f"{JUMPS[j].rises if size > 0.0 else JUMPS[j].falls} {JUMPS[j].target}"
                if name not in names:
                    names.append(name)
        onset = int(m.replays.onset[numbers[0]])
        return Alarm(
            m.suspicion.detected_s, UNRESOLVED, 0, nan,
            onset_s=m.times_s[onset % replay.RING], candidates=tuple(names), number=m.suspicion.number,
        )  # fmt: skip

    def _test_channels(self, m: Memory, measurement: Measurement, alarms: list[Alarm]) -> None:
        for i, channel in enumerate(m.channels):
            if not m.usable[i]:
                continue
            kind = ""
            back = 1
            if measurement.invalid_run[i] >= OPEN_RUN:
                kind, run = "sensor_open", measurement.invalid_run[i]
            elif measurement.readings > 0 and channel.is_stuck(measurement, i):
                kind, run = "sensor_stuck", measurement.repeats[i] + 1
            elif channel.is_garbage():
                kind, run = "sensor_garbage", channel.noisy_periods * measurement.readings
            if kind:
                back = 1 + run // max(measurement.readings, 1)
                alarms.append(self._lose(m, i, kind, back))

    def _lose(self, m: Memory, i: int, kind: str, back: int) -> Alarm:
        """Go on without sensor i, and without what it said in the last `back` steps."""
        m.usable[i] = False
        b = m.bank
        reachable = [s for s in range(bank.SLOTS) if 0 <= b.onset[s] <= m.now - 1 - back]
        slot = (
            max(reachable, key=lambda s: int(b.onset[s]))
            if reachable
            else int(np.argmin(np.where(b.onset < 0, 1 << 60, b.onset)))
        )
        onset = int(b.onset[slot])
        m.x[:], m.P[:] = m.history.x[slot], m.history.P[slot]
        for state in (BIAS + i, DRIFT + i):
            m.x[state] = 0.0
            m.P[state, :] = m.P[:, state] = 0.0
        for number in range(onset + 1, m.now + 1):
            entry = m.history.entries[number % replay.RING]
            entry[2 + i] = nan
            if number < m.now:
                m.history.none[number % replay.RING] = process.step(
                    self._c, self._walk, m.x, m.P, entry, m.A, m.K, m.white, m.innovation
                )
        m.bank.clear()
        number = m.suspicion.number if m.suspicion else m.alarms + 1
        detected_s = m.suspicion.detected_s if m.suspicion else m.t_s
        m.suspicion = None
        m.alarms = max(m.alarms, number)
        return Alarm(
            detected_s, kind, i + 1, nan, onset_s=m.times_s[onset % replay.RING], isolated_s=m.t_s,
            candidates=(f"{kind} {i + 1}",), number=number,
        )  # fmt: skip

    def _verdict(self, m: Memory, alarms: tuple[Alarm, ...]) -> Diagnosis:
        theta = [1.0, 1.0]
        for pump in PUMPS:
            sound = m.sound_gain.get(GAIN + pump)
            if sound is not None:
                theta[pump] = min(max(float(m.x[GAIN + pump]) / sound, 0.0), 1.0)
        trusted = [m.usable[i] and (12 + i) not in m.declared and (16 + i) not in m.declared for i in range(4)]
        gain = float(self._c[13])
        h1, h2, h3, h4 = (gain * float(h) for h in m.x[LEVEL : LEVEL + 4])
        return Diagnosis(
            (theta[0], theta[1]),
            alarms,
            (trusted[0], trusted[1], trusted[2], trusted[3]),
            (h1, h2, h3, h4),
            (m.stuck_on[0], m.stuck_on[1]),
        )

    def _warm_up(self) -> None:
        """Have every compiled function run once, so that nothing is compiled while pumps move."""
        level: Quad = (5.0, 5.0, 1.0, 1.0)
        m = self._begin(0.0, Measurement(level, (True,) * 4, 0.0, 5, (1e-5,) * 4), (0.0, 0.0))
        for number in range(1, 4):
            self._enter(m, 0.1 * number, 0.1, Measurement(level, (True,) * 4, 0.0, 5, (1e-5,) * 4), (3.0, 3.0))
            self._filter(m)
        self._suspect(m)
        self._isolate(m)


_LEAST_RISE = np.array([jump.least_rise if jump.rises else inf for jump in JUMPS])
_LEAST_FALL = np.array([jump.least_fall if jump.falls else inf for jump in JUMPS])
