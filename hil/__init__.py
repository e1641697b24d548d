"""Fault-tolerant control of the four-tank laboratory process over CAN: the public face.

This list is the stable interface; every module behind it may move.

    load, simulate, run, campaign, design       the functions: read and check, lockstep, real time, many runs, gains
    Bench                                       what `load` returns: scenario, rig and wire contract, checked
    open_run, runs                              recorded runs as tables: one of them, and the list of those in a folder
    RunResult, CampaignResult, DesignFigures    what the functions return
    RecordedRun                                 what `open_run` returns
    Kpi, Finding, LoggedEvent, Row              key figures, an alarm, an event, one run of a campaign
    GainDesign, Gains, LinearModel              the protocol of a design, what it returns, what it is given
    FaultDetector, Measurement, Estimate        the protocol of a fault detector and what it is given
    Diagnosis, Alarm                            what a fault detector returns
    ControlLaw, LawInputs, LawRequest           the protocol of a control law, what it is given and what it returns
    Authority, FeedbackRecord                   who decided the last command; what a state feedback has recorded
    LawSetup, LawOptions                        what a law is made from: rig and scenario, and settings of its own
    RealTime                                    what to ask the operating system for in `run`
    HilError                                    base class of all errors that the user can fix
    SettingsError, DesignError, BusError        a settings file; a design that can't be had; a bus that can't be opened
    RunFolderError, RealTimeError               a run folder; a real-time request that no system can meet
    __version__                                 the version

Names are imported when they are first used, so that `hil --version` and the recorder's process start quickly. Reasons:
docs/decisions/0017-public-face.md.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hil.lean_start import keep_asammdf_out
from hil.version import __version__ as __version__

keep_asammdf_out()

if TYPE_CHECKING:
    from hil.bench.api import campaign, design, load, run, simulate
    from hil.bench.assembly import Bench
    from hil.bench.design_figures import DesignFigures
    from hil.bench.law_setup import LawOptions, LawSetup
    from hil.bench.results import CampaignResult, RunResult
    from hil.campaigns.row import Row
    from hil.core.control_law import Authority, ControlLaw, FeedbackRecord, LawInputs, LawRequest
    from hil.core.diagnosis.detector import FaultDetector
    from hil.core.eigenstructure import DesignError
    from hil.core.errors import HilError
    from hil.core.estimator import Estimate
    from hil.core.gain_design import GainDesign, Gains
    from hil.core.tanks import LinearModel
    from hil.core.types import Alarm, Diagnosis, Measurement
    from hil.data.open_run import open_run, runs
    from hil.data.recorded_run import RecordedRun
    from hil.edge.can.bus import BusError
    from hil.edge.config.settings_file import SettingsError
    from hil.edge.host.realtime import RealTime, RealTimeError
    from hil.edge.record.record_errors import RunFolderError
    from hil.review.alarms import Finding
    from hil.review.kpi import Kpi
    from hil.review.ticks import LoggedEvent

__all__ = [
    "Alarm",
    "Authority",
    "Bench",
    "BusError",
    "CampaignResult",
    "ControlLaw",
    "DesignError",
    "DesignFigures",
    "Diagnosis",
    "Estimate",
    "FaultDetector",
    "FeedbackRecord",
    "Finding",
    "GainDesign",
    "Gains",
    "HilError",
    "Kpi",
    "LawInputs",
    "LawOptions",
    "LawRequest",
    "LawSetup",
    "LinearModel",
    "LoggedEvent",
    "Measurement",
    "RealTime",
    "RealTimeError",
    "RecordedRun",
    "Row",
    "RunFolderError",
    "RunResult",
    "SettingsError",
    "campaign",
    "design",
    "load",
    "open_run",
    "run",
    "runs",
    "simulate",
]

_HOME = {
    "hil.bench.api": ("campaign", "design", "load", "run", "simulate"),
    "hil.bench.assembly": ("Bench",),
    "hil.bench.design_figures": ("DesignFigures",),
    "hil.bench.law_setup": ("LawOptions", "LawSetup"),
    "hil.bench.results": ("CampaignResult", "RunResult"),
    "hil.campaigns.row": ("Row",),
    "hil.core.control_law": ("Authority", "ControlLaw", "FeedbackRecord", "LawInputs", "LawRequest"),
    "hil.core.gain_design": ("GainDesign", "Gains"),
    "hil.core.diagnosis.detector": ("FaultDetector",),
    "hil.core.eigenstructure": ("DesignError",),
    "hil.core.errors": ("HilError",),
    "hil.core.estimator": ("Estimate",),
    "hil.core.tanks": ("LinearModel",),
    "hil.core.types": ("Alarm", "Diagnosis", "Measurement"),
    "hil.data.open_run": ("open_run", "runs"),
    "hil.data.recorded_run": ("RecordedRun",),
    "hil.edge.can.bus": ("BusError",),
    "hil.edge.config.settings_file": ("SettingsError",),
    "hil.edge.host.realtime": ("RealTime", "RealTimeError"),
    "hil.edge.record.record_errors": ("RunFolderError",),
    "hil.review.alarms": ("Finding",),
    "hil.review.kpi": ("Kpi",),
    "hil.review.ticks": ("LoggedEvent",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'hil' has no attribute {name!r}; its public names are in hil.__all__")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
