"""Level node: reads four level sensors and sends them as voltages.

A sensor gives gain * level plus white noise. The node's converter covers 0 .. 10.24 V; a signal below or above that
is clipped and its channel says so. The node boots for boot_s, sending heartbeats only, and then runs.
"""

import numpy as np

from firmware_sim.faults import NS_PER_S
from firmware_sim.pump_node import BOOT_COUNT, Change, Observer
from firmware_sim.settings import EmulatorSettings
from firmware_sim.wire import (
    COUNTER_MODULUS,
    LEVEL_HEARTBEAT_ID,
    LOWER_LEVELS_ID,
    UPPER_LEVELS_ID,
    ChannelStatus,
    NodeState,
    pack_heartbeat,
    pack_levels,
)

ADC_RANGE_V = 10.24
NOISE_BLOCK = 1024

Quad = tuple[float, float, float, float]


def converted(signal_V: float, bits: int) -> tuple[float, ChannelStatus]:
    """What a converter over 0 .. 10.24 V (codes 0 .. 2**bits - 1; 0 bits: no steps) makes of a signal."""
    if signal_V < 0.0:
        return 0.0, ChannelStatus.UNDER_RANGE
    status = ChannelStatus.OK
    if signal_V > ADC_RANGE_V:
        signal_V, status = ADC_RANGE_V, ChannelStatus.OVER_RANGE
    if bits == 0:
        return signal_V, status
    codes = 1 << bits
    return min(round(signal_V / ADC_RANGE_V * codes), codes - 1) * (ADC_RANGE_V / codes), status


class LevelNode:
    """The level node with its own seeded noise; powered up at time 0 of the clock that is handed in."""

    def __init__(self, settings: EmulatorSettings, seed: int, fingerprint: int, observer: Observer) -> None:
        self._gain_V_cm = settings.sensors.gain_V_cm
        self._noise_V = settings.sensors.noise_V
        self._bits = settings.sensors.adc_bits
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
        """Stop; always reported."""
        self.state = NodeState.READY
        self._report(now_ns, "shutdown")

    def levels(self, levels_cm: Quad) -> tuple[bytes, bytes]:
        """Payloads of the next LowerLevels and UpperLevels frames."""
        gain, bits = self._gain_V_cm, self._bits
        h1, h2, h3, h4 = levels_cm
        n1, n2, n3, n4 = self._next_noise()
        (v1, s1), (v2, s2) = converted(gain * h1 + n1, bits), converted(gain * h2 + n2, bits)
        (v3, s3), (v4, s4) = converted(gain * h3 + n3, bits), converted(gain * h4 + n4, bits)
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
