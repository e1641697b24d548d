"""The way from the pumps to the tanks: static curve of a pump, transport delay of its hose, play of its valve."""

from collections import deque

import numpy as np

from firmware_sim.equations import left_by_wear
from firmware_sim.faults.effects import NS_PER_S, Effects
from firmware_sim.parameter_spread import SPLIT_RANGE
from firmware_sim.setting_types import parts
from firmware_sim.settings import EmulatorSettings

SPLIT_STREAM = 5

Pair = tuple[float, float]
Inflow = tuple[float, float]
"""Flow voltage of one pump in the steady state, and its effectiveness."""


class PumpPaths:
    """What arrives at the valves of both pumps.

    flow_V, effectiveness : what has arrived, for `Tanks.advance`. splits : the present splits of the valves. A delay
    before the pumps' lag has the same result as one behind it, so that the lag stays with the tanks.
    """

    def __init__(self, settings: EmulatorSettings, seed: int) -> None:
        pumps = settings.pumps
        self._flow_voltages = pumps.flow_voltages
        self._is_straight = not any((*parts(pumps.dead_zone_V, 2), *parts(pumps.curve_1_V, 2)))
        self._is_direct = not any((*parts(pumps.delay_s, 2), *parts(pumps.split_scatter, 2)))
        self._hoses = tuple(_Hose(delay_s) for delay_s in parts(pumps.delay_s, 2))
        self._play = _Play(settings, seed)
        self._wear_per_h = parts(pumps.wear_per_h, 2)
        self.flow_V: Pair = (0.0, 0.0)
        self.effectiveness = [1.0, 1.0]
        self.splits = pumps.valve_split

    @property
    def next_ns(self) -> int | None:
        """When a change next arrives at a valve, or None."""
        if self._is_direct:
            return None
        return min((hose.next_ns for hose in self._hoses if hose.next_ns is not None), default=None)

    def effectiveness_after(self, run_h: float, effects: Effects) -> list[float]:
        """Share of the flow that each pump gives after run_h hours of wear, with these faults."""
        is_wet = not effects.is_dry
        wear = [left_by_wear(rate, run_h) for rate in self._wear_per_h]
        return [is_wet * part * left for part, left in zip(wear, effects.effectiveness, strict=True)]

    def give(self, voltage_V: Pair, effectiveness: list[float], now_ns: int) -> bool:
        """Let the pumps run at these voltages from now on; whether a split changes now."""
        flow_V = voltage_V if self._is_straight else self._flow_voltages(voltage_V)
        if self._is_direct:
            self.flow_V, self.effectiveness = flow_V, effectiveness
            return False
        for hose, inflow in zip(self._hoses, zip(flow_V, effectiveness, strict=True), strict=True):
            hose.give(inflow, now_ns)
        return self.advance(now_ns)

    def advance(self, now_ns: int) -> bool:
        """Bring what has arrived to now; whether a split changes now."""
        (v1, e1), (v2, e2) = inflows = [hose.taken(now_ns) for hose in self._hoses]
        self.flow_V, self.effectiveness = (v1, v2), [e1, e2]
        before, self.splits = self.splits, self._play.splits(inflows)
        return self.splits != before


class _Hose:
    """What a pump gives arrives delay_s later."""

    def __init__(self, delay_s: float) -> None:
        self._delay_ns = round(delay_s * NS_PER_S)
        self._on_the_way: deque[tuple[int, Inflow]] = deque()
        self._given: Inflow = (0.0, 1.0)
        self._arrived: Inflow = (0.0, 1.0)

    @property
    def next_ns(self) -> int | None:
        """When the next change arrives, or None."""
        return self._on_the_way[0][0] if self._on_the_way else None

    def give(self, inflow: Inflow, now_ns: int) -> None:
        """Let the pump give this from now on."""
        if inflow != self._given:
            self._given = inflow
            self._on_the_way.append((now_ns + self._delay_ns, inflow))

    def taken(self, now_ns: int) -> Inflow:
        """What arrives now."""
        while self._on_the_way and self._on_the_way[0][0] <= now_ns:
            _, self._arrived = self._on_the_way.popleft()
        return self._arrived


class _Play:
    """The splits of valves with play: each is drawn again when its flow starts, from a random stream of its own."""

    def __init__(self, settings: EmulatorSettings, seed: int) -> None:
        self._own = self._splits = settings.pumps.valve_split
        self._scatter = parts(settings.pumps.split_scatter, 2)
        self._random = [
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(SPLIT_STREAM, pump))) for pump in (0, 1)
        ]
        self._is_flowing = [False, False]

    def splits(self, inflows: list[Inflow]) -> Pair:
        """The splits for what arrives at the valves now; a drawn one lies within 0.001 .. 0.999."""
        splits = list(self._splits)
        for pump, (flow_V, effectiveness) in enumerate(inflows):
            is_flowing = flow_V * effectiveness > 0.0
            if is_flowing and not self._is_flowing[pump] and self._scatter[pump] > 0.0:
                drawn = self._own[pump] * (1.0 + self._scatter[pump] * float(self._random[pump].standard_normal()))
                splits[pump] = min(max(drawn, SPLIT_RANGE[0]), SPLIT_RANGE[1])
            self._is_flowing[pump] = is_flowing
        self._splits = (splits[0], splits[1])
        return self._splits
