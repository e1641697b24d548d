"""The quadratic programs of the predictive laws, solved by DAQP.

DAQP: D. Arnström, A. Bemporad, D. Axehill, A Dual Active-Set Solver for Embedded Quadratic Programming Using Recursive
LDL^T Updates, IEEE Trans. Automatic Control 67(8), 2022. MIT licence; an extra of the package, `fourtank-hil[mpc]`.
"""

from __future__ import annotations

import numpy as np

from hil.core.tanks import Array

SOLVED, SOLVED_SOFTLY = 1, 2
"""Exit flags of DAQP with a solution."""


class MissingSolverError(ImportError):
    """The solver is not installed; the message says how to install it."""


def require_solver() -> None:
    """Raises MissingSolverError where DAQP can't be imported."""
    try:
        import daqp  # noqa: F401
    except ImportError:
        raise MissingSolverError(
            "this control law needs the solver DAQP, which is not installed: pip install 'fourtank-hil[mpc]'"
        ) from None


def solve_qp(H: Array, f: Array, low: Array, high: Array, rows: Array | None = None) -> Array | None:
    """The x (n,) with the smallest x'Hx/2 + f'x; None if there is none.

    H : (n, n) positive definite. f : (n,). low, high : (n + m,) bounds of x, then of rows @ x. rows : (m, n).
    """
    import daqp

    rows = np.zeros((0, len(f))) if rows is None else rows
    kinds = np.zeros(len(low), dtype=np.int32)
    ordered = [np.ascontiguousarray(part, dtype=float) for part in (H, f, rows, high, low)]
    x, _, flag, _ = daqp.solve(*ordered, kinds)
    return np.array(x) if flag in (SOLVED, SOLVED_SOFTLY) else None
