"""The four tanks as text: levels, references, rims and flows, and the two pumps below them.

Tank 3 is above tank 1 and tank 4 above tank 2, as on the rig. Each tank has its number and level, the flow that a pump
sends into it, its water, and its outflow. Whatever a colour says is also said by a letter, a sign or a pattern.
"""

from __future__ import annotations

import math

from rich.text import Text

from hil.panel.run_messages import ShownRun, ShownState

EIGHTHS = " ▁▂▃▄▅▆▇█"
WATER = "#4fa3e0"
DOUBTED = "#b08030"
REFERENCE = "bold #ffd75f"
LIMIT = "#d75f00"
SOFT = "#9aa0a6"
WALL = "#c8ccd0"
PUMP_ROWS = 3
HIGH_MARGIN_CM = 1.0
"""A level this close to the one that trips the run is marked."""
MAX_INNER = 26


def tank_picture(run: ShownRun, state: ShownState, width: int, height: int) -> Text:
    """The picture for `width` columns and `height` rows; at least 40 by 13."""
    rows = max((height - 4 - PUMP_ROWS) // 2, 2)
    half = max(width // 2, 20)
    lines: list[Text] = []
    for left, right in ((2, 3), (0, 1)):
        columns = [_tank(run, state, tank, half, rows) for tank in (left, right)]
        lines += [Text.assemble(first, second) for first, second in zip(*columns, strict=True)]
    lines += _pumps(run, state)
    return Text("\n").join(lines)


def _tank(run: ShownRun, state: ShownState, tank: int, width: int, rows: int) -> list[Text]:
    """One tank: a head line, `rows` lines of the tank, its bottom with the outflow."""
    inner = min(width - 11, MAX_INNER)
    lines = [_head(run, state, tank)]
    marks = _marks(run, state, tank, rows)
    level_cm = _level_cm(state, tank)
    height_cm = run.height_cm[tank]
    limit_row = _row_of(run.level_max_cm, height_cm, rows)
    for row in range(rows):
        filled = _filled_eighths(level_cm, height_cm, rows, row)
        line = Text.assemble(("│", WALL))
        if not filled and row == limit_row:
            line.append("╌" * inner, LIMIT)
        elif state.trusted[tank] or not filled:
            line.append(EIGHTHS[filled] * inner, WATER)
        else:
            line.append("▒" * inner, DOUBTED)
        line.append("│", WALL)
        text, style = marks.get(row, ("", ""))
        line.append(text, style)
        lines.append(line)
    middle = inner // 2
    bottom = Text(f"└{'─' * middle}┬{'─' * (inner - middle - 1)}┘", WALL)
    bottom.append(f" ↓{_flow(state.outflow_cm3_s[tank])}", WATER)
    lines.append(bottom)
    for line in lines:
        line.truncate(width)
        line.pad_right(width - line.cell_len)
    return lines


def _head(run: ShownRun, state: ShownState, tank: int) -> Text:
    """Number, level, a word on a level that is not to be trusted or high, and the pump that sends water."""
    level_cm = _level_cm(state, tank)
    head = Text.assemble((f"T{tank + 1}", "bold"))
    head.append(f" {_number(level_cm, '5.2f')} cm")
    if not state.trusted[tank]:
        head.append(" ? ", f"bold {DOUBTED}")
    elif level_cm > run.level_max_cm - HIGH_MARGIN_CM:
        head.append(" ! ", f"bold reverse {LIMIT}")
    else:
        head.append("   ")
    pump, inflow = _inflow(state, tank)
    head.append(f"P{pump}↓{_flow(inflow)}", WATER)
    return head


def _level_cm(state: ShownState, tank: int) -> float:
    """The measured level; the estimated one where the sensor is not trusted or has no reading."""
    measured_cm = state.measured_cm[tank]
    return measured_cm if state.trusted[tank] and math.isfinite(measured_cm) else state.estimated_cm[tank]


def _marks(run: ShownRun, state: ShownState, tank: int, rows: int) -> dict[int, tuple[str, str]]:
    """Row -> what is written right of the tank: limit, target, reference; a later one covers an earlier one."""
    height_cm = run.height_cm[tank]
    marks = {_row_of(run.level_max_cm, height_cm, rows): (f" max{run.level_max_cm:4.1f}", LIMIT)}
    if tank < 2:
        for sign, level_cm, style in (
            ("◁", state.target_cm[tank], SOFT),
            ("◀", state.reference_cm[tank], REFERENCE),
        ):
            if math.isfinite(level_cm):
                marks[_row_of(level_cm, height_cm, rows)] = (f"{sign}{level_cm:5.2f}", style)
    return marks


def _row_of(level_cm: float, height_cm: float, rows: int) -> int:
    """The row of a tank's drawing in which a level lies; 0 is the highest."""
    share = level_cm / height_cm if height_cm > 0.0 and math.isfinite(level_cm) else 0.0
    return min(max(rows - 1 - math.floor(share * rows), 0), rows - 1)


def _filled_eighths(level_cm: float, height_cm: float, rows: int, row: int) -> int:
    """How many eighths of a row are under water."""
    if not (math.isfinite(level_cm) and height_cm > 0.0):
        return 0
    eighths = round(level_cm / height_cm * rows * 8) - (rows - 1 - row) * 8
    return min(max(eighths, 0), 8)


def _inflow(state: ShownState, tank: int) -> tuple[int, float]:
    """Number of the pump that feeds a tank, and the flow of it in cm^3/s."""
    pump = (0, 1, 1, 0)[tank]
    share = state.split[pump] if tank < 2 else 1.0 - state.split[pump]
    return pump + 1, share * state.pump_flow_cm3_s[pump]


def _pumps(run: ShownRun, state: ShownState) -> list[Text]:
    """A head line and a line for each pump."""
    lines = [Text("pump  command  applied  effect  cm³/s", SOFT)]
    for pump in (0, 1):
        applied_V, effectiveness = state.applied_V[pump], state.effectiveness[pump]
        is_moving = math.isfinite(applied_V) and applied_V > run.range_V[0]
        line = Text.assemble((f"P{pump + 1} {'▶' if is_moving else '■'}", "bold"))
        line.append(f"  {_number(state.command_V[pump], '5.2f')} V  {_number(applied_V, '5.2f')} V")
        is_weak = effectiveness < 0.95
        line.append(f"   {_number(effectiveness, '4.2f')}", f"bold {DOUBTED}" if is_weak else "")
        line.append("▼" if is_weak else " ", f"bold {DOUBTED}")
        line.append(f"  {_flow(state.pump_flow_cm3_s[pump])}", WATER)
        lines.append(line)
    return lines


def _flow(flow_cm3_s: float) -> str:
    return _number(flow_cm3_s, "4.1f")


def _number(value: float, form: str) -> str:
    width = int(form.partition(".")[0])
    return format(value, form) if math.isfinite(value) else "-".rjust(width)
