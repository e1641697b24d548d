"""How well a law controlled in each window of a run: settling, overshoot, noise of the voltages, energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.campaigns.observer import Observations
from hil.edge.record.manifest import Window
from hil.review.step_response import TIME_TOLERANCE_S, step_responses

Floats = npt.NDArray[np.float64]

NOISE_S = 40.0
"""The noise of the voltages is that of the last NOISE_S of a window."""


@dataclass(frozen=True, slots=True)
class WindowFigures:
    """Figures of a window, for outputs 1, 2 or pumps 1, 2; the outputs are the emulator's true levels.

    step_V, settling_s, overshoot_V, peak_V : see `hil.review.step_response`. noise_V : standard deviation of the
    applied voltage about a straight line, over the last `NOISE_S`. energy_V2s : integral of the squares of both applied
    voltages, which is the energy that a resistive load of 1 ohm at each output would take, in J.
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
    reference_V = np.column_stack([seen.column("r1_V"), seen.column("r2_V")])
    output_V = np.column_stack([seen.column("h1_cm"), seen.column("h2_cm")]) * level_gain_V_cm
    outputs = step_responses(t_s, reference_V, output_V, window, period_s)
    if outputs is None:
        return None
    part = (t_s >= window.from_s - TIME_TOLERANCE_S) & (t_s < window.to_s - TIME_TOLERANCE_S)
    voltages = [seen.column(f"v{pump}_V")[part] for pump in (1, 2)]
    last = t_s[part] >= t_s[part][-1] - NOISE_S
    one, two = outputs
    return WindowFigures(
        step_V=(one.step_V, two.step_V),
        settling_s=(one.settling_s, two.settling_s),
        overshoot_V=(one.overshoot_V, two.overshoot_V),
        peak_V=(one.peak_V, two.peak_V),
        noise_V=(_noise(t_s[part][last], voltages[0][last]), _noise(t_s[part][last], voltages[1][last])),
        energy_V2s=float(sum((voltage**2).sum() for voltage in voltages)) * period_s,
    )


def _noise(t_s: Floats, voltage_V: Floats) -> float:
    """Standard deviation about a straight line."""
    since = t_s - t_s.mean()
    spread = float(since @ since)
    slope = float(since @ voltage_V) / spread if spread > 0.0 else 0.0
    return float(np.std(voltage_V - slope * since))
