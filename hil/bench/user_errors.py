"""What is the user's to mend: shown as one line, without a traceback."""

from firmware_sim.settings import SettingsError as EmulatorSettingsError
from hil.core.eigenstructure import DesignError
from hil.edge.can.bus import BusError
from hil.edge.config.settings_file import SettingsError
from hil.edge.host.realtime import RealTimeError
from hil.edge.record.run_folder import RunFolderError

USER_ERRORS = (SettingsError, EmulatorSettingsError, DesignError, BusError, RunFolderError, RealTimeError)
