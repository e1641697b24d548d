"""Replay the paper's experiment in the exported plant by FMPy, and plot it beside the emulator into a figure."""

import subprocess
import sys

import fmpy
import matplotlib
import numpy as np
from matplotlib.figure import Figure

import hil

DAC_CODES = 4095  # of the pump node's converter, over 0 .. 10 V
FAULT_S, LEFT = 200.0, 0.4

subprocess.run([sys.executable, "-m", "firmware_sim", "--fmu", "rig.fmu"], check=True)
series = hil.simulate("paper").series

# A command acts from its step on, and the node's report of it is in the next row, to 0.2 mV: enough to know the code.
t_s = series["t_s"][:-1]
reported = [series[f"v{pump}_applied_V"][1:] for pump in (1, 2)]
applied = [np.round(voltage * DAC_CODES / 10.0) * 10.0 / DAC_CODES for voltage in reported]
left = np.where(t_s < FAULT_S, 1.0, LEFT)

# Inputs are constant until the next row: every time stands there twice, with the value before and the one after it.
names = ["time", "v1_applied_V", "v2_applied_V", "effectiveness1", "effectiveness2"]
columns = [np.repeat(t_s, 2)[1:], *(np.repeat(values, 2)[:-1] for values in (*applied, left, left))]
inputs = np.array(list(zip(*columns, strict=True)), dtype=[(name, float) for name in names])

levels = [f"true_h{tank}_cm" for tank in (1, 2, 3, 4)]
unit = fmpy.simulate_fmu("rig.fmu", stop_time=t_s[-1], output_interval=0.1, input=inputs, output=levels)

difference_cm = [np.abs(unit[level] - series[level][: len(unit)]) for level in levels]
print(f"{len(unit)} samples, largest difference of a level: {np.max(difference_cm):.1e} cm")

matplotlib.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "fourtank"})
figure = Figure(figsize=(8, 5.5), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
seconds = slice(0, 5000, 10)
for tank, level in enumerate(levels, start=1):
    (line,) = above.plot(series["t_s"][seconds], series[level][seconds], linewidth=5, alpha=0.3)
    above.plot(unit["time"][seconds], unit[level][seconds], color=line.get_color(), linewidth=1, label=f"tank {tank}")
worst_cm = np.max(difference_cm, axis=0)[:5000].reshape(500, 10).max(axis=1)
below.semilogy(unit["time"][seconds], worst_cm)
below.axhline(1e-6, linestyle="--")
above.set_ylabel("level [cm]; wide: emulator, thin: unit")
above.legend(ncols=4, fontsize="small")
below.set_ylabel("largest\ndifference [cm]")
below.set_xlabel("time [s]")
for axes in (above, below):
    axes.grid(visible=True, alpha=0.3)
figure.savefig("plant_elsewhere.svg", metadata={"Date": None})
