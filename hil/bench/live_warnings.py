"""Warnings before a scenario moves real pumps, for settings that are valid but risky."""

from __future__ import annotations

from hil.bench.assembly import Bench
from hil.bench.detectors import IDEAL, known_pump_faults
from hil.core.types import Event, Severity


def live_warnings(bench: Bench) -> tuple[Event, ...]:
    """Warnings of a live run, for the terminal before arming and for the record.

    The detector `ideal` finds nothing: it believes the scenario's faults at their times. On a bus where nobody plays
    them, the law then divides the commands by an effectiveness that no pump has.
    """
    if bench.detector is not None or bench.scenario.diagnosis.method != IDEAL:
        return ()
    faults = known_pump_faults(bench.scenario)
    if not faults:
        return ()
    listed = ", ".join(f"pump {fault.target} at {fault.effectiveness:g} from {fault.at_s:g} s" for fault in faults)
    text = (
        f"WARNING: diagnosis.method = 'ideal' does not look at the rig: it believes the scenario's faults ({listed}), "
        "and the commands follow. Right only on an emulator that plays this scenario; on a rig use method = 'glr'"
    )
    return (Event(Severity.WARNING, "ideal_live", text),)
