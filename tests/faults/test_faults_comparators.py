"""The laws to compare with, through the wire: from empty tanks, and through a pump's loss that the diagnosis finds."""

import pytest

from tests.faults.faults_bench import fault, play, scenario_data

EMPTY = {"tanks": {"start_V": [0.0, 0.0]}, "parameter_spread": 0.03}
QUICK = {"start": {"rate_cm_s": 0.3, "settle_s": 25.0}}
LAWS = ("pi", "lqr", "governor", "mpc", "fuzzy_mpc", "feedback_linearisation")


@pytest.mark.long
@pytest.mark.parametrize("law", LAWS)
def test_a_law_to_compare_with_fills_empty_tanks_and_survives_a_loss(law: str) -> None:
    """The governor used to ask for an output below an empty tank, which tripped the run."""
    data = scenario_data(
        fault("pump_effectiveness", 5.0, 1, 0.5), duration_s=40.0, method="glr", emulator=EMPTY, rig=QUICK
    )
    data["control"] = {"law": law}
    run = play(data, seed=3)
    assert run.trips == [], run.told
    assert run.outcome.status == "complete"
    assert run.finding("pump_effectiveness 1").detected_s == pytest.approx(5.4, abs=0.5)
    begun, ended = run.at(0.0), run.at(39.0)
    for output in (0, 1):
        assert abs(begun.measured_V[output] - begun.reference_V[output]) < 0.25
        assert abs(ended.measured_V[output] - ended.reference_V[output]) < (0.5 if law == "pi" else 0.05)
    assert max(max(run.seen.column(f"h{tank}_cm")) for tank in (1, 2, 3, 4)) < 17.0
