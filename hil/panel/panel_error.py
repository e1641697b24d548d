"""Errors of the panel that the user can fix."""

from __future__ import annotations

from hil.core.errors import HilError


class PanelError(HilError):
    """The panel can't be started."""
