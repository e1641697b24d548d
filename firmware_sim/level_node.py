"""Level node: reads four level sensors and sends them as voltages.

A sensor gives offset + gain * (1 + scale error) * level plus white noise and, where asked for, waves: noise that stays
similar for some seconds, as the sloshing of the water does, and leaves the mean level as it is. The node's converter
covers 0 .. 10.24 V and clips a signal outside; more than 0.1 V outside, which noise on an empty or full tank can't
explain, the channel reports UnderRange or OverRange. The node boots for boot_s, sending heartbeats only, and then runs.
"""

from collections.abc import Callable

from firmware_sim.faults.effects import NS_PER_S, ChannelEffects, Codes, Reading
from firmware_sim.frames import (
    COUNTER_MODULUS,
    LEVEL_HEARTBEAT_ID,
    LOWER_LEVELS_ID,
    RAW_PER_V,
    UPPER_LEVELS_ID,
    ChannelStatus,
    NodeState,
    pack_heartbeat,
    pack_levels,
    unpack_levels,
)
from firmware_sim.pump_node import BOOT_COUNT, BOOT_COUNT_MODULUS, Change, Observer
from firmware_sim.sensor_signal import AddedSignal
from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings

ADC_RANGE_V = 10.24
RANGE_MARGIN_V = 0.1

Quad = tuple[float, float, float, float]
Converter = Callable[[float], Reading]


def codes_of(bits: int) -> Codes:
    """Codes of a converter over 0 .. 10.24 V; 0 bits: the wire's own steps of 0.2 mV."""
    if bits == 0:
        return Codes(round(ADC_RANGE_V * RAW_PER_V), 1.0 / RAW_PER_V)
    return Codes((1 << bits) - 1, ADC_RANGE_V / (1 << bits))


def converter(bits: int) -> Converter:
    """Build a converter over 0 .. 10.24 V with codes 0 .. 2**bits - 1, for one channel.

    It turns a signal in V into a reading in V and a status. 0 bits: no converter; the wire's own steps of 0.2 mV
    remain, and the rounding error is carried to the next reading, so that the mean is exact.
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
    """The level node with its own seeded noise; powered up at time 0 of the clock given by the caller."""

    def __init__(self, settings: EmulatorSettings, seed: int, fingerprint: int, observer: Observer) -> None:
        scale_errors = parts(settings.sensors.scale_error, 4)
        gains_V_cm = parts(settings.sensors.gain_V_cm, 4)
        self._gains_V_cm = tuple(gain * (1.0 + error) for gain, error in zip(gains_V_cm, scale_errors, strict=True))
        self._added = AddedSignal(settings, seed)
        self._codes = codes_of(settings.sensors.adc_bits)
        self._converters = tuple(converter(settings.sensors.adc_bits) for _ in range(4))
        self._boot_ns = self._boot_end_ns = round(settings.nodes.boot_s * NS_PER_S)
        self._boot_count = BOOT_COUNT
        self._fingerprint = fingerprint
        self._observer = observer
        self._sent: tuple[bytes, bytes] | None = None
        self.channel_faults: dict[int, ChannelEffects] = {}
        self.wall_ahead_ns = 0
        self._levels_counter = 0
        self._heartbeat_counter = 0
        self.state = NodeState.BOOT
        self._report(0, "boot")

    @property
    def next_event_ns(self) -> int | None:
        """End of boot, or None."""
        return self._boot_end_ns if self.state is NodeState.BOOT else None

    def run_event(self, now_ns: int) -> None:
        """Enter run when boot is over."""
        if self.state is NodeState.BOOT and now_ns >= self._boot_end_ns:
            self.state = NodeState.RUN
            self._report(now_ns, "booted")

    def power_off(self, now_ns: int) -> None:
        """Stop, and report it in any case."""
        self.state = NodeState.READY
        self._report(now_ns, "shutdown")

    def reboot(self, now_ns: int, power_ns: int) -> None:
        """Reset the node's state and boot as soon as power is back at power_ns."""
        self._sent = None
        self._levels_counter = self._heartbeat_counter = 0
        self._boot_count = (self._boot_count + 1) % BOOT_COUNT_MODULUS
        self._boot_end_ns = power_ns + self._boot_ns
        self.state = NodeState.BOOT
        self._report(now_ns, "reboot")

    def levels(self, levels_cm: Quad, now_ns: int = 0) -> tuple[bytes, bytes]:
        """Payloads of the next LowerLevels and UpperLevels frames; now_ns matters only for a drifting sensor."""
        g1, g2, g3, g4 = self._gains_V_cm
        to1, to2, to3, to4 = self._converters
        h1, h2, h3, h4 = levels_cm
        n1, n2, n3, n4 = self._added.next_V()
        if self.channel_faults:
            signals_V = (g1 * h1 + n1, g2 * h2 + n2, g3 * h3 + n3, g4 * h4 + n4)
            (v1, s1), (v2, s2), (v3, s3), (v4, s4) = self._faulty_readings(signals_V, now_ns)
        else:
            (v1, s1), (v2, s2) = to1(g1 * h1 + n1), to2(g2 * h2 + n2)
            (v3, s3), (v4, s4) = to3(g3 * h3 + n3), to4(g4 * h4 + n4)
        counter = self._levels_counter
        self._levels_counter = (counter + 1) % COUNTER_MODULUS
        self._sent = payloads = (
            pack_levels(LOWER_LEVELS_ID, (v1, v2), (s1, s2), counter),
            pack_levels(UPPER_LEVELS_ID, (v3, v4), (s3, s4), counter),
        )
        return payloads

    def heartbeat(self) -> bytes:
        """Payload of the next LevelHeartbeat frame."""
        counter = self._heartbeat_counter
        self._heartbeat_counter = (counter + 1) % COUNTER_MODULUS
        return pack_heartbeat(LEVEL_HEARTBEAT_ID, self.state, counter, self._boot_count, self._fingerprint)

    def _faulty_readings(self, signals_V: Quad, now_ns: int) -> list[Reading]:
        """Readings of the four channels: faults add to the signal before the converter and replace its reading."""
        last = None if self._sent is None else [reading for sent in self._sent for reading in unpack_levels(sent)]
        readings = []
        for channel, (signal_V, convert) in enumerate(zip(signals_V, self._converters, strict=True)):
            faults = self.channel_faults.get(channel)
            if faults is None:
                readings.append(convert(signal_V))
            else:
                fresh = convert(signal_V + faults.signal(now_ns))
                readings.append(faults.replaced(fresh, None if last is None else last[channel], self._codes))
        return readings

    def _report(self, now_ns: int, cause: str) -> None:
        self._observer(Change(now_ns, "level", self.state, (), cause, self.wall_ahead_ns))
