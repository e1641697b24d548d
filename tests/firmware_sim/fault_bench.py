"""Helpers of the fault tests: faults by name, a rig that is driven, what its frames say."""

from typing import Any

import can

from firmware_sim.faults.base import Fault
from firmware_sim.faults.catalogue import KINDS
from firmware_sim.frames import FRAME_IDS
from firmware_sim.pump_node import Observer
from firmware_sim.rig import Rig
from firmware_sim.settings import EmulatorSettings
from tests.firmware_sim.sim_bench import MS, SECOND, command, emulator

QUIET = emulator(
    pumps={"lag_s": 0.0, "dac_bits": 0}, sensors={"noise_V": 0.0, "adc_bits": 12}, tanks={"start_V": [3.0, 3.0]}
)
START = 200 * MS


def fault(
    kind: str,
    target: int | str | None = None,
    value: float | None = None,
    at_s: float = 1.0,
    until_s: float | None = None,
    **more: float,
) -> Any:
    """A fault of that kind, whose class is the kind's; what is None is left out. more : ramp_s, period_s, duty."""
    given = {"kind": kind, "target": target, "value": value, "at_s": at_s, "until_s": until_s, **more}
    return KINDS[kind].model_validate({key: part for key, part in given.items() if part is not None})


def rig_with(
    *faults: Fault, settings: EmulatorSettings = QUIET, seed: int = 1, observer: Observer | None = None
) -> Rig:
    return Rig(settings, faults, seed, 0xDEADBEEF, observer)


def drive(
    rig: Rig, until_s: float, v: tuple[float, float] = (3.0, 3.0), period_ns: int = 100 * MS
) -> list[can.Message]:
    """Command the rig every period until this scenario time (scenario time 0 is 200 ms); return all frames."""
    frames = []
    end_ns = START + round(until_s * SECOND)
    if rig.now_ns < START:
        frames += rig.advance(START)
        rig.receive(command(*v), START)
    while rig.now_ns < end_ns:
        now_ns = min(rig.now_ns + period_ns, end_ns)
        frames += rig.advance(now_ns)
        rig.receive(command(*v, counter=(now_ns - START) // period_ns % 16), now_ns)
    return frames


def run_s(frame: can.Message) -> float:
    """Scenario time of a frame, to the microsecond."""
    return round(frame.timestamp - START / SECOND, 6)


def named(frames: list[can.Message], name: str, from_s: float = 0.0, to_s: float = 1e9) -> list[can.Message]:
    """Frames of a name within a span of scenario time."""
    return [f for f in frames if f.arbitration_id == FRAME_IDS[name] and from_s <= run_s(f) < to_s]


def level_volts(frames: list[can.Message], tank: int, from_s: float = 0.0, to_s: float = 1e9) -> list[float]:
    """Readings of a tank's channel."""
    name, at = ("LowerLevels" if tank < 3 else "UpperLevels"), 2 * ((tank - 1) % 2)
    return [int.from_bytes(f.data[at : at + 2], "little") / 5000 for f in named(frames, name, from_s, to_s)]


def channel_status(frames: list[can.Message], tank: int, from_s: float = 0.0, to_s: float = 1e9) -> list[int]:
    name, shift = ("LowerLevels" if tank < 3 else "UpperLevels"), 4 * ((tank - 1) % 2)
    return [f.data[4] >> shift & 0x0F for f in named(frames, name, from_s, to_s)]


def as_bytes(frames: list[can.Message]) -> list[tuple[float, int, bytes, bool, bool]]:
    return [(f.timestamp, f.arbitration_id, bytes(f.data), f.is_extended_id, f.is_remote_frame) for f in frames]


__all__ = ["MS", "SECOND"]
