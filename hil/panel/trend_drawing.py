"""Trends of the last minutes as text, in Braille dots: a line of a signal, and a dotted line of what it should be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from rich.text import Text

from hil.panel.tank_drawing import REFERENCE, SOFT, WATER

DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bits of a Braille sign by row and column of its dots."""
BRAILLE = 0x2800
DOTTED = 4
"""Every so many columns the dotted line has a dot."""
LABEL = 6


@dataclass(frozen=True, slots=True)
class Trend:
    """What one chart shows. values, wanted : of the same length, one for each time; nan where unknown."""

    title: str
    times_s: Sequence[float]
    values: Sequence[float]
    wanted: Sequence[float] = ()
    min_span: float = 1.0


def trend_chart(trend: Trend, width: int, height: int, span_s: float) -> Text:
    """A chart of the last span_s in `width` columns and `height` rows; its first row is the title."""
    low, high = _range(trend)
    columns, rows = max(width - LABEL, 4), max(height - 1, 1)
    latest = _latest(trend.values)
    head = Text.assemble((trend.title, "bold"))
    head.append(f" {latest:.2f}" if math.isfinite(latest) else " -", WATER)
    if trend.wanted and math.isfinite(wanted := _latest(trend.wanted)):
        head.append(f"  ┄ {wanted:.2f}", REFERENCE)
    line = _dots(trend.times_s, trend.values, columns, rows, (low, high), span_s, step=1)
    dotted = _dots(trend.times_s, trend.wanted, columns, rows, (low, high), span_s, step=DOTTED)
    lines = [head]
    for row in range(rows):
        label = f"{high:5.1f} " if row == 0 else f"{low:5.1f} " if row == rows - 1 else " " * LABEL
        text = Text.assemble((label, SOFT))
        signs = [
            (
                chr(BRAILLE | bits | wanted_bits) if bits | wanted_bits else " ",
                WATER if bits or not wanted_bits else REFERENCE,
            )
            for bits, wanted_bits in zip(line[row], dotted[row], strict=True)
        ]
        for style, group in groupby(signs, key=lambda sign: sign[1]):
            text.append("".join(sign for sign, _ in group), style)
        lines.append(text)
    return Text("\n").join(lines)


def _latest(values: Sequence[float]) -> float:
    return values[-1] if values else math.nan


def _range(trend: Trend) -> tuple[float, float]:
    """Lowest and highest value of the axis, at least min_span apart."""
    known = [value for value in (*trend.values, *trend.wanted) if math.isfinite(value)]
    if not known:
        return 0.0, trend.min_span
    low, high = min(known), max(known)
    spare = max((trend.min_span - (high - low)) / 2.0, 0.05 * (high - low))
    return low - spare, high + spare


def _dots(
    times_s: Sequence[float],
    values: Sequence[float],
    columns: int,
    rows: int,
    limits: tuple[float, float],
    span_s: float,
    step: int,
) -> list[list[int]]:
    """Bits of the Braille signs, by row and column. step : every so many columns of dots have one."""
    grid = [[0] * columns for _ in range(rows)]
    if not values:
        return grid
    low, high = limits
    end_s, wide, tall = times_s[-1], 2 * columns, 4 * rows
    last: tuple[int, int] | None = None
    for time_s, value in zip(times_s, values, strict=True):
        x = wide - 1 - round((end_s - time_s) / span_s * (wide - 1))
        if x < 0 or not math.isfinite(value):
            last = None
            continue
        y = min(max(round((high - value) / (high - low) * (tall - 1)), 0), tall - 1)
        for px, py in _between(last, (x, y)):
            if px % step == 0:
                grid[py // 4][px // 2] |= DOTS[py % 4][px % 2]
        last = (x, y)
    return grid


def _between(start: tuple[int, int] | None, end: tuple[int, int]) -> list[tuple[int, int]]:
    """The dots of a straight line, without its first one."""
    if start is None:
        return [end]
    (x0, y0), (x1, y1) = start, end
    count = max(abs(x1 - x0), abs(y1 - y0))
    return [(x0 + round((x1 - x0) * i / count), y0 + round((y1 - y0) * i / count)) for i in range(1, count + 1)]
