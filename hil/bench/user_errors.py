"""Errors that the user can fix: shown as one line, without a traceback."""

from firmware_sim.settings import SettingsError as EmulatorSettingsError
from hil.core.errors import HilError

USER_ERRORS = (HilError, EmulatorSettingsError)
"""Of both programs: a scenario is also read by the emulator, which knows nothing of `hil`."""
