"""Eigenstructure assignment compared with other pole placement, and the cost of a new control law."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from statistics import median
from typing import Any

import control
import numpy as np
import scipy.signal
from numpy.typing import NDArray

from hil.bench import assembly
from hil.core.eigenstructure import assign, augment
from hil.core.gain_design import PAPER_ANGLES_RAD, PAPER_POLES
from hil.core.laws.state_feedback_law import StateFeedbackLaw
from hil.core.tanks import equilibrium, linearise, printed_linear_model
from tools.benchmark import SCENARIO
from tools.benchmark.tables import Section, as_time, as_verdict
from tools.benchmark.timing import TICK_US, Effort, in_turns

YT_TARGET = 100.0
VARGA_TARGET = 1.0


def eigenstructure_assignment(effort: Effort) -> list[Section]:
    """`assign` beside scipy's and slycot's pole placement, on the model and poles of the calibrated design."""
    A, B = augment(printed_linear_model())
    poles = np.array(PAPER_POLES)
    angles = np.array(PAPER_ANGLES_RAD)
    W = np.vstack([np.cos(angles), np.sin(angles)])
    ours, alike = "assign", "assign, given YT's eigenvectors"
    W_alike = _parameters(A, B, _place(A, B, poles, "YT"), poles)
    calls: dict[str, tuple[Callable[[], Any], int]] = {
        ours: (lambda: assign(A, B, poles, W).K, 100),
        alike: (lambda: assign(A, B, poles, W_alike).K, 100),
        "scipy place_poles, YT": (lambda: _place(A, B, poles, "YT"), 1),
        "scipy place_poles, KNV0": (lambda: _place(A, B, poles, "KNV0"), 3),
    }
    has_slycot = importlib.util.find_spec("slycot") is not None
    if has_slycot:
        calls["control place_varga (slycot)"] = (lambda: control.place_varga(A, B, poles), 100)
    times = in_turns(calls, effort.rounds)
    errors = {name: _pole_error(A, B, call(), poles) for name, (call, _) in calls.items()}
    targets = {"scipy place_poles, YT": YT_TARGET, "control place_varga (slycot)": VARGA_TARGET}
    rows = []
    for name, found in times.items():
        ratio = median(theirs / mine for theirs, mine in zip(found, times[ours], strict=True))
        target = targets.get(name)
        verdict = "" if target is None else as_verdict(ratio >= target)
        if name == alike:
            verdict = f"error {as_verdict(errors[alike] <= max(errors[peer] for peer in targets if peer in errors))}"
        wanted = "" if target is None else f"≥ {target:g}"
        timing = (as_time(median(found)), as_time(min(found)), f"{ratio:.1f}")
        rows.append((name, *timing, wanted, f"{errors[name]:.1e}", verdict))
    if not has_slycot:
        rows.append(("control place_varga", "–", "–", "–", "", "–", "not measured: pip install slycot (GPL)"))
    note = (
        "Six states, two inputs; the first row has the calibrated eigenvectors, which the other methods can't assign. "
        "Their condition number of 541 is in its error. Ratio: time over the first row's. Error: largest distance of "
        "an achieved pole from the requested one, 1/s; to be no larger than the peers' where the eigenvectors are YT's."
    )
    columns = ("method", "median", "best", "ratio", "target", "pole error", "verdict")
    return [Section("Eigenstructure assignment", note, columns, rows)]


def recomputation(effort: Effort) -> list[Section]:
    """The cost of a change of reference or diagnosis within a control step."""
    config = assembly.controller_config(assembly.load(SCENARIO)).loop
    if not isinstance(config.law, StateFeedbackLaw):
        raise TypeError(f"{SCENARIO} has another control law")
    rule, reference = config.law.reconfiguration, config.references[0][1]
    model, design, law = rule.model, rule.design, rule.law
    at = linearise(model, equilibrium(model, rule.operating_point_V))
    calls: dict[str, tuple[Callable[[], Any], int]] = {
        "RigDesign.gains": (lambda: design.gains(at), 50),
        "Reconfiguration.law": (lambda: law(reference, (0.4, 0.4)), 50),
        "Reconfiguration.law, reference out of reach": (lambda: law(reference, (0.2, 0.4)), 20),
    }
    times = in_turns(calls, effort.rounds)
    rows = [
        (name, as_time(median(found)), as_time(min(found)), f"{100.0 * median(found) / TICK_US:.2f} %")
        for name, found in times.items()
    ]
    note = "`law` includes gains, operating voltages and the target that the pumps can reach. Tick: 100 ms."
    return [Section("Recomputing the control law", note, ("what", "median", "best", "share of a tick"), rows)]


def _place(A: NDArray[Any], B: NDArray[Any], poles: NDArray[Any], method: str) -> Any:
    return scipy.signal.place_poles(A, B, poles, method=method).gain_matrix


def _parameters(A: NDArray[Any], B: NDArray[Any], K: Any, poles: NDArray[Any]) -> NDArray[Any]:
    """The parameters w_i = K v_i with which `assign` gives the eigenvectors of A - B K."""
    values, vectors = np.linalg.eig(A - B @ np.asarray(K))
    order = [int(np.argmin(np.abs(values - pole))) for pole in poles]
    parameters: NDArray[Any] = (np.asarray(K) @ vectors[:, order]).real
    return parameters


def _pole_error(A: NDArray[Any], B: NDArray[Any], K: Any, poles: NDArray[Any]) -> float:
    """Largest distance of an eigenvalue of A - B K from its requested pole."""
    achieved = np.sort_complex(np.linalg.eigvals(A - B @ np.asarray(K)))
    return float(np.max(np.abs(achieved - np.sort_complex(poles))))
