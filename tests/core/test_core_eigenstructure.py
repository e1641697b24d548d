"""Eigenstructure assignment: what was asked is what comes out, or it is refused with the reason."""

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import place_poles

from hil.core.eigenstructure import DesignError, Eigenstructure, assign, augment
from hil.core.tanks import Array, printed_linear_model
from tests.core.core_bench import CALIBRATED, at, rig_design

TABLE_3_GAIN = [
    [18.94148, -17.97382, -0.89696, -1.54202, -0.52198, 0.2806],
    [17.05882, -15.4221, -1.23325, -1.1528, -0.40824, 0.11661],
]
SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(autouse=True)
def _no_warnings() -> Iterator[None]:
    """Whatever is refused is refused in words, not by numpy."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def poles_of(rng: np.random.Generator, n: int, kind: str) -> npt.NDArray[Any]:
    """Separate stable poles: all real, with conjugate pairs, or with one real pole twice."""
    if kind == "pairs":
        pairs = [complex(-a, b) for a, b in zip(1.0 + np.arange(n // 2), rng.uniform(0.3, 3.0, n // 2), strict=True)]
        flat = [p for pair in pairs for p in (pair, pair.conjugate())]
        return np.array(flat + [-0.5 - n] * (n % 2))
    poles = -0.4 - np.arange(n) - rng.uniform(0.0, 0.3, n)
    if kind == "twice":
        poles[1] = poles[0]
    return poles


def request(seed: int, n: int, n_u: int, kind: str) -> tuple[Array, Array, npt.NDArray[Any], npt.NDArray[Any]]:
    """A random system, poles and parameters (conjugate where the poles are)."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= 0.2 * np.eye(n)
    B = rng.normal(size=(n, n_u))
    poles = poles_of(rng, n, kind)
    W = rng.normal(size=(n_u, n)).astype(poles.dtype)
    if kind == "pairs":
        W = W + 1j * rng.normal(size=(n_u, n))
        for i in range(0, n - 1, 2):
            W[:, i + 1] = W[:, i].conj()
        if n % 2:
            W[:, -1] = W[:, -1].real
    return A, B, poles, W


@settings(max_examples=80, deadline=None)
@given(SEEDS, st.integers(2, 6), st.integers(2, 3), st.sampled_from(["real", "pairs", "twice"]))
def test_every_pole_and_eigenvector_asked_for_is_achieved(seed: int, n: int, n_u: int, kind: str) -> None:
    A, B, poles, W = request(seed, n, n_u, kind)
    achieved = assign(A, B, poles, W)
    assert achieved.K.dtype == float
    assert achieved.K.shape == (n_u, n)
    accuracy = 1e-13 * achieved.cond_v * max(float(np.linalg.norm(B @ achieved.K)), 10.0)
    assert achieved.requested_poles == pytest.approx(poles)
    closed = A - B @ achieved.K
    assert closed @ achieved.V == pytest.approx(achieved.V * poles, abs=accuracy)
    assert pytest.approx(achieved.parameters, abs=accuracy) == achieved.K @ achieved.V
    assert np.linalg.norm(achieved.V, axis=0) == pytest.approx(np.ones(n))
    if achieved.cond_v < 1e3 and kind != "twice":
        assert achieved.pole_error < 1e-9


@pytest.mark.parametrize("kind", ["real", "pairs"])
@pytest.mark.parametrize("seed", range(10))
def test_poles_come_out_to_1e_9(seed: int, kind: str) -> None:
    A, B, poles, W = request(seed, 6, 2, kind)
    achieved = assign(A, B, poles, W)
    assert achieved.pole_error < 1e-9
    assert achieved.achieved_poles == pytest.approx(poles, abs=1e-9)
    assert np.linalg.eigvals(A - B @ achieved.K) == pytest.approx(achieved.achieved_poles[order_of(A, B, achieved)])


def order_of(A: Array, B: Array, achieved: Eigenstructure) -> list[int]:
    """Places of the achieved poles in numpy's order of eigenvalues."""
    return [int(np.argmin(np.abs(achieved.achieved_poles - p))) for p in np.linalg.eigvals(A - B @ achieved.K)]


@pytest.mark.parametrize("seed", range(10))
def test_a_pole_asked_for_twice_gets_two_eigenvectors(seed: int) -> None:
    A, B, poles, W = request(seed, 6, 2, "twice")
    achieved = assign(A, B, poles, W)
    assert poles[0] == poles[1]
    assert np.linalg.matrix_rank(A - B @ achieved.K - poles[0] * np.eye(6), tol=1e-8) == 4
    assert achieved.pole_error < 1e-7


def test_one_input_leaves_no_freedom() -> None:
    A, B = np.array([[0.0, 1.0], [2.0, -1.0]]), np.array([[0.0], [1.0]])
    achieved = assign(A, B, [-3, -4], [[1, 1]])
    assert pytest.approx(np.array([[14.0, 6.0]])) == achieved.K  # s^2 + 7 s + 12 by Ackermann's formula


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.lists(st.floats(-6.0, 6.0), min_size=4, max_size=4), st.booleans())
def test_only_the_direction_of_a_parameter_matters(seed: int, exponents: list[float], flip: bool) -> None:
    A, B, poles, W = request(seed, 4, 2, "real")
    scale = 10.0 ** np.array(exponents) * (-1.0 if flip else 1.0)
    plain, scaled = assign(A, B, poles, W), assign(A, B, poles, W * scale)
    assert pytest.approx(plain.K, rel=1e-6, abs=1e-9 * plain.cond_v) == scaled.K
    assert scaled.cond_v == pytest.approx(plain.cond_v, rel=1e-6)


def test_complex_dtype_with_real_numbers_is_a_real_request() -> None:
    A, B, poles, W = request(1, 4, 2, "real")
    plain, cast = assign(A, B, poles, W), assign(A, B, poles.astype(complex), W.astype(complex))
    assert np.array_equal(plain.K, cast.K)
    assert cast.V.dtype == float


def test_paper_gain_of_table_3() -> None:
    structure = CALIBRATED.structure()
    assert pytest.approx(np.array(TABLE_3_GAIN), abs=1e-5) == structure.K
    assert structure.cond_v == pytest.approx(541, abs=0.5)
    assert structure.pole_error < 1e-9
    printed = [-0.252, -0.184, -0.017, -0.057, -0.073]
    assert list(structure.requested_poles[:5]) == printed


def test_augmented_model_integrates_the_output_error() -> None:
    linear = printed_linear_model()
    A, B = augment(linear)
    assert np.array_equal(A[:4, :4], linear.A)
    assert np.array_equal(A[4:, :4], -linear.C)
    assert not A[:, 4:].any()
    assert np.array_equal(B[:4], linear.B)
    assert not B[4:].any()


def test_as_close_to_the_request_as_scipys_place_poles() -> None:
    linear = at()
    A, B = augment(linear)
    structure = rig_design().structure(linear)
    poles = np.sort(structure.requested_poles.real)
    theirs = place_poles(A, B, poles, method="YT")
    error = np.max(np.abs(np.sort(theirs.computed_poles.real) - poles))
    assert structure.pole_error < max(2.0 * error, 1e-12)


CHAIN_A, CHAIN_B = np.array([[0.0, 1.0], [0.0, -1.0]]), np.array([[0.0], [1.0]])
ONES = np.ones((1, 2))
TWIN_A, TWIN_B = np.diag([-1.0, -2.0, -3.0]), np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])


@pytest.mark.parametrize(
    ("A", "B", "poles", "parameters", "reason"),
    [
        (np.ones((2, 3)), CHAIN_B, [-1.5, -2], ONES, "A (2, 3) and B (2, 1): want (n, n) and (n, n_u)"),
        (CHAIN_A, np.ones((3, 1)), [-1.5, -2], ONES, "A (2, 2) and B (3, 1)"),
        (CHAIN_A, np.ones(2), [-1.5, -2], ONES, "B (2,)"),
        (np.ones(2), CHAIN_B, [-1.5, -2], ONES, "A (2,)"),
        (CHAIN_A, CHAIN_B, [-1.5], ONES, "poles (1,) and parameters (1, 2): want (2,) and (1, 2)"),
        (CHAIN_A, CHAIN_B, [[-1.5, -2]], ONES, "poles (1, 2)"),
        (CHAIN_A, CHAIN_B, [-1.5, -2], np.ones((2, 2)), "parameters (2, 2)"),
        (CHAIN_A, CHAIN_B, [-1.5, -2], np.ones(2), "parameters (2,)"),
        (CHAIN_A, CHAIN_B, [-1.0, -2], ONES, "pole -1 is an eigenvalue of A"),
        (CHAIN_A, CHAIN_B, [0, -2], ONES, "pole 0 is an eigenvalue of A"),
        (CHAIN_A, CHAIN_B, [-3, -2], [[0, 1]], "the parameter of pole -3 is zero"),
        (TWIN_A, np.ones((3, 2)), [-4, -5, -6], [[1, 1, 1], [0, -1, 2]], "the parameter of pole -5 is zero"),
        (np.diag([-1.0, -2.0]), CHAIN_B, [-3, -4], ONES, "mode -1 of A can't be reached"),
        (np.diag([-1.0, -1.0, -2.0]), np.ones((3, 2)), [-3, -4, -5], np.eye(2, 3) + 1, "mode -1 of A"),
        (CHAIN_A, CHAIN_B, [-2, -2], ONES, "pole -2 asked for 2 times: with 1 inputs it has 1 eigenvectors"),
        (TWIN_A, TWIN_B, [-4, -4, -4], np.ones((2, 3)), "pole -4 asked for 3 times: with 2 inputs"),
        (TWIN_A, TWIN_B, [-4, -4, -5], np.ones((2, 3)), "linearly dependent"),
        (CHAIN_A, CHAIN_B, [-2 + 1j, -3], ONES, "pole -2+1j has no conjugate beside it"),
        (CHAIN_A, CHAIN_B, [-3, -2 + 1j], ONES, "pole -2+1j has no conjugate beside it"),
        (CHAIN_A, CHAIN_B, [-2 + 1j, -2 + 1j], ONES, "pole -2+1j has no conjugate"),
        (TWIN_A, TWIN_B, [-2 + 1j, -5, -2 - 1j], np.ones((2, 3)), "pole -2+1j has no conjugate beside it"),
        (CHAIN_A, CHAIN_B, [-2 + 1j, -2 - 1j], [[1 + 1j, 1 + 1j]], "need conjugate parameters"),
        (CHAIN_A, CHAIN_B, [-2 + 1j, -2 - 1j], [[1, 2]], "need conjugate parameters"),
        (CHAIN_A, CHAIN_B, [-2, -3], [[1, 1j]], "pole -3 is real, its parameter is not"),
    ],
)
def test_refusal_says_why(
    A: npt.NDArray[np.float64],
    B: npt.NDArray[np.float64],
    poles: list[list[float] | complex | float],
    parameters: npt.NDArray[np.float64] | list[list[int | complex]],
    reason: str,
) -> None:
    with pytest.raises(DesignError) as refusal:
        assign(A, B, poles, parameters)
    assert reason in str(refusal.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("poles", [[-1.5, -2.0], [-1.0, -2.0], [-1.5 + 1j, -1.5 - 1j]], ids=["real", "eigen", "pair"])
def test_numbers_that_are_not_finite_are_refused(bad: float, poles: list[float | complex]) -> None:
    """An infinity used to come with numpy's warning, and a NaN beside a pole on an eigenvalue as a LinAlgError."""
    for i in range(2):
        for j in range(2):
            A = CHAIN_A.copy()
            A[i, j] = bad
            with pytest.raises(DesignError, match="A has a number that is not finite"):
                assign(A, CHAIN_B, poles, ONES)
        B, W = CHAIN_B.copy(), ONES.copy()
        B[i, 0] = bad
        W[0, i] = bad
        with pytest.raises(DesignError, match=r"B has a number that is not finite|is an eigenvalue of A"):
            assign(CHAIN_A, B, poles, ONES)
        with pytest.raises(DesignError, match=r"parameter|is an eigenvalue of A"):
            assign(CHAIN_A, CHAIN_B, poles, W)
    for broken in ([-1.5, bad], [bad, bad], [complex(bad, 1), complex(bad, -1)], [complex(-1, bad), complex(-1, -bad)]):
        with pytest.raises(DesignError):
            assign(CHAIN_A, CHAIN_B, broken, ONES)


def test_absurdly_large_parameters_are_refused_or_right() -> None:
    try:
        achieved = assign(CHAIN_A, CHAIN_B, [-2, -3], ONES * 1e200)
    except DesignError:
        return
    assert achieved.pole_error < 1e-9
