"""`hil.open_run` and `hil.runs`: recorded runs for scripts and notebooks."""

from __future__ import annotations

from dataclasses import fields
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.data.recorded_run import RecordedRun
from hil.edge.record.json_text import whole_text
from hil.edge.record.run_folder import RunFolder
from hil.run_index.index_file import index_of
from hil.run_index.indexed_run import IndexedRun

if TYPE_CHECKING:
    from pandas import DataFrame


def open_run(path: str | Path) -> RecordedRun:
    """Open a recorded run; its tables are read when they are first used.

    Parameters
    ----------
    path : str or path
        A run folder, whatever made it: `hil run`, `hil simulate`, a phase of an experiment. The run may still go on, or
        may have been interrupted; a half last line of a file is left out.

    Returns
    -------
    RecordedRun
        `ticks`, `frames`, `signals`, `events` and `alarms` as pandas data frames with units; `kpi` and `config` as
        series; `polars` for the same as polars data frames.

    Raises
    ------
    RunFolderError
        When there is no run folder, or its `run.json` can't be understood. A table that can't be read raises it, too,
        when it is first used.

    Examples
    --------
    >>> import hil, tempfile
    >>> folder = tempfile.mkdtemp() + "/run"
    >>> result = hil.simulate("paper", duration_s=3.0, out=folder, rerun=False)
    >>> run = hil.open_run(folder)
    >>> run.status, run.ticks["mode"].iloc[0].item(), run.ticks.attrs["units"]["h1_V"]
    ('complete', 2, 'V')

    """
    return RecordedRun(RunFolder.open(Path(path)))


def runs(folder: str | Path = "runs") -> DataFrame:
    """List the recorded runs below a folder, the oldest first.

    Parameters
    ----------
    folder : str or path
        Folder of run folders; `runs` by default, where `hil run` and `hil simulate` put them.

    Returns
    -------
    pandas.DataFrame
        A row for each run, by its name: scenario, status, reason, mode, duration_s, rig, law, design, detector, seed,
        alarms, trips, size_bytes, started, `path`, which is what `open_run` takes, and for each window that any of the
        runs has `iae_Vs.WINDOW[0]` and `[1]`. A folder that can't be read has the status "unreadable" and a `problem`.
        The list comes from an index in the folder, which is brought up to date.

    Raises
    ------
    RunFolderError
        When there is no such folder.

    Examples
    --------
    >>> import hil, tempfile
    >>> folder = tempfile.mkdtemp()
    >>> result = hil.simulate("paper", duration_s=3.0, out=folder + "/first", rerun=False)
    >>> hil.runs(folder).status.to_dict()
    {'first': 'complete'}

    """
    import pandas as pd

    root = Path(folder)
    rows = [_row(one, root) for one in index_of(root)]
    columns = list(dict.fromkeys(name for row in rows for name in row)) or [field.name for field in fields(IndexedRun)]
    table = pd.DataFrame(rows, columns=columns).set_index("name")
    return table.astype({"started": "datetime64[us, UTC]"}) if len(table) else table


def _row(one: IndexedRun, root: Path) -> dict[str, Any]:
    """The row of a run: the fields of the index, the IAE of each window, and its path."""
    row = {name: value for name, value in one.as_dict().items() if name not in ("figures", "started_utc")}
    pairs = one.figures.get("iae_Vs") or {}
    iae = {f"iae_Vs.{window}[{output}]": pairs[window][output] for window in pairs for output in (0, 1)}
    return {
        **row,
        "name": whole_text(one.name),
        "started": datetime.fromisoformat(one.started_utc) if one.started_utc else None,
        "path": root / one.name,
        **iae,
    }
