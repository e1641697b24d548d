"""`hil design`: all designs side by side, in numbers and, if wanted, in two figures. Readable at 60 columns."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.bench.design_figures import (
    LOSSES,
    DesignFigures,
    ProcessFigures,
    design_figures,
    process_figures,
    stable_ones,
)
from hil.bench.designs import DESIGNS
from hil.bench.zero_figures import TOLERANCE_V, ZeroFigures
from hil.core.eigenstructure import ComplexArray, augment
from hil.core.tanks import LinearModel
from hil.core.zero_bounds import zero_bound
from hil.edge.config.rig_file import load_rig
from hil.edge.config.settings_file import SettingsError
from hil.edge.config.shipped import rig_file_in_use
from hil.edge.record.file_writing import write_atomically


def run(console: Console, config_dir: Path | None, out: Path | None, rig_name: str | Path | None = None) -> None:
    """Print all designs of the table; write `step.svg` and `sigma.svg` into `out` if given. Raises SettingsError.

    A design that this rig can't have, or that does not load, is named with the reason; the others are shown.
    rig_name : path or shipped name of a rig; None: the configuration's.
    """
    rig_path = rig_file_in_use(rig_name, config_dir)
    rig = load_rig(rig_path)
    process = process_figures(rig)
    _show_process(console, process)
    designs: list[DesignFigures] = []
    for name in DESIGNS.names:
        console.print()
        try:
            console.print(f"[bold]{name}[/]: {DESIGNS.find(name, str(rig_path)).summary}", highlight=False)
            designs.append(design_figures(rig, name, str(rig_path)))
        except SettingsError as error:
            console.print(f"not available: {error}", highlight=False, markup=False)
            continue
        _show_gains(console, designs[-1])
        if designs[-1].zero is not None:
            _show_bound(console, designs[-1].zero)
    if not designs:
        raise SettingsError(f"{rig_path}: none of the designs {', '.join(DESIGNS.names)} can be had on this rig")
    _show_robustness(console, designs)
    if len(designs) < len(DESIGNS.names):
        sentence = stable_ones(rig, str(rig_path))
        console.print(f"{sentence[0].upper()}{sentence[1:]}.", highlight=False, markup=False)
    if out is not None:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SettingsError(f"--out {out}: {error.strerror}") from None
        for path in _figures(out, process.linear, designs):
            console.print(str(path), highlight=False, soft_wrap=True)


def _show_process(console: Console, process: ProcessFigures) -> None:
    v1, v2 = process.operating_point_V
    rows = {
        "operating point [V]": f"{v1:.2f}, {v2:.2f}",
        "levels [cm]": ", ".join(f"{h:.3f}" for h in process.level_cm),
        "zeros [1/s]": ", ".join(f"{z:.5f}" for z in process.zeros_1_s),
        "relative gains": "; ".join(", ".join(f"{gain:.3f}" for gain in row) for row in process.rga),
    }
    for name, text in rows.items():
        console.print(f"{name:20} {text}", highlight=False, markup=False)
    for line in _pairing_lines(process):
        console.print(line, highlight=False, markup=False)


def _pairing_lines(process: ProcessFigures) -> list[str]:
    """Which pump the relative gains ask for at each output, and what an unstable zero acts on."""
    first, second = (1, 2) if process.rga[0, 0] > 0.5 else (2, 1)
    lines = [f"{'pairing':20} pump {first} with y1, pump {second} with y2"]
    bound = zero_bound(process.linear)
    if bound is not None:
        e1, e2 = bound.direction
        lines += [
            f"The zero at {bound.zero_1_s:+.5f} 1/s is unstable. For every controller",
            f"{e1:.3f} y1 {e2:+.3f} y2 goes the wrong way first.",
        ]
    return lines


def _show_gains(console: Console, design: DesignFigures) -> None:
    """Gains and poles as plain lines of at most 60 columns."""
    lines = [
        "u = -K [h - h0; q], K in V/cm and 1/s:",
        "       " + " ".join(f"{name:>8}" for name in ("h1", "h2", "h3", "h4", "q1", "q2")),
    ]
    for pump, row in enumerate(design.K, start=1):
        lines.append(f"pump {pump} " + " ".join(f"{value:8.4f}" for value in row))
    if design.requested_poles is not None:
        lines += _pole_lines("asked", design.requested_poles.astype(complex))
    lines += _pole_lines("achieved", design.achieved_poles)
    for line in lines:
        console.print(line, highlight=False, markup=False)


def _pole_lines(name: str, poles: ComplexArray) -> list[str]:
    """A head, then three poles to a line."""
    words = [f"{pole.real:.5f}" + (f"{pole.imag:+.5f}j" if pole.imag else "") for pole in poles]
    rows = (words[at : at + 3] for at in range(0, len(words), 3))
    return [f"poles {name} [1/s]:", *(" ".join(f"{word:>18}" for word in row) for row in rows)]


def _show_bound(console: Console, zero: ZeroFigures) -> None:
    """Steps of the references and the sensitivity, beside what the zero permits."""
    step_V = next(iter(zero.steps.values())).step_V[0]
    table = Table(title=f"Steps of {step_V:g} V, and the least that the zero permits", title_justify="left")
    for column in ("", f"within {1e3 * TOLERANCE_V:.0f} mV [s]", "at least", "error² [V² s]", "at least"):
        table.add_column(column, justify="right" if column else "left")
    for name, step in zero.steps.items():
        settled = f"{step.settled_s:.0f}" if np.isfinite(step.settled_s) else "not yet"
        errors = (f"{step.squared_error:.2f}", f"{step.least_squared_error:.2f}")
        table.add_row(name, settled, f"{step.least_settled_s:.0f}", *errors)
    console.print(table)
    console.print(f"sensitivity peak {zero.peak:.2f}, at least {zero.least_peak:.2f}", highlight=False)


def _show_robustness(console: Console, designs: Sequence[DesignFigures]) -> None:
    console.print()
    table = Table(title="Noise, and lost pumps with gains kept", title_justify="left")
    table.add_column("")
    for design in designs:
        table.add_column(design.name, justify="right")
    table.add_row("cond(V)", *(f"{design.cond_v:.1f}" for design in designs))
    table.add_row("command noise [V/V]", *(f"{design.noise_gain:.1f}" for design in designs))
    for loss in LOSSES:
        slowest = [design.slowest_poles[loss].real for design in designs]
        words = [f"{pole:+.4f}" + ("" if pole < 0.0 else " unstable") for pole in slowest]
        table.add_row(loss, *words)
    console.print(table)
    console.print('From "both healthy" on: slowest closed-loop pole, 1/s.', highlight=False)


def _figures(out: Path, linear: LinearModel, designs: Sequence[DesignFigures]) -> list[Path]:
    """Step responses r to y, and singular values of r to y and of r to u, through python-control."""
    import control
    import matplotlib as mpl
    from matplotlib.figure import Figure

    mpl.rcParams["svg.hashsalt"] = "fourtank-hil"
    steps, sigma = Figure(figsize=(8, 6), layout="constrained"), Figure(figsize=(8, 4), layout="constrained")
    step_axes, (to_y, to_u) = steps.subplots(2, 2, sharex=True), sigma.subplots(1, 2, sharex=True)
    times, frequencies = np.linspace(0.0, 120.0, 601), np.logspace(-3, 1, 300)
    for design in designs:
        A, B = augment(linear)
        K, C = design.K, np.hstack([linear.C, np.zeros((2, 2))])
        reference = np.vstack([np.zeros((4, 2)), np.eye(2)])
        loop = control.ss(A - B @ K, reference, np.vstack([C, -K]), np.zeros((4, 2)))
        response = control.step_response(loop, times)
        for i in (0, 1):
            for j in (0, 1):
                step_axes[i][j].plot(times, response.outputs[i, j], label=design.name)
                step_axes[i][j].set_title(f"r{j + 1} to y{i + 1}")
        gains = loop(1j * frequencies)
        for axes, part, name in ((to_y, gains[:2], "r to y"), (to_u, gains[2:], "r to u")):
            values = np.linalg.svd(np.moveaxis(part, 2, 0), compute_uv=False)
            (line,) = axes.loglog(frequencies, values[:, 0], label=design.name)
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
        svg = BytesIO()
        figure.savefig(svg, format="svg", metadata={"Date": None})
        write_atomically(path, svg.getvalue())
    return paths
