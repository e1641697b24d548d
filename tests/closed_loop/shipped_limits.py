"""Whether a run of a shipped scenario keeps the limits that the scenario ships with."""

from dataclasses import asdict

import hil
from hil.review.acceptance import verdicts


def assert_kept(kpi: hil.Kpi, name: str) -> None:
    scenario = hil.load(name).scenario
    faults = [fault.model_dump(mode="json") for fault in scenario.fault]
    found = verdicts(scenario.accept, asdict(kpi), faults)
    assert found
    assert kpi.status == "complete"
    assert [one for one in found if not one.is_passed] == []
