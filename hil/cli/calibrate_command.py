"""`hil calibrate`: takes the points, from a file or over CAN, fits the lines, shows them, writes the new rig file."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from rich.console import Console
from rich.table import Table

from hil.bench import run_options
from hil.bench.calibration_result import (
    FIGURES_FILE,
    NEW_RIG_FILE,
    POINTS_FILE,
    calibrated_text,
    difference,
    figures_json,
)
from hil.bench.calibration_session import SensorFacts, Session
from hil.cli import doctor_command, exit_codes
from hil.cli.complaint import complain
from hil.core.identification.calibration import CalibrationError, LevelPoint, SensorLine, check_point, fit_sensors
from hil.edge.can.bus import BusPort
from hil.edge.config.points_file import KnownLevel, load_points, points_csv
from hil.edge.config.rig_file import Rig
from hil.edge.config.rig_file_writer import read_rig_text, replace_rig_file
from hil.edge.config.settings_file import of_all
from hil.edge.config.shipped import rig_file_in_use
from hil.edge.host.clock import MonotonicClock, StopSignal
from hil.edge.host.typed_lines import TypedLines
from hil.edge.record.file_writing import write_atomically
from hil.edge.record.new_folder import NewFolder
from hil.edge.record.record_errors import RunFolderError, RunFolderExistsError
from hil.probe.bus_probe import InterruptedByUserError, Probe, ProbeError


@dataclass(frozen=True)
class CalibrateOptions:
    """Options of the command line; None: the default. tanks : 1..4."""

    interface: str | None = None
    channel: str | None = None
    bitrate: int | None = None
    points: Path | None = None
    tanks: tuple[int, ...] = (1, 2, 3, 4)
    out: Path | None = None
    write: bool = False
    config_dir: Path | None = None
    rig: str | Path | None = None

    @property
    def rig_path(self) -> Path:
        """The rig file to be changed."""
        return rig_file_in_use(self.rig, self.config_dir)


class Terminal:
    """The user at the terminal. One line shows the reading and is overwritten; without a terminal it is left out."""

    def __init__(self, console: Console, lines: TypedLines) -> None:
        self._console, self._lines = console, lines

    def say(self, text: str) -> None:
        """A line that stays."""
        self._clear()
        self._console.print(text, highlight=False, markup=False)

    def show(self, text: str) -> None:
        """The reading, in the place of the one before."""
        if self._console.is_terminal:
            self._clear()
            self._console.file.write(f"{text[: self._console.width - 12]}  level: ")
            self._console.file.flush()

    def typed(self) -> str | None:
        """The next line that was typed, without waiting. Raises EOFError at the end."""
        return self._lines.next()

    def _clear(self) -> None:
        if self._console.is_terminal:
            self._console.file.write("\r\x1b[K")


def run(console: Console, options: CalibrateOptions) -> int:
    """Calibrate; return the exit code. Raises SettingsError, CalibrationError, BusError, RunFolderError."""
    rig, _, _ = doctor_command.bench(_bench_options(options))
    given = () if options.points is None else load_points(options.points)
    known = [point for point in (one.point for one in given) if point is not None]
    facts = sensor_facts(rig)
    for point in known:
        check_point(point, facts.height_cm[point.tank], facts.range_V, facts.noise_V[point.tank])
    out = options.out or run_options.default_folder("calibration", datetime.now())
    folder = _make(out)
    try:
        points, stopped_by = known, ""
        if not given or len(known) < len(given):
            points, stopped_by = taken(console, options, facts, given, folder.path / POINTS_FILE)
        if stopped_by:
            return _stopped(stopped_by, folder.path, points)
        return _finish(console, options, rig, points, folder.path)
    except CalibrationError as error:
        if (folder.path / POINTS_FILE).exists():
            raise CalibrationError(f"{error}; the points are kept in {folder.path / POINTS_FILE}") from None
        raise
    finally:
        folder.remove_if_empty()


def taken(
    console: Console, options: CalibrateOptions, facts: SensorFacts, given: Sequence[KnownLevel], file: Path
) -> tuple[list[LevelPoint], str]:
    """The points after a session over CAN, and the signal that has ended it early, or ""."""
    _, contract, address = doctor_command.bench(_bench_options(options))
    points = [point for point in (one.point for one in given) if point is not None]
    tanks = sorted({one.tank for one in given if one.point is None}) or sorted(set(options.tanks))
    with closing(BusPort(address.open(contract.ids))) as port, StopSignal() as stop:
        probe = Probe(contract, port, MonotonicClock(), lambda: stop.received.name if stop.received else "")
        terminal = Terminal(console, TypedLines())
        session = Session(
            probe, facts, terminal, lambda all_points: write_atomically(file, points_csv(all_points)), points
        )
        try:
            with probe:
                session.run([tank - 1 for tank in tanks], given)
        except InterruptedByUserError as error:
            return session.points, str(error)
        except ProbeError as error:
            raise CalibrationError(str(error)) from None
    return session.points, ""


def sensor_facts(rig: Rig) -> SensorFacts:
    """What the rig file says of the sensors."""
    return SensorFacts(
        gain_V_cm=of_all(rig.sensors.gain_V_cm),
        noise_V=of_all(rig.sensors.noise_V),
        range_V=rig.sensors.range_V,
        height_cm=of_all(rig.tanks.height_cm),
    )


def lines_table(rig: Rig, lines: Sequence[SensorLine]) -> Table:
    """Gain and offset of each sensor with one standard deviation, the values before, the largest miss of a level."""
    table = Table(title="hil calibrate", title_justify="left")
    for name in ("sensor", "gain V/cm", "was", "offset V", "was", "miss cm"):
        table.add_column(name, justify="right")
    gains, offsets = of_all(rig.sensors.gain_V_cm), of_all(rig.sensors.offset_V)
    for line in lines:
        table.add_row(
            str(line.tank + 1),
            f"{line.gain_V_cm:.5f} ± {line.gain_sd_V_cm:.5f}",
            f"{gains[line.tank]:g}",
            f"{line.offset_V:.4f} ± {line.offset_sd_V:.4f}",
            f"{offsets[line.tank]:g}",
            f"{max(map(abs, line.misses_cm)):.2f}" if len(line.points) > 2 else "–",
        )
    return table


def _finish(console: Console, options: CalibrateOptions, rig: Rig, points: Sequence[LevelPoint], folder: Path) -> int:
    """Fit, show and write. The rig file is replaced last, and only with --write."""
    lines = fit_sensors(points)
    old, path = read_rig_text(options.rig_path), options.rig_path
    text = calibrated_text(path, old, rig, lines)
    console.print(lines_table(rig, lines))
    write_atomically(folder / POINTS_FILE, points_csv(points))
    write_atomically(folder / FIGURES_FILE, figures_json(rig, lines))
    write_atomically(folder / NEW_RIG_FILE, text)
    diff = difference(old, text, str(path), str(folder / NEW_RIG_FILE))
    console.print(diff or f"{path} says this already", highlight=False, markup=False, soft_wrap=True)
    if options.write and diff:
        copy = replace_rig_file(path, text, datetime.now())
        console.print(f"{path} has the new values; the old file is kept as {copy}", highlight=False, soft_wrap=True)
    return 0


def _stopped(signal_name: str, folder: Path, points: Sequence[LevelPoint]) -> int:
    kept = f"points taken so far are in {folder / POINTS_FILE}; " if points else ""
    return complain(f"stopped by {signal_name}; {kept}no command was sent", exit_codes.BY_SIGNAL[signal_name])


def _make(out: Path) -> NewFolder:
    try:
        return NewFolder.make(out)
    except FileExistsError:
        raise RunFolderExistsError(f"{out} exists already; nothing is overwritten, name a new folder") from None
    except OSError as error:
        raise RunFolderError(f"cannot make the folder {out}: {error.strerror}") from None


def _bench_options(options: CalibrateOptions) -> doctor_command.DoctorOptions:
    return doctor_command.DoctorOptions(
        options.interface, options.channel, options.bitrate, config_dir=options.config_dir, rig=options.rig
    )
