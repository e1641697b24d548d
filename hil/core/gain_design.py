"""The two designs of the bench, both by eigenstructure assignment on the six-state model of eq. (6).

`CalibratedDesign` reproduces the paper: its poles, the free parameters that make its table 3 come out, one fixed
operating point. Its gains on the four levels reach 19 V/cm and nearly cancel, and it becomes unstable when one pump
loses 60 % of its gain: it is for comparison, not for a rig.

`RigDesign` uses the free parameters of PEA to decouple the outputs. Each output gets two poles whose eigenvectors move
only that output (G(l) w = e_j, with G(s) = C (sI - A)^-1 B, fixes w); the two remaining poles are placed on the
transmission zeros, where neither output sees them (G(z) w = 0). The outputs are then decoupled, and
since C B is diagonal for the four tanks, a pump that loses gain slows only its own output instead of
destabilising both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Protocol

import numpy as np

from hil.core.eigenstructure import ComplexArray, DesignError, Eigenstructure, assign, augment
from hil.core.tanks import Array, LinearModel, printed_linear_model, transmission_zeros
from hil.core.types import Pair

PAPER_POLES = (-0.252, -0.184, -0.017, -0.057, -0.073, -0.021333918170845047)
"""The five printed poles and the sixth that the calibration found, 1/s."""

PAPER_ANGLES_RAD = (
    0.7827896734336633,
    0.7869097178449019,
    5.475128781964839,
    0.525534177130497,
    0.6564598272196864,
    2.9693515147784066,
)
"""Free parameters w_i = (cos a_i, sin a_i) that reproduce table 3."""


@dataclass(frozen=True, slots=True)
class Gains:
    """u = -K_x x - K_q q, rows by pump, nominal pumps.

    levels_V_cm : rows (4,) each. integrals_1_s : rows (2,) each, V per V s.
    integral_inverse : K_q^-1 by rows.
    """

    levels_V_cm: tuple[tuple[float, ...], tuple[float, ...]]
    integrals_1_s: tuple[Pair, Pair]
    integral_inverse: tuple[Pair, Pair]

    @classmethod
    def from_matrix(cls, K: Array) -> Gains:
        """Split K (2, 6) of the augmented model. Raises DesignError when the integral part has no inverse."""
        (q11, q12), (q21, q22) = K[:, 4:].tolist()
        determinant = q11 * q22 - q12 * q21
        if determinant == 0.0:
            raise DesignError("the integral gain has no inverse: some offset would never be corrected")
        inverse = ((q22 / determinant, -q12 / determinant), (-q21 / determinant, q11 / determinant))
        first, second = K[:, :4].tolist()
        return cls((tuple(first), tuple(second)), ((q11, q12), (q21, q22)), inverse)


class GainDesign(Protocol):
    """A design computes gains for a linear model of the rig with healthy pumps.

    The controller uses them as u = -K_x (h - h0) - K_q q, where h are the four levels in cm, h0 those of the operating
    point, and q (V s) the integrals of reference minus output: q' = r - y. A pump with effectiveness theta gets
    (v0 + u)/theta, so a design never sees a fault. docs/how-to/own-design.md has an example.
    """

    @property
    def follows_reference(self) -> bool:
        """Whether the operating point, and with it the linear model, moves with the reference."""
        ...

    def gains(self, linear: LinearModel) -> Gains:
        """Gains for nominal pumps; effectiveness is rescaled afterwards, v = (v0 + u)/theta."""
        ...


@dataclass(frozen=True, slots=True)
class CalibratedDesign:
    """The paper's gain, for the model as printed in eq. (4), whatever the operating point."""

    follows_reference: bool = False

    def gains(self, linear: LinearModel) -> Gains:
        """The same gains for every model: the paper designs at 3.00 V."""
        return Gains.from_matrix(self.structure().K)

    def structure(self) -> Eigenstructure:
        """The assignment with the achieved poles."""
        A, B = augment(printed_linear_model())
        angles = np.array(PAPER_ANGLES_RAD)
        return assign(A, B, PAPER_POLES, np.vstack([np.cos(angles), np.sin(angles)]))


@dataclass(frozen=True, slots=True)
class RigDesign:
    """Decoupled outputs: two real poles each (1/s), the remaining two poles on the transmission zeros."""

    output_poles: tuple[Pair, Pair]
    follows_reference: bool = True

    def gains(self, linear: LinearModel) -> Gains:
        """Gains at this operating point; raises DesignError where the zeros are not stable."""
        return Gains.from_matrix(self.structure(linear).K)

    def structure(self, linear: LinearModel) -> Eigenstructure:
        """The assignment with the achieved poles."""
        zeros = transmission_zeros(linear)
        if zeros.max() >= 0.0:
            raise DesignError(
                f"transmission zero at {zeros.max():+.4g} 1/s: with gamma1 + gamma2 < 1 "
                "the outputs can't be decoupled stably"
            )
        poles = np.array([*self.output_poles[0], *self.output_poles[1], *zeros])
        A, B = augment(linear)
        return assign(A, B, poles, decoupling_parameters(linear, poles))


def decoupling_parameters(linear: LinearModel, poles: Array) -> Array:
    """W (2, 6) for poles in the order output 1, 1, output 2, 2, zero, zero: see the head of this module.

    G(l)^-1 e_j up to scale is column j of the adjugate of G(l), which also gives the null direction at a zero.
    """
    shifted = poles[:, None, None] * np.eye(4) - linear.A
    try:
        G = linear.C @ np.linalg.solve(shifted, np.broadcast_to(linear.B, (len(poles), 4, 2)))
    except np.linalg.LinAlgError:
        raise DesignError(f"one of the poles {poles.tolist()} is an eigenvalue of A; move it") from None
    adjugate = np.empty_like(G)
    adjugate[:, 0, 0], adjugate[:, 1, 1] = G[:, 1, 1], G[:, 0, 0]
    adjugate[:, 0, 1], adjugate[:, 1, 0] = -G[:, 0, 1], -G[:, 1, 0]
    W = adjugate[np.arange(6), :, [0, 0, 1, 1, 0, 0]].T
    scaled: Array = W / np.sqrt((W * W).sum(axis=0))
    return scaled


def noise_gain(K: Array, level_gain_V_cm: float) -> float:
    """Command noise over level noise, V/V: the larger row norm of K_x/k_c, for independent white noise on four levels.

    K : (2, n) with the four level gains first. Only the direct path from a reading to a command counts; the path
    through the process is much slower.
    """
    return float(np.max(np.linalg.norm(K[:, :4], axis=1))) / level_gain_V_cm


def choose_rig_design(linear: LinearModel, poles: Sequence[float], noise_gain_max: float) -> RigDesign:
    """Assign four real poles to the two outputs: the pairing with the smallest cond(V) that meets the noise bound.

    If no pairing meets the bound, all four poles are slowed by the same factor until one does.
    Raises DesignError for poles that are not four stable real numbers or a bound that slowing can't meet.
    """
    if len(poles) != 4 or not all(np.isfinite(p) and p < 0.0 for p in poles):
        raise DesignError(f"output poles {list(poles)}: want four stable real poles")
    level_gain = float(linear.C[0, 0])
    for slowing in 0.95 ** np.arange(60):
        structures = _assignable(linear, [float(p * slowing) for p in poles])
        candidates = [
            (structure.cond_v, design)
            for design, structure in structures
            if noise_gain(structure.K, level_gain) <= noise_gain_max
        ]
        if candidates:
            return min(candidates, key=lambda candidate: candidate[0])[1]
    raise DesignError(f"noise gain {noise_gain_max:g} V/V can't be met by slowing the poles {list(poles)}")


def _assignable(linear: LinearModel, poles: list[float]) -> list[tuple[RigDesign, Eigenstructure]]:
    """The possible pairings (equal poles need different outputs). Raises the last DesignError if there is none."""
    found = []
    refusal: DesignError | None = None
    for design in _pairings(poles):
        try:
            found.append((design, design.structure(linear)))
        except DesignError as error:
            refusal = error
    if refusal is not None and not found:
        raise refusal
    return found


def _pairings(poles: list[float]) -> list[RigDesign]:
    """The six ways to assign two of four poles to output 1."""
    pairings = []
    for chosen in combinations(range(4), 2):
        rest = [poles[i] for i in range(4) if i not in chosen]
        pairings.append(RigDesign(((poles[chosen[0]], poles[chosen[1]]), (rest[0], rest[1]))))
    return pairings


def closed_loop_poles(linear: LinearModel, K: Array, effectiveness: Pair = (1.0, 1.0)) -> ComplexArray:
    """(6,) poles when the pumps have lost gain and K has not been changed, by descending real part."""
    A, B = augment(linear)
    poles = np.linalg.eigvals(A - B @ np.diag(effectiveness) @ K).astype(complex)
    return poles[np.argsort(-poles.real)]


def gain_matrix(gains: Gains) -> Array:
    """K (2, 6) of u = -K [x; q], V/cm and 1/s."""
    return np.hstack([np.array(gains.levels_V_cm), np.array(gains.integrals_1_s)])
