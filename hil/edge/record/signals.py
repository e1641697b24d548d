"""The recorded signals, one row each. Columns of ticks.csv, Rerun series, the viewer's plots and the docs follow.

To record one more signal, add a row to `SIGNALS`; no other file changes. Its source is a function of `Step`: the
controller's `TickRecord` of the step and what the recorder itself knows. A row with a curve is also drawn in Rerun:
curves of one entity share a plot, and an entity that `hil.review.blueprint` does not know gets a plot of its own.

Why text comes first and Rerun beside it: docs/decisions/0003-record.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hil.core.types import Quad, TickRecord
from hil.edge.record.manifest import RunMode

# Colours for the viewer's dark background, as RGBA: measured values are dim, estimates and commands are bright,
# references are white or grey.
WHITE, GREY, DIM = 0xF2F5F7FF, 0x8A97A6FF, 0x48698AFF
BLUE, ORANGE, GREEN, PURPLE, AMBER = 0x58A6E8FF, 0xF08A4BFF, 0x5FC27EFF, 0xB08CDEFF, 0xE3B341FF

UNKNOWN_LEVELS: Quad = (math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Step:
    """What is known of one control step.

    true_level_cm : the emulator's levels, known in lockstep. latency_s : from the arrival of the newest frame that the
    step could use until its command was sent; NaN when it sent none. queue : entries that waited for the recorder.
    """

    record: TickRecord
    true_level_cm: Quad = UNKNOWN_LEVELS
    latency_s: float = math.nan
    queue: float = math.nan


Source = Callable[[Step], float]


@dataclass(frozen=True, slots=True)
class Curve:
    """How Rerun draws a signal.

    entity : path of the plot. name : of the curve, without unit. width : in points. layer : curves of a higher layer
    are drawn over those of a lower one.
    """

    entity: str
    name: str
    color: int = BLUE
    width: float = 1.5
    layer: int = 0


@dataclass(frozen=True, slots=True)
class Signal:
    """One recorded signal.

    column : its name in ticks.csv. unit : "" for counts and numbers of states. digits : significant digits in the
    file; None for a whole number. only : the one mode of run that has it; None: both have it.
    """

    column: str
    unit: str
    meaning: str
    source: Source
    curve: Curve | None = None
    digits: int | None = 6
    only: RunMode | None = None

    @property
    def is_in_cm(self) -> bool:
        """Whether Rerun shows the level as a voltage, beside the measured ones."""
        return self.unit == "cm"

    @property
    def curve_name(self) -> str:
        """The curve's name with its unit."""
        unit = "V" if self.is_in_cm else self.unit
        name = self.curve.name if self.curve else self.column
        return f"{name} [{unit}]" if unit else name

    @property
    def number_format(self) -> str:
        """Of a cell. A float has a decimal point from its first line on, so that no reader takes it for an integer."""
        return "%d" if self.digits is None else f"%#.{self.digits}g"


def _item(values: Callable[[TickRecord], Sequence[float]], index: int) -> Source:
    return lambda step: values(step.record)[index]


def _true_level(index: int) -> Source:
    return lambda step: step.true_level_cm[index]


def _run_ns(record: TickRecord) -> int:
    """Exact for a century: `t_s` is a whole number of ns, as seconds."""
    return round(record.t_s * 1e9)


PUMPS, TANKS, OUTPUTS = (0, 1), (0, 1, 2, 3), (0, 1)
PUMP_COLORS = (BLUE, ORANGE)
GAIN_COLORS = (BLUE, ORANGE, GREEN, PURPLE, WHITE, GREY)
GAIN_UNITS = ("V/cm",) * 4 + ("1/s",) * 2


def _level_curve(tank: int, name: str, color: int, width: float = 1.5, layer: int = 0) -> Curve:
    return Curve(f"levels/tank{tank + 1}", f"h{tank + 1} {name}", color, width, layer)


def _pump_curve(pump: int, name: str, color: int, width: float = 1.5, layer: int = 0) -> Curve:
    return Curve(f"pumps/pump{pump + 1}", f"pump {pump + 1} {name}", color, width, layer)


SIGNALS: tuple[Signal, ...] = (
    Signal(
        "t_s", "s", "run time: 0 at the first step in control, or after a start phase",
        lambda step: step.record.t_s, digits=9,
    ),
    Signal(
        "mode", "", "mode of the controller, as the number of hil.core.types.Mode", lambda step: step.record.mode,
        Curve("bench/mode", "mode, as its number", WHITE), digits=None,
    ),
    *(
        Signal(
            f"h{i + 1}_V", "V", f"measured level signal of tank {i + 1}", _item(lambda record: record.measured_V, i),
            _level_curve(i, "measured", DIM, 1.0), digits=9,
        )
        for i in TANKS
    ),
    *(
        Signal(
            f"h{i + 1}_est_V", "V", f"estimated level signal of tank {i + 1}",
            _item(lambda record: record.estimated_V, i), _level_curve(i, "estimate", BLUE, layer=2), digits=9,
        )
        for i in TANKS
    ),
    *(
        Signal(
            f"r{i + 1}_V", "V", f"reference of output {i + 1}, as requested",
            _item(lambda record: record.reference_V, i), _level_curve(i, "requested", GREY, layer=3),
        )
        for i in OUTPUTS
    ),
    *(
        Signal(
            f"target{i + 1}_V", "V", f"reference of output {i + 1} in force: the nearest that the pumps can reach",
            _item(lambda record: record.target_V, i), _level_curve(i, "in force", WHITE, layer=3),
        )
        for i in OUTPUTS
    ),
    *(
        Signal(
            f"v{i + 1}_operating_V", "V", f"voltage of pump {i + 1} that holds the reference in force, nominal pumps",
            _item(lambda record: record.operating_V, i), _pump_curve(i, "operating point", GREY, 1.0),
        )
        for i in PUMPS
    ),
    *(
        Signal(
            f"v{i + 1}_raw_V", "V", f"voltage of pump {i + 1} that the control law requests",
            _item(lambda record: record.raw_V, i), _pump_curve(i, "raw", AMBER, 1.0),
        )
        for i in PUMPS
    ),
    *(
        Signal(
            f"probe{i + 1}_V", "V", f"part of the requested voltage of pump {i + 1} that is a probe: a small movement "
            "that tells faults apart", _item(lambda record: record.probe_V, i),
            Curve("control/probe", f"pump {i + 1} probe", PUMP_COLORS[i]),
        )
        for i in PUMPS
    ),
    *(
        Signal(
            f"v{i + 1}_V", "V", f"command to pump {i + 1}: what the supervisor allows",
            _item(lambda record: record.command_V, i), _pump_curve(i, "command", PUMP_COLORS[i], layer=1),
        )
        for i in PUMPS
    ),
    *(
        Signal(
            f"v{i + 1}_applied_V", "V", f"voltage that the pump node reports for pump {i + 1}",
            _item(lambda record: record.applied_V, i), _pump_curve(i, "applied", GREEN, 2.0),
        )
        for i in PUMPS
    ),
    *(
        Signal(
            f"theta{i + 1}", "1", f"diagnosed effectiveness of pump {i + 1}: 1 is nominal, 0 is dead",
            _item(lambda record: record.effectiveness, i),
            Curve("pumps/effectiveness", f"pump {i + 1} effectiveness", PUMP_COLORS[i]),
        )
        for i in PUMPS
    ),
    *(
        Signal(
            f"q{i + 1}_Vs", "V s", f"integral of the control error of output {i + 1}",
            _item(lambda record: record.integral_Vs, i), Curve("control/integral", f"integral {i + 1}", PUMP_COLORS[i]),
        )
        for i in OUTPUTS
    ),
    *(
        Signal(
            f"K{i + 1}{j + 1}", GAIN_UNITS[j], f"gain from state {j + 1} (four levels, two integrals) to pump {i + 1}",
            _item(lambda record: record.gain, 6 * i + j),
            Curve(f"control/gain_pump{i + 1}", f"K{i + 1}{j + 1}", GAIN_COLORS[j]),
        )
        for i in PUMPS for j in range(6)
    ),
    *(
        Signal(
            f"iae{i + 1}_Vs", "V s", f"integral of the absolute error of output {i + 1} so far",
            _item(lambda record: record.iae_Vs, i),
            Curve("control/iae", f"IAE so far, output {i + 1}", PUMP_COLORS[i]),
        )
        for i in OUTPUTS
    ),
    *(
        Signal(
            f"noise{i + 1}_cm_sqrt_s", "cm/√s", f"process noise of tank {i + 1} that diagnosis has learned: standard "
            "deviation of the random walk of its level after one second",
            _item(lambda record: record.level_walk_cm_sqrt_s, i),
            Curve("bench/process_noise", f"tank {i + 1}", GAIN_COLORS[i]),
        )
        for i in TANKS
    ),
    *(
        Signal(
            f"h{i + 1}_std_V", "V", f"standard deviation of level signal {i + 1} as the diagnosis estimates it",
            _item(lambda record: record.level_std_V, i), digits=3,
        )
        for i in TANKS
    ),
    Signal(
        "test_ratio", "1", "largest log-likelihood ratio of a fault against none, of the diagnosis",
        lambda step: step.record.test_ratio, Curve("diagnosis/test", "largest ratio", BLUE), digits=4,
    ),
    Signal(
        "test_limit", "1", "ratio from which on the diagnosis raises an alarm", lambda step: step.record.test_limit,
        Curve("diagnosis/test", "limit", AMBER), digits=4,
    ),
    Signal(
        "levels_age_s", "s", "age of the older of the two level frames", lambda step: step.record.levels_age_s,
        Curve("bench/age", "age of levels", BLUE),
    ),
    Signal(
        "status_age_s", "s", "age of the pump node's last status", lambda step: step.record.status_age_s,
        Curve("bench/age", "age of pump status", ORANGE),
    ),
    Signal(
        "lateness_s", "s", "how late the step began", lambda step: step.record.lateness_s,
        Curve("bench/lateness", "lateness", BLUE),
    ),
    Signal(
        "skipped", "", "control periods skipped so far", lambda step: step.record.skipped,
        Curve("bench/trouble", "periods skipped", ORANGE, layer=1), digits=None,
    ),
    Signal(
        "accepted", "", "frames accepted so far", lambda step: step.record.accepted,
        Curve("bench/accepted", "frames accepted", BLUE), digits=None,
    ),
    Signal(
        "rejected", "", "frames rejected so far", lambda step: step.record.rejected,
        Curve("bench/trouble", "frames rejected", BLUE), digits=None,
    ),
    *(
        Signal(
            f"true_h{i + 1}_cm", "cm", f"true level of tank {i + 1}, from the emulator", _true_level(i),
            _level_curve(i, "true", GREEN, layer=1), digits=9, only="lockstep",
        )
        for i in TANKS
    ),
    Signal(
        "latency_s", "s", "from the arrival of the newest frame that the step could use until its command was sent",
        lambda step: step.latency_s, Curve("bench/latency", "newest frame to command", BLUE), only="live",
    ),
    Signal(
        "t_ns", "ns", "run time at which the step began, exactly: for a replay", lambda step: _run_ns(step.record),
        digits=None, only="live",
    ),
    Signal(
        "recorder_queue", "", "entries of the record that waited to be written when the step ended",
        lambda step: step.queue, Curve("bench/recorder_queue", "entries waiting", BLUE), digits=None, only="live",
    ),
)  # fmt: skip


def recorded(mode: RunMode, shown: Sequence[str] = ()) -> tuple[Signal, ...]:
    """The signals of a run in this mode, in the order of its columns; last, what its control law shows, by name."""
    return (*(signal for signal in SIGNALS if signal.only in (None, mode)), *map(_of_law, shown))


def _of_law(name: str) -> Signal:
    """A number that the control law of a run has recorded; NaN in a step in which it shows none."""
    meaning = f"{name}, as the control law of the run shows it"
    return Signal(
        f"law_{name}", "", meaning, lambda step: step.record.shown.get(name, math.nan), Curve(f"law/{name}", name)
    )


def markdown_table() -> str:
    """All signals as a Markdown table, for the docs."""
    lines = ["| column | unit | meaning | recorded in | Rerun entity |", "|---|---|---|---|---|"]
    for signal in SIGNALS:
        where = signal.only or "every run"
        entity = f"`{signal.curve.entity}`" if signal.curve else ""
        lines.append(f"| `{signal.column}` | {signal.unit} | {signal.meaning} | {where} | {entity} |")
    return "\n".join(lines) + "\n"
