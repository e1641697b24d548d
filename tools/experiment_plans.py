"""Plans of an identification experiment, compared by what their records tell: `python -m tools.experiment_plans`.

Each plan is run on a rig like its file, with the envelope that keeps its levels safe. Its information is that of the
readings (5 mV, 50 Hz), by the sensitivities of the fit. D: the volume of the confidence ellipsoid against the plan in
use, as a factor of each parameter's deviation: below 1 is better. `worst` and `mean`: deviation of k, gamma and a, %.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.core import experiment_plan
from hil.core.experiment import Envelope, Phase, PhaseState, Segment, advance
from hil.core.experiment_plan import PlanSpec, binary_sequence, envelope, plan
from hil.core.identification.parameters import RigModel
from hil.core.identification.records import LevelRecord
from hil.core.identification.simulation import LEVELS, levels
from hil.core.pumps import PumpPath
from hil.core.tanks import TankModel, level_rates
from hil.core.types import Quad

Array = NDArray[np.float64]

PERIOD_S = 0.1
NOISE_V = 0.005 / 5**0.5
GAINS = ("k1", "k2", "gamma1", "gamma2", "a1", "a2", "a3", "a4")
BASIC = (*GAINS, "lag1", "lag2")
FULL = (*BASIC, "curve1", "curve2", "dead_zone1", "dead_zone2", "datum1", "datum2", "datum3", "datum4")
SPEC = PlanSpec(TankModel(), PumpPath(), (3.0, 3.0), level_max_cm=19.0, rim_margin_cm=0.5)

Change = Callable[[tuple[Phase, ...]], tuple[Phase, ...]]


@dataclass(frozen=True, eq=False)
class Told:
    """What a plan tells. deviation : (p,) standard deviations. time_s : its length."""

    names: tuple[str, ...]
    logdet: float
    deviation: Array
    time_s: float


def told(spec: PlanSpec, change: Change, names: Sequence[str]) -> Told:
    """The information of all fitted phases; the initial levels of each are unknown."""
    total, time_s = np.zeros((len(names), len(names))), 0.0
    level_cm: Quad = (0.0, 0.0, 0.0, 0.0)
    for phase in change(plan(spec)):
        record, level_cm = _run(spec, envelope(spec), phase, level_cm)
        time_s += float(record.time_s[-1])
        if not phase.is_held_out:
            total += _information(spec, record, names)
    covariance = np.linalg.inv(total)
    return Told(tuple(names), float(np.linalg.slogdet(total)[1]), np.sqrt(np.diag(covariance)), time_s)


def _run(spec: PlanSpec, bounds: Envelope, phase: Phase, level_cm: Quad) -> tuple[LevelRecord, Quad]:
    state, t_s = PhaseState(), 0.0
    times, voltages, seen = [], [], []
    while True:
        state = advance(phase, bounds, state, t_s, level_cm, answered=sys.maxsize)
        if state.is_over or state.problem:
            break
        times.append(t_s)
        voltages.append(state.voltage_V)
        seen.append(level_cm)
        h1, h2, h3, h4 = level_cm
        r1, r2, r3, r4 = level_rates(spec.model, level_cm, state.voltage_V)
        level_cm = (
            max(h1 + PERIOD_S * r1, 0.0),
            max(h2 + PERIOD_S * r2, 0.0),
            max(h3 + PERIOD_S * r3, 0.0),
            max(h4 + PERIOD_S * r4, 0.0),
        )
        t_s += PERIOD_S
    first = (float(seen[0][0]), float(seen[0][1]), float(seen[0][2]), float(seen[0][3]))
    readings = 0.5 * np.array(seen)
    return LevelRecord(phase.name, np.array(times), np.array(voltages), readings, initial_cm=first), level_cm


def _information(spec: PlanSpec, record: LevelRecord, names: Sequence[str]) -> Array:
    """(p, p) of one record, after its initial levels were estimated too."""
    count = len(names)
    wanted = (*names, *LEVELS)
    by = levels(RigModel(spec.model, spec.pumps), record, record.initial_cm, wanted).by
    seen = np.array(record.reading_V) > 0.01  # an empty tank tells nothing
    jacobian = (by * 0.5 / NOISE_V * seen[:, :, None]).reshape(-1, len(wanted))
    whole = jacobian.T @ jacobian
    inner = whole[count:, count:] + 1e-6 * np.eye(4)
    rest: Array = whole[:count, :count] - whole[:count, count:] @ np.linalg.solve(inner, whole[count:, :count])
    return rest


def binary_only(clock_s: float, low: float, high: float) -> Change:
    """Binary sequences of the same length in place of steps, drain and binary."""

    def change(phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
        out: list[Phase] = []
        for phase in phases:
            if phase.name in ("steps", "drain", "binary"):
                length = round(phase.max_s / clock_s)
                out.append(_with_binary(phase, length, clock_s, low, high, 7 * len(out)))
            else:
                out.append(phase)
        return tuple(out)

    return change


def binary(clock_s: float, low: float, high: float) -> Change:
    """Another clock and other amplitudes in the binary sequence."""

    def change(phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
        return tuple(
            _with_binary(phase, round(phase.max_s / clock_s), clock_s, low, high, 1)
            if phase.name == "binary"
            else phase
            for phase in phases
        )

    return change


def _with_binary(phase: Phase, length: int, clock_s: float, low: float, high: float, start: int) -> Phase:
    base1, base2 = SPEC.base_drives
    pairs = zip(binary_sequence(length, start), binary_sequence(length, start + 31), strict=True)
    segments = tuple(
        Segment((base1 * (high if one else low), base2 * (high if two else low)), clock_s) for one, two in pairs
    )
    return replace(phase, segments=segments, lift_V=(1.3 * base1, 1.3 * base2))


def as_it_is(phases: tuple[Phase, ...]) -> tuple[Phase, ...]:
    """The plan in use."""
    return phases


VARIANTS: tuple[tuple[str, Change, float], ...] = (
    ("the plan in use", as_it_is, experiment_plan.MIDDLE_SHARE),
    ("middle at 30 %", as_it_is, 0.3),
    ("middle at 40 %", as_it_is, 0.4),
    ("middle at 60 %", as_it_is, 0.6),
    ("middle at 40 %, binary 8 s, 0.4 to 1.6", binary(8.0, 0.4, 1.6), 0.4),
    ("binary 4 s, 0.4 to 1.6", binary(4.0, 0.4, 1.6), 0.5),
    ("binary 16 s, 0.2 to 1.8", binary(16.0, 0.2, 1.8), 0.5),
    ("binary 20 s, 0 to 2", binary(20.0, 0.0, 2.0), 0.5),
    ("binary 32 s, 0 to 2", binary(32.0, 0.0, 2.0), 0.5),
    ("nothing but binary, 8 s, 0.4 to 1.6", binary_only(8.0, 0.4, 1.6), 0.5),
    ("nothing but binary, 30 s, 0 to 2", binary_only(30.0, 0.0, 2.0), 0.5),
)


def main() -> int:
    """Entry point."""
    for is_full, names in ((False, BASIC), (True, FULL)):
        print(f"{'full' if is_full else 'basic'} structure, {len(names)} parameters")
        reference = None
        for title, change, middle in VARIANTS:
            experiment_plan.MIDDLE_SHARE = middle
            spec = replace(SPEC, is_full=is_full)
            found = told(spec, change, names)
            reference = reference or found
            factor = np.exp(0.5 * (reference.logdet - found.logdet) / len(names))
            own = np.array([3.33, 3.35, 0.7, 0.6, 0.071, 0.057, 0.071, 0.057])
            share = 100.0 * found.deviation[: len(own)] / own
            print(
                f"  {title:40} {found.time_s:5.0f} s  D {factor:5.3f}  mean {share.mean():.4f} %  "
                f"worst {share.max():.4f} %  lag {100.0 * found.deviation[8] / 0.2:.2f} %"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
