"""From an identification to files: the identified rig file, `identification.json`, report and recording.

`write_result` writes them into a folder and leaves the old rig file alone; `replace_rig` puts the identified one in its
place if it predicts better.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from hil.bench.design_figures import design_figures
from hil.bench.designs import DESIGNS
from hil.core.errors import HilError
from hil.core.identification.improvement import MIN_IMPROVEMENT, Improvement, improvement
from hil.core.identification.result import Identification
from hil.edge.config.identified_rig import IdentifiedRig, identified_rig
from hil.edge.config.rig_file import Rig, load_rig
from hil.edge.config.rig_file_writer import read_rig_text, replace_rig_file
from hil.edge.config.settings_file import SettingsError
from hil.edge.record.file_writing import write_atomically, writing
from hil.review.identification_json import as_json
from hil.review.identification_recording import card_text, write_recording
from hil.review.identification_report import ReportFacts, render

RIG_NAME, JSON_NAME = "identified.toml", "identification.json"
REPORT_NAME, RECORDING_NAME = "report.html", "identification.rrd"


class NotReplacedError(HilError):
    """The old rig file stays as it is; the message says why."""


@dataclass(frozen=True)
class WrittenResult:
    """Where the files are. rig : None if nothing could be identified. diff : of the rig files.

    notes : what else has changed in the rig file. trouble : why no run can use it; "" if one can.
    """

    folder: Path
    rig: Path | None
    json: Path
    report: Path
    recording: Path | None
    diff: str
    notes: tuple[str, ...]
    trouble: str
    refusal: str
    improvement: Improvement


def write_result(
    identification: Identification,
    rig_path: Path,
    out: Path,
    *,
    duration_s: float | None = None,
    rerun: bool = True,
) -> WrittenResult:
    """Write the result into the folder `out`, which is there. The rig file that it started from is left alone.

    duration_s : of the experiment; None: of all records together. rerun : whether to write a recording. Raises
    SettingsError when the old file can't be read, IncompleteRecordError when a file can't be written.
    """
    found = None if identification.refusal else identified_rig(identification, read_rig_text(rig_path), RIG_NAME)
    notes, trouble = _said(found)
    if duration_s is None:
        duration_s = sum(float(one.time_s[-1] - one.time_s[0]) for one in identification.predictions)
    diff = "" if found is None else found.diff(rig_path.name, RIG_NAME)
    paths = WrittenResult(
        folder=out,
        rig=None if found is None else out / RIG_NAME,
        json=out / JSON_NAME,
        report=out / REPORT_NAME,
        recording=out / RECORDING_NAME if rerun and identification.predictions else None,
        diff=diff,
        notes=notes,
        trouble=trouble,
        refusal=identification.refusal,
        improvement=improvement(identification),
    )
    if found is not None:
        write_atomically(out / RIG_NAME, found.text)
    else:
        with writing(out / RIG_NAME):  # of an earlier identification into the same folder
            (out / RIG_NAME).unlink(missing_ok=True)
            (out / RECORDING_NAME).unlink(missing_ok=True)
    text = as_json(identification, duration_s, notes, trouble)
    write_atomically(paths.json, text.encode("utf-8", "backslashreplace"))  # names of files may be no UTF-8
    operating_V = load_rig(rig_path).control.operating_point_V
    facts = ReportFacts(rig_path.name, duration_s, operating_V, diff, notes, trouble)
    write_atomically(paths.report, render(identification, facts).encode("utf-8", "replace"))
    if paths.recording is not None:
        lines = [paths.improvement.sentence, *(one.text for one in identification.null_directions), *notes]
        write_recording(paths.recording, identification, card_text(f"Identification of {rig_path.name}", lines))
    return paths


def replace_rig(result: WrittenResult, rig_path: Path, now: datetime) -> Path:
    """Replace the rig file by the identified one. Returns the path of the dated copy of the old file.

    Raises NotReplacedError when the identified file can't be used, or does not predict the held-out record better by
    10 %; IncompleteRecordError when it can't be written. The rig file is then as it was.
    """
    if result.rig is None:
        raise NotReplacedError(f"{rig_path} stays: {result.refusal}")
    if result.trouble:
        raise NotReplacedError(f"{rig_path} stays, because no run could use the identified file: {result.trouble}")
    if not result.diff:
        raise NotReplacedError(f"{rig_path} stays: the identified file says the same")
    if not result.improvement.is_enough:
        raise NotReplacedError(
            f"{rig_path} stays: it is replaced only by a file that predicts the held-out record better by "
            f"{MIN_IMPROVEMENT:.0%} or more. {result.improvement.sentence}"
        )
    return replace_rig_file(rig_path, read_rig_text(result.rig), now)


def _said(found: IdentifiedRig | None) -> tuple[tuple[str, ...], str]:
    if found is None:
        return (), ""
    if found.rig is None:
        return found.notes, found.trouble
    return (*found.notes, *_missing_designs(found.rig)), ""


def _missing_designs(rig: Rig) -> list[str]:
    """A sentence for each design that the identified rig can't have."""
    said = []
    for name in DESIGNS.names:
        try:
            design_figures(rig, name, RIG_NAME)
        except SettingsError as error:
            said.append(f"The design {name} can't be had on this rig: {error}")
    return said
