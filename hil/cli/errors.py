"""What is the user's to mend: shown as one line, without a traceback."""

from firmware_sim.settings import SettingsError as EmulatorSettingsError
from hil.core.eigenstructure import DesignError
from hil.edge.bus import BusError
from hil.edge.realtime import RealTimeError
from hil.edge.run_folder import RunFolderError
from hil.edge.settings import SettingsError

USER_ERRORS = (SettingsError, EmulatorSettingsError, DesignError, BusError, RunFolderError, RealTimeError)
