"""The whole examination of a bench: listen first, then command 0 V, and move pumps only on request.

Nothing is sent to a pump node that another sender commands, that applies a voltage, or that sends no status. See
docs/decisions/0016-doctor.md.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.pumps import PumpPath
from hil.core.sensors import LevelSensors
from hil.core.tanks import TankModel
from hil.core.types import NodeState, Pair, Quad
from hil.doctor import check_echo, check_ramp, check_watchdog
from hil.doctor.check_frames import check_foreign_traffic, check_frames
from hil.doctor.check_nodes import check_nodes, is_free
from hil.doctor.check_sensors import check_sensors
from hil.probe.bus_probe import Probe, ProbeError
from hil.probe.check_result import Result, failed, has_failed, not_checked
from hil.probe.observation import STATUS, Observation


@dataclass(frozen=True, slots=True)
class Expectations:
    """The rig file's values for the bench.

    lag_s : (2,) of the pumps. pumps : from voltages to what arrives at the tanks. sensors : from readings to levels.
    rate_V_s : of commands. noise_V : (4,) of a reading.
    """

    model: TankModel
    lag_s: Pair
    pumps: PumpPath
    sensors: LevelSensors
    rate_V_s: float
    noise_V: Quad
    level_max_cm: float
    errors_per_s_max: int
    echo_age_max_s: float
    echo_tolerance_V: float


def examine(probe: Probe, wants: Expectations, seconds: float, *, with_pumps: bool = False) -> list[Result]:
    """All results, in the order of the table. Raises InterruptedByUserError; a bus that fails is a result."""
    results: list[Result] = []
    try:
        observation = probe.listen(seconds)
        results += check_foreign_traffic(observation, wants.errors_per_s_max)
        results += check_nodes(observation)
        results += check_frames(observation)
        results += check_sensors(observation, wants.sensors, wants.noise_V, wants.model)
        _command(probe, wants, observation, results)
        if with_pumps:
            _move(probe, wants, results)
    except ProbeError as error:
        results.append(
            failed("examination", f"stopped: {error}", "check adapter, cable, link, and other senders on the bus")
        )
    return results


def _command(probe: Probe, wants: Expectations, observation: Observation, results: list[Result]) -> None:
    """Watchdog and echoes, with commands of 0 V."""
    status = observation.last(STATUS)
    if not is_free(observation) or status is None:
        why = "nothing is sent: the pump node does not wait for commands"
        results += [check_watchdog.unchecked(why), not_checked("echo latency", why)]
        return
    if NodeState(int(status.values["State"])) is NodeState.TRIPPED:
        results.append(check_watchdog.unchecked("the pump node has already tripped: clear the trip first"))
    else:
        results.append(check_watchdog.check_watchdog(check_watchdog.measure(probe)))
    cycle_s = observation.contract.frames[STATUS].cycle_s
    results.append(
        check_echo.check_echo(check_echo.measure(probe, wants.echo_age_max_s), cycle_s, wants.echo_age_max_s)
    )


def _move(probe: Probe, wants: Expectations, results: list[Result]) -> None:
    """Move each pump in turn; none after a failed check."""
    for pump in (0, 1):
        status = probe.listener.newest(STATUS)
        if has_failed(results):
            results += check_ramp.unchecked("no pump is moved after a failed check", "fix what failed and check again")
            return
        if status is None or NodeState(int(status.values["State"])) is not NodeState.READY:
            results += check_ramp.unchecked("the pump node is not ready", "clear its trip first: hil run --clear-trip")
            return
        top_V, rate_V_s = check_ramp.TOP_V, check_ramp.TOP_V / check_ramp.RISE_S
        if not wants.pumps.range_V[0] <= top_V <= wants.pumps.range_V[1] or rate_V_s > wants.rate_V_s:
            why = f"a ramp to {top_V:g} V at {rate_V_s:g} V/s is beyond pumps.range_V or rate_V_s of rig.toml"
            results += check_ramp.unchecked(why, "")
            return
        if wants.pumps.drive((top_V, top_V))[pump] <= 0.0:
            why = f"a ramp to {top_V:g} V does not leave pumps.dead_zone_V of rig.toml"
            results += check_ramp.unchecked(why, "")
            return
        level_cm = check_ramp.levels_cm(probe.listen(check_ramp.REST_S), wants.sensors)
        if not check_ramp.may_move(level_cm, wants.level_max_cm):
            results += check_ramp.unchecked("a tank is nearly full", "let it drain first")
            return
        done = check_ramp.run(probe, pump, wants.sensors)
        results += check_ramp.check_ramp(done, wants.model, wants.pumps, wants.lag_s[pump], wants.echo_tolerance_V)
