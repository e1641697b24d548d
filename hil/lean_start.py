"""Keeps python-can from loading asammdf, which brings pandas, polars and their threads into every process.

python-can loads it at its own import wherever it is installed, for its reader and writer of MF4 files, which this
project uses for logs that are replayed only. A controller would start a second later, with threads that its loop does
not need.
"""

from __future__ import annotations

import sys
from types import ModuleType

PACKAGE = "asammdf"
LOADER = "can.io.mf4"


class _NotForPythonCan:
    """A finder of modules that refuses asammdf to python-can, and only to it."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: ModuleType | None = None) -> None:
        """None, so that the other finders look; ModuleNotFoundError, which python-can expects, to python-can."""
        del path, target
        if name == PACKAGE and getattr(getattr(sys.modules.get(LOADER), "__spec__", None), "_initializing", False):
            raise ModuleNotFoundError(f"{PACKAGE} is not loaded by {LOADER}", name=name)


def keep_asammdf_out() -> None:
    """For this process. Other imports of asammdf are not touched."""
    if not any(finder is _NotForPythonCan for finder in sys.meta_path):
        sys.meta_path.insert(0, _NotForPythonCan)
