"""Errors of a run folder and of other files that are written as the result of a command."""

from __future__ import annotations

from hil.core.errors import HilError


class RunFolderError(HilError):
    """A run folder cannot be made, read or understood."""


class IncompleteRecordError(RunFolderError):
    """Something was done, but what came of it can't be written completely; the message names the file and the cause.

    status, reason : of the run, when one has ended.
    """

    status: str = "complete"
    reason: str = ""


class RunFolderExistsError(RunFolderError, FileExistsError):
    """The path exists already. Nothing was written."""


class NoRunFolderError(RunFolderError, FileNotFoundError):
    """There is no run folder at the path."""
