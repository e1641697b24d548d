"""Simulate the paper's experiment and plot levels, references and pump voltages into `paper.svg`."""

from matplotlib.figure import Figure

import hil

result = hil.simulate("paper")
print(result)

series = result.series
figure = Figure(figsize=(8, 6), layout="constrained")
levels, pumps = figure.subplots(2, 1, sharex=True)
for output in (1, 2):
    (line,) = levels.plot(series["t_s"], series[f"h{output}_V"], label=f"output {output}")
    levels.plot(series["t_s"], series[f"r{output}_V"], color=line.get_color(), linestyle="--")
    pumps.plot(series["t_s"], series[f"v{output}_applied_V"], label=f"pump {output}")
levels.set_ylabel("level [V], reference dashed")
pumps.set_ylabel("applied voltage [V]")
pumps.set_xlabel("time [s]")
for axes in (levels, pumps):
    axes.grid(visible=True, alpha=0.3)
    axes.legend()
figure.savefig("paper.svg")

for window, (first, second) in result.iae_Vs.items():
    print(f"IAE {window}: {first:.3f}, {second:.3f} V s")
