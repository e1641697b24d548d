"""Faults of a scenario that a run does not reach."""

from __future__ import annotations

from hil.edge.config.scenario_file import Scenario


def late_faults(scenario: Scenario, duration_s: float | None = None) -> str:
    """A warning that names the faults which begin after the run's end, with their times; "" when there is none.

    duration_s : in place of the scenario's; None: its own.
    """
    end_s = scenario.scenario.length_s if duration_s is None else duration_s
    late = [fault for fault in scenario.fault if fault.at_s >= end_s]
    if not late:
        return ""
    named = ", ".join(f"{fault.kind}{_target(fault.target)} at {fault.at_s:g} s" for fault in late)
    return f"WARNING: the run ends at {end_s:g} s, before these faults begin: {named}"


def _target(target: int | str | None) -> str:
    return "" if target is None else f" {target}"
