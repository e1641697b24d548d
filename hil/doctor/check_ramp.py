"""A short, small ramp on one pump: whether the node applies it, and whether the right levels rise.

The levels are compared with eq. (1), integrated from the levels measured at the start, once with the pump's voltage and
once without. The response is the measured share of the difference between the two.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.pumps import PumpPath
from hil.core.sensors import LevelSensors, levels_shown
from hil.core.tanks import TankModel, level_rates, pump_matrix
from hil.core.types import Pair, Quad
from hil.probe.bus_probe import Probe
from hil.probe.check_result import Result, failed, not_checked, passed, warned
from hil.probe.observation import LEVEL_FRAMES, STATUS, Observation

TOP_V = 3.0
RISE_S, HOLD_S = 0.5, 3.0
REST_S = 0.5
SAMPLES = 20
"""Number of readings for the mean of a level."""
RESPONSE_LOW, RESPONSE_HIGH = 0.5, 1.5
NO_RESPONSE = 0.2
MIN_EXPECTED_CM = 0.05
"""A smaller response is not judged: an empty tank whose outlet lies low shows none."""
WEAK_ADVICE = (
    "less water than rig.toml says: is the pump weak, or a hose or valve partly shut? "
    "If not, measure pumps.gain_cm3_Vs and valve_split and set them"
)
STRONG_ADVICE = (
    "more water than rig.toml says: measure pumps.gain_cm3_Vs and valve_split and set them; "
    "or tanks.area_cm2 is too large, or sensors.gain_V_cm too small"
)
HEADROOM_CM = 2.0
"""Required distance to safety.level_max_cm before a pump is moved."""
DT_S = 0.02


@dataclass(frozen=True)
class Ramp:
    """One pump's ramp: status frames and levels. pump : 0 or 1. start_cm, end_cm : measured levels."""

    pump: int
    observation: Observation
    start_cm: Quad
    end_cm: Quad
    duration_s: float


def ramp_voltage(t_s: float) -> float:
    """The pump's voltage at a time: rise, hold, fall."""
    down_s = t_s - RISE_S - HOLD_S
    return TOP_V * max(0.0, min(1.0, t_s / RISE_S, 1.0 - down_s / RISE_S))


TOTAL_S = 2 * RISE_S + HOLD_S


def run(probe: Probe, pump: int, sensors: LevelSensors) -> Ramp:
    """Ramp one pump; afterwards, or if an error is raised, command 0 V and disabled."""
    start_cm = levels_cm(probe.listen(REST_S), sensors)
    begin_ns = probe.now_ns
    try:
        probe.drive(lambda t_s: (ramp_voltage(t_s), 0.0) if pump == 0 else (0.0, ramp_voltage(t_s)), TOTAL_S)
    finally:
        probe.command()
    end_ns = probe.now_ns
    end_cm = levels_cm(probe.listen(REST_S), sensors)
    whole = probe.listener.observed(begin_ns, end_ns)
    return Ramp(pump, whole, start_cm, end_cm, (end_ns - begin_ns) * 1e-9 + REST_S)


def levels_cm(observation: Observation, sensors: LevelSensors) -> Quad:
    """Means of the newest readings in cm; NaN if there are none."""
    means_V = []
    for name, tanks in LEVEL_FRAMES.items():
        newest = observation.of(name)[-SAMPLES:]
        for tank in tanks:
            total_V = sum(arrival.values[f"Level{tank}"] for arrival in newest)
            means_V.append(total_V / len(newest) if newest else float("nan"))
    v1, v2, v3, v4 = means_V
    return levels_shown(sensors.signals((v1, v2, v3, v4)), sensors.signal_gain)


def may_move(level_cm: Quad, level_max_cm: float) -> bool:
    """Whether no tank is nearly full; a level of NaN counts as full."""
    return all(level < level_max_cm - HEADROOM_CM for level in level_cm)


def check_ramp(ramp: Ramp, model: TankModel, pumps: PumpPath, lag_s: float, tolerance_V: float) -> list[Result]:
    """Applied voltage and level response. lag_s : of the pump. tolerance_V : safety.echo_tolerance_V."""
    return [_check_applied(ramp, tolerance_V), *_check_response(ramp, model, pumps, lag_s)]


def unchecked(why: str, advice: str) -> list[Result]:
    """No pump was moved."""
    return [not_checked("pumps", why, advice)]


def _check_applied(ramp: Ramp, tolerance_V: float) -> Result:
    check = f"pump {ramp.pump + 1} voltage"
    begin_ns = ramp.observation.begin_ns
    hold = [
        status
        for status in ramp.observation.of(STATUS)
        if RISE_S + 0.2 <= (status.t_ns - begin_ns) * 1e-9 <= RISE_S + HOLD_S
    ]
    if not hold:
        return failed(check, "no PumpStatus while it ran", "check the pump node")
    own, other = (f"Applied{1 + ramp.pump}", f"Applied{2 - ramp.pump}")
    applied_V = [status.values[own] for status in hold]
    found = f"{min(applied_V):.3f} to {max(applied_V):.3f} V applied, {TOP_V:g} V commanded"
    if max(status.values[other] for status in hold) > 0.0:
        return failed(check, f"{found}; the other pump ran, too", "the node exchanges its outputs")
    if max(abs(voltage - TOP_V) for voltage in applied_V) > tolerance_V:
        return failed(check, found, "check the node's converter; has the node tripped?")
    return passed(check, found)


def _check_response(ramp: Ramp, model: TankModel, pumps: PumpPath, lag_s: float) -> list[Result]:
    """The two tanks that the pump feeds."""
    driven, drained = (_predicted(ramp, model, pumps, lag_s, scale) for scale in (1.0, 0.0))
    feeds = pump_matrix(model)[:, ramp.pump]
    results = []
    for tank in range(4):
        if feeds[tank] == 0.0:
            continue
        check = f"pump {ramp.pump + 1} to tank {tank + 1}"
        expected_cm, seen_cm = driven[tank] - drained[tank], ramp.end_cm[tank] - drained[tank]
        if expected_cm < MIN_EXPECTED_CM:
            why = f"{expected_cm:+.2f} cm expected from rig.toml: its outlet lets the water through at once"
            results.append(not_checked(check, why, "fill the tank and check again"))
            continue
        share = seen_cm / expected_cm
        found = f"{seen_cm:+.2f} cm by the pump, {expected_cm:+.2f} cm expected from rig.toml ({share:.0%})"
        if not share >= NO_RESPONSE:
            advice = "no water: check pump, supply, valve, reservoir and hose, and the sensor of this tank"
            results.append(failed(check, found, advice))
        elif share < RESPONSE_LOW:
            results.append(warned(check, found, WEAK_ADVICE))
        elif not share <= RESPONSE_HIGH:
            results.append(warned(check, found, STRONG_ADVICE))
        else:
            results.append(passed(check, found))
    return results


def _predicted(ramp: Ramp, model: TankModel, pumps: PumpPath, lag_s: float, scale: float) -> Quad:
    """Levels at the end of the ramp by eq. (1), the pump's curve, delay and lag included."""
    h1, h2, h3, h4 = ramp.start_cm
    flow_V, t_s = 0.0, 0.0
    while t_s < ramp.duration_s:
        at_pump_V = scale * ramp_voltage(t_s - pumps.delay_s[ramp.pump])
        wanted_V = pumps.drive((at_pump_V, at_pump_V))[ramp.pump]
        flow_V += (wanted_V - flow_V) * (min(1.0, DT_S / lag_s) if lag_s > 0.0 else 1.0)
        pump_V: Pair = (flow_V, 0.0) if ramp.pump == 0 else (0.0, flow_V)
        r1, r2, r3, r4 = level_rates(model, (h1, h2, h3, h4), pump_V)
        h1, h2 = max(h1 + r1 * DT_S, 0.0), max(h2 + r2 * DT_S, 0.0)
        h3, h4 = max(h3 + r3 * DT_S, 0.0), max(h4 + r4 * DT_S, 0.0)
        t_s += DT_S
    return (h1, h2, h3, h4)
