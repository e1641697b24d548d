"""A run of the paper's scenario, kept in memory, as realistic input for measurements."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can

from firmware_sim.ports import BusPort as EmulatorPort
from hil import lockstep
from hil.bench import assembly
from hil.bench.emulator_twin import emulator_of
from hil.core.controller import Output
from hil.core.types import Event, Inputs, Mode, Quad, TickRecord
from hil.edge.can.bus import BusPort
from hil.edge.can.pair_bus import pair
from tools.benchmark import SCENARIO


class Capture:
    """A lockstep run without files that keeps the controller's inputs and the frames on the bus. Also the recorder."""

    def __init__(self, period_s: float) -> None:
        self.period_ns = round(period_s * 1e9)
        self.inputs: list[Inputs] = []
        self.frames: list[can.Message] = []

    @classmethod
    def of_a_run(cls, duration_s: float | None = None, scenario: Path = SCENARIO) -> Capture:
        """A scenario, or the beginning of it."""
        bench = assembly.load(scenario)
        config = assembly.controller_config(bench, duration_s)
        emulator = emulator_of(bench, seed=1)
        capture = cls(config.loop.period_s)
        ours, theirs = pair()
        with ours, theirs:
            port = BusPort(ours)
            loop = assembly.make_loop(bench, config, port, capture, on_tick=capture.watch)
            lockstep.run(loop, port, EmulatorPort(emulator, theirs), config.loop.period_s)
        return capture

    def watch(self, inputs: Inputs, output: Output, mode: Mode) -> None:
        """Keep the inputs of a step."""
        del output, mode
        self.inputs.append(inputs)

    def tick(self, record: TickRecord, true_level_cm: Quad | None = None) -> None:
        """Steps are not kept."""

    def frame(self, timestamp_s: float, arbitration_id: int, data: bytes | bytearray, is_rx: bool = True) -> None:
        """Keep a received frame."""
        if is_rx:
            self.frames.append(
                can.Message(timestamp_s, arbitration_id, is_extended_id=False, data=bytearray(data), is_rx=True)
            )

    def message(self, timestamp_s: float, message: Any) -> None:
        """Ignore other frames."""

    def event(self, t_s: float, event: Event) -> None:
        """Events are not kept."""
