"""Parametric eigenstructure assignment (PEA): poles and free parameters in, state feedback out.

For x' = A x + B u with u = -K x (mind the sign) every pole l_i leaves a freedom of n_u numbers, the parameter
w_i. With

    v_i = (A - l_i I)^-1 B w_i,   V = [v_1 .. v_n],   W = [w_1 .. w_n],   K = W V^-1

(A - B K) v_i = l_i v_i: the closed loop has exactly the eigenpairs (l_i, v_i). Hajiani and Poshtan (2012),
section 3; the parametrisation is Fahmy and O'Reilly's (IEEE Trans. Automatic Control 28(10), 1983).
A real pole takes a real w; a conjugate pair takes a conjugate pair of w.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from hil.core.errors import HilError
from hil.core.tanks import Array, LinearModel

ComplexArray = NDArray[np.complex128]
MIN_RCOND = 1e-13
"""Below this reciprocal condition number of V (unit columns) a gain is numerically meaningless."""


class DesignError(HilError, ValueError):
    """A design that is not possible; the message says why."""


@dataclass(frozen=True, eq=False)
class Eigenstructure:
    """A state feedback with requested and achieved poles.

    K : (n_u, n) gain, u = -K x. V : (n, n) eigenvectors with unit norm, column i for pole i.
    parameters : (n_u, n) the w_i, scaled to those eigenvectors: K V = W. A, B : the model it was made for.
    """

    A: Array
    B: Array
    requested_poles: Array | ComplexArray
    K: Array
    V: Array | ComplexArray
    parameters: Array | ComplexArray

    @cached_property
    def achieved_poles(self) -> ComplexArray:
        """(n,) eigenvalues of A - B K, each at the index of the nearest requested pole."""
        remaining = list(np.linalg.eigvals(self.A - self.B @ self.K).astype(complex))
        return np.array([remaining.pop(int(np.argmin(np.abs(np.array(remaining) - p)))) for p in self.requested_poles])

    @cached_property
    def pole_error(self) -> float:
        """Largest distance between an achieved pole and the requested one, 1/s."""
        return float(np.max(np.abs(self.achieved_poles - self.requested_poles)))

    @cached_property
    def cond_v(self) -> float:
        """Condition number of V, 2-norm: how sensitive the poles are to errors of the model."""
        return float(np.linalg.cond(self.V))


def assign(A: ArrayLike, B: ArrayLike, poles: ArrayLike, parameters: ArrayLike) -> Eigenstructure:
    """The feedback that gives A - B K these poles, with eigenvectors chosen by the parameters.

    A : (n, n). B : (n, n_u). poles : (n,), closed under conjugation, each at most n_u times.
    parameters : (n_u, n), column i belongs to pole i; only its direction matters; conjugate where the pole is.

    Raises DesignError when the request is malformed (shapes, conjugation, repetition), when a pole lies on an
    open-loop eigenvalue, when a mode is not controllable from u, or when the eigenvectors come out dependent.
    """
    A, B, poles, W = _validated(A, B, poles, parameters)
    n = A.shape[0]
    shifted: NDArray[Any] = np.empty((n, n, n), dtype=poles.dtype)
    shifted[:] = A
    with np.errstate(all="ignore"):  # a zero or non-finite column is caught below, with its reason
        shifted.reshape(n, n * n)[:, :: n + 1] -= poles[:, None]
        try:
            V = np.linalg.solve(shifted, (W.T @ B.T)[:, :, None])[:, :, 0].T
        except np.linalg.LinAlgError:
            raise DesignError(_not_finite(A, B, poles) or _on_an_eigenvalue(A, poles)) from None
        norms = np.sqrt(np.add.reduce((V * V.conj()).real if poles.dtype.kind == "c" else V * V))
        V, W = V / norms, W / norms
    basis, image = (V, W) if poles.dtype.kind == "f" else (_real_basis(V, poles), _real_basis(W, poles))
    # V^T K^T = W^T. One dgesv, not dgetrf and dgetrs: OpenBLAS hands dgetrs of any size to its threads, and on a busy
    # machine their wake-up takes milliseconds.
    lu, _, transposed, info = lapack.dgesv(basis.T, image.T)
    # sqrt(n) bounds the 1-norm of a matrix with unit columns, which is the infinity norm of what was factored;
    # a NaN fails the comparison too
    well_conditioned = info == 0 and lapack.dgecon(lu, n**0.5, norm="I")[0] > MIN_RCOND
    if not well_conditioned:
        raise DesignError(_why_singular(A, B, poles, W))
    return Eigenstructure(A, B, poles, transposed.T, V, W)


def augment(linear: LinearModel) -> tuple[Array, Array]:
    """The six-state model of eq. (6): levels, then the integrals q of e = r - y. Returns A (6, 6), B (6, 2)."""
    n_x, n_u = linear.B.shape
    n_y = linear.C.shape[0]
    A = np.zeros((n_x + n_y, n_x + n_y))
    A[:n_x, :n_x] = linear.A
    A[n_x:, :n_x] = -linear.C
    B = np.zeros((n_x + n_y, n_u))
    B[:n_x] = linear.B
    return A, B


def _validated(
    A: ArrayLike, B: ArrayLike, poles: ArrayLike, parameters: ArrayLike
) -> tuple[Array, Array, Array | ComplexArray, Array | ComplexArray]:
    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    poles, W = np.asarray(poles), np.asarray(parameters)
    if A.ndim != 2 or A.shape[0] != A.shape[1] or B.ndim != 2 or B.shape[0] != A.shape[0]:
        raise DesignError(f"A {A.shape} and B {B.shape}: want (n, n) and (n, n_u)")
    n, n_u = B.shape
    if poles.shape != (n,) or W.shape != (n_u, n):
        raise DesignError(f"poles {poles.shape} and parameters {W.shape}: want ({n},) and ({n_u}, {n})")
    if poles.dtype.kind == "c" or W.dtype.kind == "c":
        poles, W = _checked_conjugation(poles.astype(complex), W.astype(complex))
    else:
        poles, W = poles.astype(float, copy=False), W.astype(float, copy=False)
    if len(set(poles.tolist())) < n:
        _check_repetition(poles, n_u)
    return A, B, poles, W


def _checked_conjugation(poles: ComplexArray, W: ComplexArray) -> tuple[Array | ComplexArray, Array | ComplexArray]:
    """Conjugate pairs side by side, with conjugate parameters; all-real requests become real arrays."""
    i = 0
    while i < len(poles):
        if poles[i].imag == 0.0:
            if np.any(W[:, i].imag != 0.0):
                raise DesignError(f"pole {poles[i].real:g} is real, its parameter is not")
            i += 1
            continue
        if i + 1 == len(poles) or poles[i + 1] != poles[i].conjugate():
            raise DesignError(f"pole {poles[i]:g} has no conjugate beside it")
        if not np.array_equal(W[:, i + 1], W[:, i].conj()):
            raise DesignError(f"poles {poles[i]:g} and {poles[i + 1]:g} need conjugate parameters")
        i += 2
    if not np.any(poles.imag):
        return poles.real, W.real
    return poles, W


def _check_repetition(poles: Array | ComplexArray, n_u: int) -> None:
    values, counts = np.unique(poles, return_counts=True)
    worst = int(np.argmax(counts))
    if counts[worst] > n_u:
        raise DesignError(
            f"pole {values[worst]:g} asked for {counts[worst]} times: "
            f"with {n_u} inputs it has {n_u} eigenvectors at most"
        )


def _real_basis(columns: Array | ComplexArray, poles: Array | ComplexArray) -> Array:
    """Columns of a conjugate pair become their real and imaginary part: the same span, in real arithmetic."""
    real = columns.real.copy()
    second = np.flatnonzero(poles.imag)[1::2]
    real[:, second] = columns[:, second - 1].imag
    return real


def _on_an_eigenvalue(A: Array, poles: Array | ComplexArray) -> str:
    open_loop = np.linalg.eigvals(A)
    distance = np.abs(open_loop[:, None] - poles[None, :])
    pole = poles[int(np.argmin(distance.min(axis=0)))]
    return (
        f"pole {pole:g} is an eigenvalue of A: (A - l I) has no inverse, so w does not choose its eigenvector; move it"
    )


def _why_singular(A: Array, B: Array, poles: Array | ComplexArray, W: Array | ComplexArray) -> str:
    """Slow and only for the message: name the mode or the parameters that make V singular."""
    n = A.shape[0]
    broken = _not_finite(A, B, poles)
    if broken:
        return broken
    degenerate = np.flatnonzero(~np.all(np.isfinite(W), axis=0))
    if degenerate.size:
        return f"the parameter of pole {poles[degenerate[0]]:g} is zero, not finite, or moves nothing"
    for mode in np.linalg.eigvals(A):
        if np.linalg.matrix_rank(np.hstack([A - mode * np.eye(n), B])) < n:
            return f"mode {mode:g} of A can't be reached from the inputs: no feedback moves it"
    return "the eigenvectors that these poles and parameters give are linearly dependent; choose other parameters"


def _not_finite(A: Array, B: Array, poles: Array | ComplexArray) -> str:
    for name, values in (("A", A), ("B", B), ("poles", poles)):
        if not np.all(np.isfinite(values)):
            return f"{name} has a number that is not finite"
    return ""
