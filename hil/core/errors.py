"""The base class of all errors that a user of the bench can fix."""

from __future__ import annotations


class HilError(Exception):
    """An error that the user can fix. The message is one line: file or object, key, value, and what is allowed.

    The command line shows it without a traceback and ends with exit code 2. Each subclass is also the fitting builtin
    error where there is one (`SettingsError` is a ValueError, `NoRunFolderError` a FileNotFoundError).
    """
