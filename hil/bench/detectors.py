"""The table of fault detectors: the names that `[diagnosis] method` in a scenario accepts.

A new built-in detector is a row here.

A maker gets the settings of rig and scenario and returns a `FaultDetector`. Installed packages add rows by entry points
of the group `fourtank_hil.detectors`.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

from hil.bench.choice_table import ChoiceTable, TableChoice
from hil.core.diagnosis.dedicated_observers import DedicatedObservers
from hil.core.diagnosis.detector import FaultDetector
from hil.core.diagnosis.ideal import IdealDetector, NoDetector, PumpFault
from hil.core.diagnosis.interacting_models import InteractingModels
from hil.core.diagnosis.sliding_mode import SlidingModeBank
from hil.edge.config.rig_file import CYCLES_S, Rig
from hil.edge.config.scenario_file import Fault, Scenario

MIN_NOISE_V = 0.0005
"""Smaller noise of a rig file counts as this: a filter needs some."""

DetectorMaker = Callable[[Rig, Scenario], FaultDetector]

IDEAL = "ideal"
"""The detector that is given the scenario's faults instead of finding them."""


def glr_detector(rig: Rig, scenario: Scenario) -> FaultDetector:  # noqa: ARG001 - it finds the faults itself
    """The likelihood-ratio bank."""
    from hil.core.diagnosis.glr.glr_detector import GlrDetector  # compiled code: a second that others need not wait for

    return GlrDetector(
        rig.tank_model,
        rig.lags_s,
        rig.signal_noise,
        range_V=rig.pump_path.drive_ranges,
        sensors=rig.level_sensors,
        uncertainty=rig.uncertainty.of_each,
    )


def ideal_detector(rig: Rig, scenario: Scenario) -> FaultDetector:  # noqa: ARG001 - it needs no model
    """Knows the scenario's pump faults and reports each `diagnosis.delay_s` late."""
    return IdealDetector(known_pump_faults(scenario), scenario.diagnosis.delay_s)


def dedicated_observers(rig: Rig, scenario: Scenario) -> FaultDetector:  # noqa: ARG001 - it finds the faults itself
    """One observer for each tank, fixed thresholds."""
    return DedicatedObservers(rig.tank_model)


def sliding_mode_bank(rig: Rig, scenario: Scenario) -> FaultDetector:  # noqa: ARG001 - it finds the faults itself
    """High-order sliding-mode observers, fixed thresholds."""
    return SlidingModeBank(rig.tank_model)


def interacting_models(rig: Rig, scenario: Scenario) -> FaultDetector:  # noqa: ARG001 - it finds the faults itself
    """A Kalman filter for each pair of pump gains."""
    readings = max(rig.control.period_s / CYCLES_S["levels"], 1.0)
    return InteractingModels(rig.tank_model, max(max(rig.signal_noise), MIN_NOISE_V) / sqrt(readings))


def no_detector(rig: Rig, scenario: Scenario) -> FaultDetector:  # noqa: ARG001 - it looks at nothing
    """Never reports anything."""
    return NoDetector()


DETECTORS: ChoiceTable[DetectorMaker] = ChoiceTable(
    "diagnosis.method",
    "fourtank_hil.detectors",
    TableChoice(
        "glr", "generalised likelihood ratios: finds, isolates and sizes faults from the readings", glr_detector
    ),
    TableChoice(IDEAL, "is given the scenario's pump faults and reports them exactly, delay_s late", ideal_detector),
    TableChoice("none", "reports nothing", no_detector),
    TableChoice("dedicated_observers", "one observer for each tank, fixed thresholds; pumps only", dedicated_observers),
    TableChoice("sliding_mode", "a bank of high-order sliding-mode observers; pumps only", sliding_mode_bank),
    TableChoice("interacting_models", "a Kalman filter for each pair of pump gains; pumps only", interacting_models),
)


def known_pump_faults(scenario: Scenario) -> tuple[PumpFault, ...]:
    """The faults of the scenario that the detector `ideal` knows."""
    return tuple(known for fault in scenario.fault if (known := _pump_fault(fault)) is not None)


def _pump_fault(fault: Fault) -> PumpFault | None:
    if fault.effectiveness is None:
        return None
    when = fault.course
    return PumpFault(
        when.at_s, int(fault.target), fault.effectiveness, when.until_s, when.ramp_s, when.period_s, when.duty
    )
