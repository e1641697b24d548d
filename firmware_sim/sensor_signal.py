"""What a level sensor adds to gain times level: offset, white noise and waves."""

import math

import numpy as np
import numpy.typing as npt

from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings

NOISE_BLOCK = 1024
WAVE_STREAM = 4
WAVE_CORRELATION_S = 3.0

Block = npt.NDArray[np.float64]


class AddedSignal:
    """Voltages on top of gain times level, one for each sensor in every level period, drawn in blocks by the seed.

    The waves are a first-order process with the standard deviation wave_V and the correlation exp(-t / 3 s). They have
    their own random stream, so that they do not change the white noise.
    """

    def __init__(self, settings: EmulatorSettings, seed: int) -> None:
        sensors = settings.sensors
        self._noise_V = sensors.noise_V
        self._offset_V = parts(sensors.offset_V, 4)
        self._wave_V = np.array(parts(sensors.wave_V, 4))
        self._kept = math.exp(-settings.nodes.levels_period_s / WAVE_CORRELATION_S)
        self._random = np.random.default_rng(seed)
        self._wave_random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(WAVE_STREAM,)))
        self._wave = self._wave_random.standard_normal(4)
        self._block: list[list[float]] = []

    def next_V(self) -> list[float]:  # noqa: N802 - a unit
        """The next four."""
        if not self._block:
            block = self._random.normal(0.0, self._noise_V, (NOISE_BLOCK, 4))
            if any(self._offset_V):
                block += self._offset_V
            if self._wave_V.any():
                block += self._wave_V * self._waves()
            self._block = block[::-1].tolist()
        return self._block.pop()

    def _waves(self) -> Block:
        """A block of waves with standard deviation 1, (NOISE_BLOCK, 4), which continues the last one."""
        drive = math.sqrt(1.0 - self._kept**2) * self._wave_random.standard_normal((NOISE_BLOCK, 4))
        for row in drive:
            row += self._kept * self._wave
            self._wave = row
        return drive
