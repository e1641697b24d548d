"""`identification.rrd`: measured against predicted for each tank, with the residuals, for the Rerun viewer."""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from hil.core.identification.result import Identification, Prediction
from hil.edge.record.new_folder import disk_error
from hil.edge.record.record_errors import IncompleteRecordError
from hil.edge.record.rerun_calls import abandon, call_within
from hil.edge.record.rerun_log import TIMELINE, time_column
from hil.edge.record.signals import AMBER, BLUE, GREEN, GREY, ORANGE

Floats = NDArray[np.float64]

MAX_HZ = 10.0
"""Rows of a record that are closer are left out, evenly."""

WRITE_TIMEOUT_S, FLUSH_TIMEOUT_S = 60.0, 30.0


@dataclass(frozen=True, eq=False)
class Curves:
    """What one entity has: names, colours, widths and (n, m) values over (n,) times."""

    entity: str
    names: tuple[str, ...]
    colors: tuple[int, ...]
    widths: tuple[float, ...]
    time_s: Floats
    values: Floats


def write_recording(path: Path, identification: Identification, card: str) -> None:
    """Write the recording; an older file is replaced. card : text about the identification, in Markdown.

    Raises IncompleteRecordError; there may be a part of the file then, beside the old one.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    recording_id = f"{zlib.crc32(os.fsencode(path.resolve().parent)):08x}"
    recording = rr.RecordingStream("fourtank-identification", recording_id=recording_id)

    def write() -> None:
        recording.save(temporary, default_blueprint=blueprint(identification))
        recording.log("card", rr.TextDocument(_encodable(card), media_type=rr.MediaType.MARKDOWN), static=True)
        for curves in all_curves(identification):
            _send(recording, curves)
        recording.flush(timeout_sec=FLUSH_TIMEOUT_S)
        recording.disconnect()

    try:
        call_within(WRITE_TIMEOUT_S, write)
        temporary.replace(path)
    except Exception as error:
        abandon(recording)
        cause = disk_error(path.parent) or error
        raise IncompleteRecordError(f"{path} can't be written: {cause}") from error
    finally:
        temporary.unlink(missing_ok=True)


def all_curves(identification: Identification) -> list[Curves]:
    """Every entity, record by record: record1/levels/tank1, record1/residuals/tank1, record1/voltages."""
    before = {one.name: one for one in identification.predictions_before}
    found: list[Curves] = []
    for number, one in enumerate(identification.predictions, start=1):
        found += _of_record(f"record{number}", one, before.get(one.name))
    return found


def blueprint(identification: Identification) -> rrb.Blueprint:
    """A tab for each record, with readings above residuals; that of the held-out record is open."""
    shown = identification.predictions
    tabs = [_sheet(f"record{number}", one) for number, one in enumerate(shown, start=1)]
    opened = next((place for place, one in enumerate(shown) if one.is_held_out), 0)
    card = rrb.TextDocumentView(origin="/card", name="Result")
    return rrb.Blueprint(
        rrb.Tabs(*tabs, card, active_tab=opened),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        auto_views=False,
    )


def _sheet(record: str, one: Prediction) -> rrb.Vertical:
    begin, end = (rr.TimeRangeBoundary.absolute(seconds=float(time_s)) for time_s in (one.time_s[0], one.time_s[-1]))
    axis = rrb.TimeAxis(view_range=rr.TimeRange(start=begin, end=end))

    def plot(entity: str, title: str) -> rrb.TimeSeriesView:
        legend = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)
        contents = [f"/{record}/{entity}"]
        return rrb.TimeSeriesView(origin="/", contents=contents, name=title, axis_x=axis, plot_legend=legend)

    tanks = (1, 2, 3, 4)
    return rrb.Vertical(
        rrb.Horizontal(*(plot(f"readings/tank{tank}", f"Sensor {tank} [V]") for tank in tanks[:2])),
        rrb.Horizontal(*(plot(f"readings/tank{tank}", f"Sensor {tank} [V]") for tank in tanks[2:])),
        rrb.Horizontal(*(plot(f"residuals/tank{tank}", f"Residual {tank} [mV]") for tank in tanks)),
        rrb.Horizontal(plot("levels", "Levels, predicted [cm]"), plot("voltages", "Pump voltages [V]")),
        row_shares=[2.2, 2.2, 1.6, 1.6],
        name=_encodable(one.name) + (" (held out)" if one.is_held_out else ""),
    )


def _encodable(text: str) -> str:
    """A text without what a file name may have and UTF-8 has not."""
    return text.encode("utf-8", "replace").decode()


def _thinned(one: Prediction) -> Prediction:
    rate_Hz = (len(one.time_s) - 1) / float(one.time_s[-1] - one.time_s[0])
    keep = slice(None, None, max(1, round(rate_Hz / MAX_HZ)))
    arrays = ("time_s", "voltage_V", "reading_V", "predicted_V", "level_cm")
    return replace(one, **{name: getattr(one, name)[keep] for name in arrays})


def _of_record(record: str, one: Prediction, before: Prediction | None) -> list[Curves]:
    if before is not None:
        before = _thinned(before) if len(before.time_s) == len(one.time_s) else None
    one = _thinned(one)
    found = []
    for tank in range(4):
        columns = [one.reading_V[:, tank], one.predicted_V[:, tank]]
        names, colors, widths = ["measured", "predicted"], [GREY, BLUE], [3.0, 1.5]
        if before is not None:
            columns.insert(1, before.predicted_V[:, tank])
            names.insert(1, "predicted by the old file")
            colors.insert(1, ORANGE)
            widths.insert(1, 1.2)
        place = f"tank{tank + 1}"
        values = np.column_stack(columns)
        found.append(
            Curves(f"{record}/readings/{place}", tuple(names), tuple(colors), tuple(widths), one.time_s, values)
        )
        residual_mV = one.residuals[:, tank : tank + 1] * 1e3
        found.append(Curves(f"{record}/residuals/{place}", ("residual",), (AMBER,), (1.0,), one.time_s, residual_mV))
    tanks, widths4 = tuple(f"tank {tank}" for tank in (1, 2, 3, 4)), (1.5,) * 4
    found.append(Curves(f"{record}/levels", tanks, (BLUE, ORANGE, GREEN, AMBER), widths4, one.time_s, one.level_cm))
    pumps = ("pump 1", "pump 2")
    found.append(Curves(f"{record}/voltages", pumps, (BLUE, ORANGE), (1.5, 1.5), one.time_s, one.voltage_V))
    return found


def _send(recording: rr.RecordingStream, curves: Curves) -> None:
    colors = np.array(curves.colors, dtype=np.uint32)
    look = rr.SeriesLines(names=list(curves.names), colors=colors, widths=list(curves.widths))
    recording.log(curves.entity, look, static=True)
    scalars = rr.Scalars.columns(scalars=np.ascontiguousarray(curves.values))
    recording.send_columns(curves.entity, [time_column(curves.time_s)], scalars)


def card_text(title: str, lines: Sequence[str]) -> str:
    """The text beside the plots."""
    return "\n".join([f"# {title}", "", *(f"- {line}" for line in lines)]) + "\n"
