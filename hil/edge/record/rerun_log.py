"""The run as a Rerun recording, `run.rrd`: every series on the timeline `run_time`, with the layout it opens in.

Rows are gathered and sent by columns, one chunk for each entity: some twenty times cheaper than single calls. Series
that are drawn together share an entity, because each chunk costs about 1.1 kB of file however few rows it has. A live
run, which sends small chunks so that little is lost when it is killed, is compacted at its end.

The file format is young; `ticks.csv`, `can.log` and `events.jsonl` are the primary record
(docs/decisions/0003-record.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import numpy.typing as npt
import rerun as rr
import rerun.blueprint as rrb

from hil.core.types import Event, Mode
from hil.edge.record.coarse_rows import extreme_rows
from hil.edge.record.diagnosis_bands import DiagnosisBands
from hil.edge.record.manifest import RunMode
from hil.edge.record.new_folder import disk_error
from hil.edge.record.picture_model import PictureModel
from hil.edge.record.record_format import Row
from hil.edge.record.rerun_calls import COMPACT_TIMEOUT_S, abandon, call_within, compact
from hil.edge.record.run_states import NO_STATE, STATES, pump_state
from hil.edge.record.signals import Signal, recorded
from hil.edge.record.tank_picture import TankPicture

TIMELINE = "run_time"
APPLICATION = "fourtank-hil"
FLUSH_TIMEOUT_S = 2.0
CALL_TIMEOUT_S = 5.0
"""For each call of Rerun that reaches its file: one that meets a full disk may wait for ever."""
COARSE_BATCH = 250
"""Steps of a long run that are sent together at least; if the run is killed, they are missing in run.rrd alone."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Series:
    """The signals drawn together in one entity, in the order in which they are drawn, and their places in a row."""

    entity: str
    signals: tuple[Signal, ...]
    places: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class RunCard:
    """What identifies the run: the title, its facts for the recording's properties, and a Markdown text."""

    recording_id: str
    facts: dict[str, str]
    markdown: str


def series(mode: RunMode, shown: Sequence[str] = ()) -> tuple[Series, ...]:
    """All series of a recording of such a run, with what its control law shows."""
    drawn = [(signal.curve, signal, place) for place, signal in enumerate(recorded(mode, shown)) if signal.curve]
    drawn.sort(key=lambda one: (one[0].entity, one[0].layer))  # stable: the table's order within a layer
    groups = [(entity, list(group)) for entity, group in groupby(drawn, key=lambda one: one[0].entity)]
    return tuple(
        Series(entity, tuple(signal for _, signal, _ in group), tuple(place for _, _, place in group))
        for entity, group in groups
    )


class RerunLog:
    """A `Timeline` for the recorder. Building it writes the static parts: half a second, before the loop.

    mode, shown : of the run, which decide the signals. batch_ticks : steps gathered before they are sent by themselves;
    `flush` sends what there is. picture : the rig for the picture of its tanks; None without it. path : None for
    a recording that is not written but served, by `server`. coarser : of a long run one row of so many is recorded,
    with all peaks; see `hil.edge.record.coarse_rows`.
    """

    def __init__(
        self,
        path: Path | None,
        card: RunCard,
        *,
        level_gain_V_cm: float,
        mode: RunMode,
        shown: Sequence[str] = (),
        blueprint: rrb.Blueprint | None = None,
        batch_ticks: int = 250,
        coarser: int = 1,
        compact_at_close: bool = False,
        picture: PictureModel | None = None,
        server: rr.GrpcServerSink | None = None,
    ) -> None:
        self._path, self._server, self._compact_at_close = path, server, compact_at_close
        self._coarser = coarser
        signals = recorded(mode, shown)
        self._to_V = np.array([level_gain_V_cm if signal.is_in_cm else 1.0 for signal in signals])
        columns = [signal.column for signal in signals]
        self._mode, self._theta1, self._theta2 = (columns.index(name) for name in ("mode", "theta1", "theta2"))
        self._series = series(mode, shown)
        self._picture = None if picture is None else TankPicture(picture, columns, coarser)
        self._bands = DiagnosisBands(columns, coarser)
        self._further = [one for one in (self._bands, self._picture) if one is not None]
        self._table = np.empty(
            (batch_ticks if coarser == 1 else max(batch_ticks, COARSE_BATCH * coarser), len(signals))
        )
        self._filled = 0
        self._events: list[tuple[float, Event]] = []
        self._states: dict[str, list[tuple[float, str]]] = {}
        self._state_now: dict[str, str] = {}
        self._state_key: tuple[float, float, float] | None = None
        self._recording = rr.RecordingStream(APPLICATION, recording_id=card.recording_id)
        self._call(lambda: self._open(card, blueprint))

    def tick(self, row: Row) -> None:
        """Take one step; see `hil.edge.record.recorder.Timeline`."""
        key = (row[self._mode], row[self._theta1], row[self._theta2])
        if key != self._state_key:
            self._note_states(row[0], key)
        self._table[self._filled] = row
        self._filled += 1
        if self._filled == len(self._table):
            self._call(self._send)

    def event(self, t_s: float, event: Event) -> None:
        """Take one event: a line of the log; alarms and trips become states, too."""
        self._events.append((t_s, event))
        if event.code == "alarm":
            if self._picture is not None:
                self._picture.note_alarm(t_s, event.data)
            self._set_state("diagnosis/candidates", t_s, self._bands.note_alarm(t_s, event.data))
            text = f"{event.data.get('kind')} {event.data.get('target')}"
            earlier = self._states.get("states/alarm", [])
            if earlier and earlier[-1][0] == t_s and earlier[-1][1] != NO_STATE:
                text = f"{earlier.pop()[1]} + {text}"
            self._set_state("states/alarm", t_s, text)
        elif event.code == "trip":
            self._set_state("states/trip", t_s, str(event.data.get("cause")))

    def _note_states(self, t_s: float, key: tuple[float, float, float]) -> None:
        """The mode or a pump's health has changed at this step; a trip's state ends when its mode is left."""
        mode, *effectiveness = key
        has_left_trip = self._state_key is not None and self._state_key[0] == Mode.TRIPPED and mode != Mode.TRIPPED
        self._state_key = key
        self._set_state("states/mode", t_s, Mode(int(mode)).name)
        for pump, share in enumerate(effectiveness, start=1):
            self._set_state(f"states/pump{pump}", t_s, pump_state(share))
        for entity in ("states/alarm", "diagnosis/candidates"):
            if entity not in self._state_now:
                self._set_state(entity, t_s, NO_STATE)
        if has_left_trip or "states/trip" not in self._state_now:
            self._set_state("states/trip", t_s, NO_STATE)

    def send(self) -> None:
        """Send what was gathered, the picture too."""
        self._call(self._send_all)

    def flush(self) -> None:
        """Send what was gathered and see it on its way to the disk; raises when the disk does not take it."""
        self._call(self._send_and_flush)

    def close(self) -> None:
        """Send the rest and finalise the file."""
        self._call(self._finalise)
        path = self._path
        if self._compact_at_close and path is not None:
            self._call(lambda: compact(path), 2.0 * COMPACT_TIMEOUT_S)

    def _call(self, call: Callable[[], None], timeout_s: float = CALL_TIMEOUT_S) -> None:
        """Call Rerun. Where the disk is the cause of what it raises, that error is raised instead."""
        try:
            call_within(timeout_s, call)
        except Exception as error:
            abandon(self._recording)
            if self._path is not None and (cause := disk_error(self._path.parent)) is not None:
                raise cause from error
            raise

    def _open(self, card: RunCard, blueprint: rrb.Blueprint | None) -> None:
        if self._path is not None:
            self._recording.save(self._path, default_blueprint=blueprint)
        elif self._server is not None:
            self._recording.set_sinks(self._server, default_blueprint=blueprint)
        self._log_static(card)
        self._recording.flush(timeout_sec=FLUSH_TIMEOUT_S)

    def _send_all(self) -> None:
        self._send()
        for further in self._further:
            further.send(self._recording)

    def _send_and_flush(self) -> None:
        if self._coarser == 1 or self._filled >= COARSE_BATCH:  # in a few rows hardly any can be left out
            self._send_all()
        self._recording.flush(timeout_sec=FLUSH_TIMEOUT_S)

    def _finalise(self) -> None:
        try:
            self._send_all()
            self._recording.flush(timeout_sec=FLUSH_TIMEOUT_S)
        finally:
            self._recording.disconnect()

    def _log_static(self, card: RunCard) -> None:
        for one in self._series:
            zoomed_out = (
                "Max" if one.entity.startswith(("bench/", "diagnosis/")) else "Average"
            )  # the viewer shows rare peaks, too
            curves = [signal.curve for signal in one.signals if signal.curve]
            look = rr.SeriesLines(
                names=[signal.curve_name for signal in one.signals],
                colors=np.array([curve.color for curve in curves], dtype=np.uint32),
                widths=[curve.width for curve in curves],
                aggregation_policy=rr.components.AggregationPolicy.auto(zoomed_out),
            )
            self._recording.log(one.entity, look, static=True)
        for entity, (values, labels, colors) in STATES.items():
            style = rr.StateConfiguration(values=values, labels=labels, colors=np.array(colors, dtype=np.uint32))
            self._recording.log(entity, style, static=True)
        if self._picture is not None:
            self._picture.log_static(self._recording)
        self._recording.log("card", rr.TextDocument(card.markdown, media_type=rr.MediaType.MARKDOWN), static=True)
        if card.facts:
            self._recording.send_property("run", rr.AnyValues(drop_untyped_nones=True, **card.facts))

    def _send(self) -> None:
        if self._filled:
            table, self._filled = self._table[: self._filled], 0
            for one in self._series:
                places = list(one.places)
                values = table[:, places] * self._to_V[places]
                kept = extreme_rows(values, self._coarser)
                times = time_column(table[kept, 0])
                self._recording.send_columns(one.entity, [times], rr.Scalars.columns(scalars=values[kept]))
            for further in self._further:
                further.add(table)
                if further.is_due:
                    further.send(self._recording)
        for entity, changes in self._states.items():
            self._send_changes(entity, changes)
        self._states.clear()
        if self._events:
            times = time_column(np.array([t_s for t_s, _ in self._events]))
            texts = [f"{event.code}: {event.text}" for _, event in self._events]
            levels = [str(event.severity) for _, event in self._events]
            self._events.clear()
            self._recording.send_columns("log", [times], rr.TextLog.columns(text=texts, level=levels))

    def _send_changes(self, entity: str, changes: Sequence[tuple[float, str]]) -> None:
        times = time_column(np.array([t_s for t_s, _ in changes]))
        self._recording.send_columns(entity, [times], rr.StateChange.columns(state=[state for _, state in changes]))

    def _set_state(self, entity: str, t_s: float, state: str) -> None:
        if self._state_now.get(entity) != state:
            self._state_now[entity] = state
            self._states.setdefault(entity, []).append((t_s, state))


def time_column(times_s: Floats) -> rr.TimeColumn:
    """Times in s on the timeline of a recording."""
    nanoseconds = np.round(times_s * 1e9).astype("timedelta64[ns]")
    return rr.TimeColumn(TIMELINE, duration=nanoseconds)
