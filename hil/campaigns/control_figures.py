"""How well a law controlled in each window of a run: settling, overshoot, noise of the voltages, energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.campaigns.observer import Observations
from hil.edge.record.run_folder import Window

Floats = npt.NDArray[np.float64]

SETTLED_V = 0.02
"""An output has settled from when on it stays within this distance of its reference."""

NOISE_S = 40.0
"""The noise of the voltages is that of the last NOISE_S of a window."""

TIME_TOLERANCE_S = 1e-6


@dataclass(frozen=True, slots=True)
class WindowFigures:
    """Figures of a window, for outputs 1, 2 or pumps 1, 2; the outputs are the emulator's true levels.

    step_V : change of the reference from just before the window to its end. settling_s : from the window's beginning
    until the output stays within `SETTLED_V` of its reference up to the window's end; None if it is outside there.
    overshoot_V : farthest beyond the last reference, in the direction of the step; None without a step.
    peak_V : largest distance from the reference. noise_V : standard deviation of the applied voltage about a straight
    line, over the last `NOISE_S`. energy_V2s : integral of the squares of both applied voltages, which is the energy
    that a resistive load of 1 ohm at each output would take, in J.
    """

    step_V: tuple[float, float]
    settling_s: tuple[float | None, float | None]
    overshoot_V: tuple[float | None, float | None]
    peak_V: tuple[float, float]
    noise_V: tuple[float, float]
    energy_V2s: float


def of_windows(
    seen: Observations, windows: Sequence[Window], level_gain_V_cm: float, period_s: float
) -> dict[str, dict[str, Any] | None]:
    """Figures of each window by its name, as JSON has them; None where the run ended before the window did."""
    found = {window.name: of_window(seen, window, level_gain_V_cm, period_s) for window in windows}
    return {name: None if figures is None else asdict(figures) for name, figures in found.items()}


def of_window(seen: Observations, window: Window, level_gain_V_cm: float, period_s: float) -> WindowFigures | None:
    """Figures of one window; None if the run ended before the window did."""
    t_s = seen.column("t_s")
    first = int(np.searchsorted(t_s, window.from_s - TIME_TOLERANCE_S))
    end = int(np.searchsorted(t_s, window.to_s - TIME_TOLERANCE_S))
    if end - first < 2 or t_s[-1] < window.to_s - period_s - TIME_TOLERANCE_S:
        return None
    part, before = slice(first, end), max(first - 1, 0)
    outputs = [_output(seen, output, part, before, level_gain_V_cm, period_s) for output in (1, 2)]
    voltages = [seen.column(f"v{pump}_V")[part] for pump in (1, 2)]
    last = t_s[part] >= t_s[end - 1] - NOISE_S
    return WindowFigures(
        step_V=(outputs[0][0], outputs[1][0]),
        settling_s=(outputs[0][1], outputs[1][1]),
        overshoot_V=(outputs[0][2], outputs[1][2]),
        peak_V=(outputs[0][3], outputs[1][3]),
        noise_V=(_noise(t_s[part][last], voltages[0][last]), _noise(t_s[part][last], voltages[1][last])),
        energy_V2s=float(sum((voltage**2).sum() for voltage in voltages)) * period_s,
    )


def _output(
    seen: Observations, output: int, part: slice, before: int, level_gain_V_cm: float, period_s: float
) -> tuple[float, float | None, float | None, float]:
    """Step, settling time, overshoot and peak of one output."""
    reference_V = seen.column(f"r{output}_V")
    y_V = seen.column(f"h{output}_cm")[part] * level_gain_V_cm
    last_V = float(reference_V[part][-1])
    step_V = last_V - float(reference_V[before])
    distance_V = np.abs(y_V - reference_V[part])
    outside = np.flatnonzero(distance_V > SETTLED_V)
    settling_s: float | None = 0.0
    if len(outside):
        is_settled = outside[-1] + 1 < len(y_V)
        settling_s = float(outside[-1] + 1) * period_s if is_settled else None
    beyond_V = (y_V - last_V) * np.sign(step_V)
    overshoot_V = max(float(beyond_V.max()), 0.0) if step_V else None
    return step_V, settling_s, overshoot_V, float(distance_V.max())


def _noise(t_s: Floats, voltage_V: Floats) -> float:
    """Standard deviation about a straight line."""
    since = t_s - t_s.mean()
    spread = float(since @ since)
    slope = float(since @ voltage_V) / spread if spread > 0.0 else 0.0
    return float(np.std(voltage_V - slope * since))
