"""What the maker of a control law gets: the settings of the rig, and options of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hil.core.gain_design import GainDesign
from hil.core.pumps import PumpPath
from hil.core.tanks import TankModel
from hil.core.types import Pair
from hil.edge.config.rig_file import Rig
from hil.edge.config.scenario_file import Scenario
from hil.edge.config.settings_file import Section


class LawOptions(Section):
    """Base of the settings of a law: unknown keys are errors, values are never made from text."""


@dataclass(frozen=True)
class LawSetup:
    """What a law is made for: the settings of rig and scenario, and what most laws need of them.

    make_design : makes the scenario's design. Raises SettingsError when the rig can't have it.
    """

    rig: Rig
    scenario: Scenario
    make_design: Callable[[], GainDesign]

    @property
    def model(self) -> TankModel:
        """The tanks, with pump gains in cm³/(V s) of the drives."""
        return self.rig.tank_model

    @property
    def pumps(self) -> PumpPath:
        """Between drives and voltages; `max_drives` are (2,) the largest drives."""
        return self.rig.pump_path

    @property
    def lags_s(self) -> Pair:
        """(2,) time constants of the pumps, s."""
        return self.rig.lags_s

    @property
    def period_s(self) -> float:
        """The control period, s."""
        return self.rig.control.period_s

    @property
    def operating_drives(self) -> Pair:
        """(2,) drives at the rig's operating point, V."""
        return self.rig.operating_drives
