"""How a run ended, from its record: for a panel that lost the connection."""

from __future__ import annotations

from pathlib import Path

from hil.edge.record.record_errors import RunFolderError
from hil.edge.record.run_folder import RunFolder


def end_of_run(folder: Path) -> str:
    """Status and reason in words. Call it for a run whose process is gone. "" when there is no record to read."""
    try:
        manifest = RunFolder.open(folder).manifest()
    except (OSError, RunFolderError):
        return ""
    if manifest.status == "running":
        return "its process ended before the record was closed; the pump node goes to 0 V by itself within 250 ms"
    return f"{manifest.status} ({manifest.reason})" if manifest.reason else str(manifest.status)
