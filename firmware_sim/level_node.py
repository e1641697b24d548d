"""Level node: reads four level sensors and sends them as voltages.

A sensor gives gain * level plus white noise. The node's converter covers 0 .. 10.24 V and clips a signal outside;
a signal that noise on an empty or brim-full tank can't explain, more than 0.1 V outside, marks its channel. The
node boots for boot_s, sending heartbeats only, and then runs.
"""

from collections.abc import Callable

import numpy as np

from firmware_sim.faults import NS_PER_S
from firmware_sim.pump_node import BOOT_COUNT, Change, Observer
from firmware_sim.settings import EmulatorSettings
from firmware_sim.wire import (
    COUNTER_MODULUS,
    LEVEL_HEARTBEAT_ID,
    LOWER_LEVELS_ID,
    RAW_PER_V,
    UPPER_LEVELS_ID,
    ChannelStatus,
    NodeState,
    pack_heartbeat,
    pack_levels,
)

ADC_RANGE_V = 10.24
RANGE_MARGIN_V = 0.1
NOISE_BLOCK = 1024

Quad = tuple[float, float, float, float]
Converter = Callable[[float], tuple[float, ChannelStatus]]


def converter(bits: int) -> Converter:
    """Build a converter over 0 .. 10.24 V with codes 0 .. 2**bits - 1, for one channel.

    It turns a signal in V into a reading in V and a status. 0 bits: no converter; the wire's own steps of 0.2 mV
    remain, and what rounding to them leaves over is carried to the next reading, so that nothing is lost on average.
    """
    top = (1 << bits) - 1
    step_V = ADC_RANGE_V / (top + 1) if bits else 1.0 / RAW_PER_V
    highest_V = top * step_V if bits else ADC_RANGE_V
    ok, under, over = ChannelStatus.OK, ChannelStatus.UNDER_RANGE, ChannelStatus.OVER_RANGE
    carried_V = 0.0

    def convert(signal_V: float) -> tuple[float, ChannelStatus]:
        nonlocal carried_V
        if signal_V < 0.0:
            return 0.0, ok if signal_V >= -RANGE_MARGIN_V else under
        if signal_V > highest_V:
            return highest_V, ok if signal_V <= ADC_RANGE_V + RANGE_MARGIN_V else over
        reading_V = round((signal_V + carried_V) / step_V) * step_V
        if bits == 0:
            carried_V += signal_V - reading_V
        return reading_V, ok

    return convert


class LevelNode:
    """The level node with its own seeded noise; powered up at time 0 of the clock that is handed in."""

    def __init__(self, settings: EmulatorSettings, seed: int, fingerprint: int, observer: Observer) -> None:
        self._gain_V_cm = settings.sensors.gain_V_cm
        self._noise_V = settings.sensors.noise_V
        self._converters = tuple(converter(settings.sensors.adc_bits) for _ in range(4))
        self._boot_end_ns = round(settings.nodes.boot_s * NS_PER_S)
        self._fingerprint = fingerprint
        self._observer = observer
        self._random = np.random.default_rng(seed)
        self._noise: list[list[float]] = []
        self._levels_counter = 0
        self._heartbeat_counter = 0
        self.state = NodeState.BOOT
        self._report(0, "boot")

    @property
    def next_event_ns(self) -> int | None:
        """End of boot, or None."""
        return self._boot_end_ns if self.state is NodeState.BOOT else None

    def run_event(self, now_ns: int) -> None:
        """Start to run when boot is over."""
        if self.state is NodeState.BOOT and now_ns >= self._boot_end_ns:
            self.state = NodeState.RUN
            self._report(now_ns, "booted")

    def power_off(self, now_ns: int) -> None:
        """Stop for good and report it in any case."""
        self.state = NodeState.READY
        self._report(now_ns, "shutdown")

    def levels(self, levels_cm: Quad) -> tuple[bytes, bytes]:
        """Payloads of the next LowerLevels and UpperLevels frames."""
        gain = self._gain_V_cm
        to1, to2, to3, to4 = self._converters
        h1, h2, h3, h4 = levels_cm
        n1, n2, n3, n4 = self._next_noise()
        (v1, s1), (v2, s2) = to1(gain * h1 + n1), to2(gain * h2 + n2)
        (v3, s3), (v4, s4) = to3(gain * h3 + n3), to4(gain * h4 + n4)
        counter = self._levels_counter
        self._levels_counter = (counter + 1) % COUNTER_MODULUS
        return (
            pack_levels(LOWER_LEVELS_ID, (v1, v2), (s1, s2), counter),
            pack_levels(UPPER_LEVELS_ID, (v3, v4), (s3, s4), counter),
        )

    def heartbeat(self) -> bytes:
        """Payload of the next LevelHeartbeat frame."""
        counter = self._heartbeat_counter
        self._heartbeat_counter = (counter + 1) % COUNTER_MODULUS
        return pack_heartbeat(LEVEL_HEARTBEAT_ID, self.state, counter, BOOT_COUNT, self._fingerprint)

    def _next_noise(self) -> list[float]:
        if not self._noise:
            block = self._random.normal(0.0, self._noise_V, (NOISE_BLOCK, 4))
            self._noise = block[::-1].tolist()
        return self._noise.pop()

    def _report(self, now_ns: int, cause: str) -> None:
        self._observer(Change(now_ns, "level", self.state, (), cause))
