"""A design on a rig in numbers: gains, poles, noise gain, and the poles after the loss of a pump."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hil.bench.designs import DESIGNS
from hil.bench.dry_step import FAILURES
from hil.bench.zero_figures import ZeroFigures, zero_figures
from hil.core.eigenstructure import ComplexArray, augment
from hil.core.gain_design import CalibratedDesign, GainDesign, RigDesign, closed_loop_poles, gain_matrix, noise_gain
from hil.core.nonminimum_phase import AnySplitDesign
from hil.core.tanks import Array, LinearModel, equilibrium, linearise, relative_gains, transmission_zeros
from hil.core.types import Pair, Quad
from hil.edge.config.rig_file import Rig
from hil.edge.config.settings_file import SettingsError

LOSSES: Mapping[str, Pair] = {
    "both healthy": (1.0, 1.0),
    "pump 1 -60 %": (0.4, 1.0),
    "pump 2 -60 %": (1.0, 0.4),
    "both -60 %": (0.4, 0.4),
}
"""Effectiveness of the pumps by name."""


@dataclass(frozen=True, eq=False)
class ProcessFigures:
    """The rig at its operating point.

    Attributes
    ----------
    operating_point_V : (2,) pump voltages. level_cm : (4,) the levels that they hold.
    linear : LinearModel there. zeros_1_s : (2,) its transmission zeros in 1/s.
    rga : (2, 2) relative gain array at rest; rows outputs, columns pumps.

    """

    operating_point_V: Pair
    level_cm: Quad
    linear: LinearModel
    zeros_1_s: Array
    rga: Array


@dataclass(frozen=True, eq=False)
class DesignFigures:
    """A design at the rig's operating point.

    Attributes
    ----------
    name : str
        As `[control] design` says it, or the class of an object of one's own.
    K : (2, 6) ndarray
        Gain of u = -K [h - h0; q]: four levels in V/cm, two integrals in 1/s; rows by pump.
    requested_poles : (6,) ndarray or None
        What the design asked for, 1/s; None when it does not say.
    achieved_poles : (6,) ndarray of complex
        Eigenvalues of A - B K on this rig, 1/s; in the order of the requested ones, else by descending real part.
    cond_v : float
        Condition number of the closed loop's eigenvectors (unit columns): how much the poles move when the model is a
        little wrong.
    noise_gain : float
        Command noise over level noise, V/V.
    slowest_poles : mapping of str to complex
        The slowest closed-loop pole, 1/s, for each entry of `LOSSES` with gains not reconfigured; unstable where its
        real part is not negative.
    zero : ZeroFigures or None
        The design beside the bounds of a zero in the right half plane; None without one, or if the loop is not stable.

    """

    name: str
    K: Array
    requested_poles: Array | ComplexArray | None
    achieved_poles: ComplexArray
    cond_v: float
    noise_gain: float
    slowest_poles: Mapping[str, complex]
    zero: ZeroFigures | None = None

    @property
    def is_stable(self) -> bool:
        """Whether the loop is stable on this rig while both pumps are healthy."""
        return bool(np.max(self.achieved_poles.real) < 0.0)


def process_figures(rig: Rig) -> ProcessFigures:
    """The rig at its operating point."""
    model = rig.tank_model
    levels = equilibrium(model, rig.operating_drives)
    linear = linearise(model, levels)
    return ProcessFigures(
        rig.control.operating_point_V, levels, linear, transmission_zeros(linear), relative_gains(linear)
    )


def design_figures(rig: Rig, design: str | GainDesign, where: str) -> DesignFigures:
    """A design on a rig. design : its name or an object. where : the rig file, for messages. Raises SettingsError."""
    name = design if isinstance(design, str) else type(design).__name__
    try:
        made = DESIGNS.find(design, where).make(rig) if isinstance(design, str) else design
        linear = process_figures(rig).linear
        K = gain_matrix(made.gains(linear))
        requested = _requested_poles(made, linear)
    except SettingsError:
        raise
    except FAILURES as error:
        raise SettingsError(f"{where}: control (design {name!r}): {error}") from None
    A, B = augment(linear)
    poles, vectors = np.linalg.eig(A - B @ K)
    figures = DesignFigures(
        name,
        K,
        requested,
        _in_order(poles.astype(complex), requested),
        float(np.linalg.cond(vectors)),
        noise_gain(K, rig.tank_model.level_gain_V_cm),
        {loss: complex(closed_loop_poles(linear, K, left)[0]) for loss, left in LOSSES.items()},
    )
    if not figures.is_stable:
        return figures
    return replace(figures, zero=zero_figures(rig, K, is_ahead=made.follows_reference))


def stable_ones(rig: Rig, where: str) -> str:
    """Which of the designs are stable on a rig, as a sentence. where : the rig file, for messages."""
    stable = []
    for name in DESIGNS.names:
        try:
            if design_figures(rig, name, where).is_stable:
                stable.append(name)
        except SettingsError:
            continue
    if not stable:
        return (
            f"none of the designs {', '.join(DESIGNS.names)} is stable on this rig; "
            "a design of your own can be (docs/how-to/own-design.md)"
        )
    return f"of the designs {', '.join(DESIGNS.names)}, stable on this rig: {', '.join(stable)}"


def _requested_poles(design: GainDesign, linear: LinearModel) -> Array | ComplexArray | None:
    """Poles requested by a design by eigenstructure assignment; None for any other design."""
    if isinstance(design, AnySplitDesign):
        design = design.at(linear)
    if isinstance(design, RigDesign):
        return design.structure(linear).requested_poles
    if isinstance(design, CalibratedDesign):
        return design.structure().requested_poles
    return None


def _in_order(poles: ComplexArray, requested: Array | ComplexArray | None) -> ComplexArray:
    """Each pole at the place of the requested one that it is nearest to."""
    if requested is None or len(requested) != len(poles):
        return poles[np.argsort(-poles.real)]
    remaining = list(poles)
    return np.array([remaining.pop(int(np.argmin(np.abs(np.array(remaining) - p)))) for p in requested])
