"""`hil design`: both designs side by side, in numbers and, if wanted, in two figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.bench.designs import rig_design
from hil.core.design import CalibratedDesign, RigDesign, closed_loop_poles, noise_gain
from hil.core.eigenstructure import DesignError, Eigenstructure, augment
from hil.core.tanks import Array, LinearModel, equilibrium, linearise, transmission_zeros
from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.settings_file import SettingsError, default_config_dir

LOSSES = {"both sound": (1.0, 1.0), "pump 1 -60 %": (0.4, 1.0), "pump 2 -60 %": (1.0, 0.4), "both -60 %": (0.4, 0.4)}


@dataclass(frozen=True)
class Candidate:
    """A design by name, with its assignment at the operating point."""

    name: str
    structure: Eigenstructure


def run(console: Console, config_dir: Path | None, out: Path | None) -> None:
    """Print both designs; write `step.svg` and `sigma.svg` into `out` if given. Raises SettingsError."""
    rig_path = (config_dir or default_config_dir()) / "rig.toml"
    rig = load_rig(rig_path)
    model = rig.tank_model
    linear = linearise(model, equilibrium(model, rig.control.operating_point_V))
    try:
        candidates = _candidates(rig, linear)
    except DesignError as error:
        raise SettingsError(f"{rig_path}: control: {error}") from None
    _show_process(console, rig, linear)
    for candidate in candidates:
        _show_gains(console, candidate)
    _show_robustness(console, rig, linear, candidates)
    if out is not None:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SettingsError(f"--out {out}: {error.strerror}") from None
        for path in _figures(out, linear, candidates):
            console.print(str(path), highlight=False, soft_wrap=True)


def relative_gain_array(linear: LinearModel) -> Array:
    """(2, 2) RGA at rest, G(0) times the transpose of its inverse, element by element; rows outputs, columns pumps."""
    G = -linear.C @ np.linalg.solve(linear.A, linear.B)
    rga: Array = G * np.linalg.inv(G).T
    return rga


def _candidates(rig: Rig, linear: LinearModel) -> tuple[Candidate, ...]:
    own = rig_design(rig)
    assert isinstance(own, RigDesign)  # noqa: S101 - what rig_design returns
    return (
        Candidate("rig", own.structure(linear)),
        Candidate("calibrated", CalibratedDesign().structure()),
    )


def _show_process(console: Console, rig: Rig, linear: LinearModel) -> None:
    levels = equilibrium(rig.tank_model, rig.control.operating_point_V)
    v1, v2 = rig.control.operating_point_V
    zeros, rga = transmission_zeros(linear), relative_gain_array(linear)
    console.print(f"Operating point {v1:.2f}, {v2:.2f} V: levels " + ", ".join(f"{h:.3f}" for h in levels) + " cm")
    console.print("Transmission zeros " + ", ".join(f"{z:.5f}" for z in zeros) + " 1/s")
    console.print(f"Relative gain array [[{rga[0, 0]:.3f}, {rga[0, 1]:.3f}], [{rga[1, 0]:.3f}, {rga[1, 1]:.3f}]]")


def _show_gains(console: Console, candidate: Candidate) -> None:
    structure = candidate.structure
    table = Table(title=f"Design '{candidate.name}': u = -K [h - h0; q]", title_justify="left")
    for name in ("", "h1 [V/cm]", "h2", "h3", "h4", "q1 [1/s]", "q2"):
        table.add_column(name, justify="right")
    for pump, row in enumerate(structure.K, start=1):
        table.add_row(f"pump {pump}", *(f"{value:.4f}" for value in row))
    console.print(table)
    console.print("poles asked    " + "  ".join(f"{p:9.5f}" for p in structure.requested_poles), highlight=False)
    console.print("poles achieved " + "  ".join(f"{p.real:9.5f}" for p in structure.achieved_poles), highlight=False)


def _show_robustness(console: Console, rig: Rig, linear: LinearModel, candidates: tuple[Candidate, ...]) -> None:
    table = Table(title="What each design makes of noise and of lost pumps, gains kept", title_justify="left")
    table.add_column("")
    for candidate in candidates:
        table.add_column(candidate.name, justify="right")
    table.add_row("cond(V)", *(f"{c.structure.cond_v:.1f}" for c in candidates))
    gains = [noise_gain(c.structure.K, rig.sensors.gain_V_cm) for c in candidates]
    table.add_row("noise gain, command over level [V/V]", *(f"{gain:.1f}" for gain in gains))
    for name, effectiveness in LOSSES.items():
        slowest = [float(closed_loop_poles(linear, c.structure.K, effectiveness)[0].real) for c in candidates]
        words = [f"{pole:+.4f} 1/s {'stable' if pole < 0.0 else 'UNSTABLE'}" for pole in slowest]
        table.add_row(f"slowest pole, {name}", *words)
    console.print(table)


def _figures(out: Path, linear: LinearModel, candidates: tuple[Candidate, ...]) -> list[Path]:
    """Step responses r to y, and singular values of r to y and of r to u, through python-control."""
    import control
    import matplotlib as mpl
    from matplotlib.figure import Figure

    mpl.rcParams["svg.hashsalt"] = "fourtank-hil"
    steps, sigma = Figure(figsize=(8, 6), layout="constrained"), Figure(figsize=(8, 4), layout="constrained")
    step_axes, (to_y, to_u) = steps.subplots(2, 2, sharex=True), sigma.subplots(1, 2, sharex=True)
    times, frequencies = np.linspace(0.0, 120.0, 601), np.logspace(-3, 1, 300)
    for candidate in candidates:
        A, B = augment(linear)
        K, C = candidate.structure.K, np.hstack([linear.C, np.zeros((2, 2))])
        reference = np.vstack([np.zeros((4, 2)), np.eye(2)])
        loop = control.ss(A - B @ K, reference, np.vstack([C, -K]), np.zeros((4, 2)))
        response = control.step_response(loop, times)
        for i in (0, 1):
            for j in (0, 1):
                step_axes[i][j].plot(times, response.outputs[i, j], label=candidate.name)
                step_axes[i][j].set_title(f"r{j + 1} to y{i + 1}")
        gains = loop(1j * frequencies)
        for axes, part, name in ((to_y, gains[:2], "r to y"), (to_u, gains[2:], "r to u")):
            values = np.linalg.svd(np.moveaxis(part, 2, 0), compute_uv=False)
            (line,) = axes.loglog(frequencies, values[:, 0], label=candidate.name)
            axes.loglog(frequencies, values[:, 1], color=line.get_color(), linestyle="--")
            axes.set_title(f"singular values, {name}")
            axes.set_xlabel("frequency [rad/s]")
    for axes in step_axes[1]:
        axes.set_xlabel("time [s]")
    for axes in (*step_axes.flat, to_y, to_u):
        axes.grid(visible=True, alpha=0.3)
    step_axes[0][0].legend()
    to_y.legend()
    paths = [out / "step.svg", out / "sigma.svg"]
    for figure, path in zip((steps, sigma), paths, strict=True):
        figure.savefig(path, metadata={"Date": None})
    return paths
