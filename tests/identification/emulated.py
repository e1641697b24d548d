"""Records of the emulated rig, through its frames: times and values as they are on the wire."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim.frames import LOWER_LEVELS_ID, STATUS_ID, UPPER_LEVELS_ID, Frame
from firmware_sim.rig import Rig
from firmware_sim.settings import EmulatorSettings, load, load_fingerprint
from hil.core.identification.parameters import RigModel, with_values
from hil.core.identification.records import LevelRecord
from hil.core.types import Command
from hil.wire.command_sender import CommandSender
from hil.wire.contract import Contract

CONFIG = Path(__file__).parents[2] / "config"
TICK_NS, FRAME_NS = 100_000_000, 20_000_000
BOOTED_NS = 300_000_000
WIRE_V = 0.0002

Array = NDArray[np.float64]


def settings_with(changes: dict[str, dict[str, Any]], spread: float = 0.0) -> EmulatorSettings:
    """The shipped emulator.toml with other values: {"pumps": {"lag_s": 0.3}}."""
    settings, _ = load(CONFIG / "emulator.toml", None)
    for table, values in changes.items():
        settings = settings.model_copy(update={table: getattr(settings, table).model_copy(update=values)})
    return settings.model_copy(update={"parameter_spread": spread})


def emulated(
    settings: EmulatorSettings, seed: int, voltage_V: Array, name: str = "emulated"
) -> tuple[LevelRecord, Rig]:
    """A record with a row for each level frame, of these voltages (n, 2) at ticks of 0.1 s.

    Row k has what was read at its time, and the voltages that the pump node reports from then on.
    """
    contract = Contract.from_dbc((CONFIG / "bench.dbc").read_text())
    rig, sender = Rig(settings, (), seed, load_fingerprint(CONFIG / "bench.dbc")), CommandSender(contract)
    levels: dict[int, list[float]] = {}
    applied: dict[int, tuple[float, float]] = {}
    for tick in range(len(voltage_V) + 1):
        now_ns = BOOTED_NS + tick * TICK_NS
        for frame in rig.advance(now_ns):
            at = round((frame.timestamp * 1e9 - BOOTED_NS) / FRAME_NS)
            first, second = (raw * WIRE_V for raw in struct.unpack_from("<HH", frame.data))
            if frame.arbitration_id == LOWER_LEVELS_ID:
                levels.setdefault(at, [0.0] * 4)[:2] = first, second
            elif frame.arbitration_id == UPPER_LEVELS_ID:
                levels.setdefault(at, [0.0] * 4)[2:] = first, second
            elif frame.arbitration_id == STATUS_ID and frame.timestamp * 1e9 < now_ns:
                applied[tick - 1] = first, second
        if tick < len(voltage_V):
            v1, v2 = voltage_V[tick].tolist()
            data = sender.encode(Command((v1, v2), enable=True), now_ns)
            rig.receive(Frame(now_ns * 1e-9, sender.frame_id, is_extended_id=False, data=data, is_rx=True), now_ns)
    n = len(voltage_V) * (TICK_NS // FRAME_NS)
    record = LevelRecord(
        name=name,
        time_s=np.arange(n, dtype=float) * (FRAME_NS * 1e-9),
        voltage_V=np.repeat([applied[tick] for tick in range(len(voltage_V))], TICK_NS // FRAME_NS, axis=0),
        reading_V=np.array([levels[row] for row in range(n)]),
        saturation_V=(0.0, 10.24),
    )
    return record, rig


def truth_of(settings: EmulatorSettings) -> RigModel:
    """The model of a rig with the emulator's own basic parameters."""
    pumps, tanks = settings.pumps, settings.tanks
    lag = pumps.lag_s
    lag1, lag2 = lag if isinstance(lag, tuple) else (lag, lag)
    values = {f"a{i + 1}": value for i, value in enumerate(tanks.outlet_cm2)}
    values |= {f"k{i + 1}": value for i, value in enumerate(pumps.gain_cm3_Vs)}
    values |= {f"gamma{i + 1}": value for i, value in enumerate(pumps.valve_split)}
    return with_values(RigModel(), values | {"lag1": lag1, "lag2": lag2})
