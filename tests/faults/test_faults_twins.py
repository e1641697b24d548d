"""Two like faults in the same step have both their names, and nothing else is reported."""

from __future__ import annotations

import pytest

from tests.faults.faults_bench import fault, first, play, scenario_data

AT_S = 20.0
REFERENCES = ((2.0, (0.2, 0.1)), (40.0, (-0.2, 0.2)))

TWINS = [
    ("outlet_block", (1, 2), 0.4),
    ("leak", (1, 2), 0.1),
    ("leak", (3, 4), 0.3),
    ("outlet_block", (3, 4), 0.1),
    ("valve_split", (1, 2), 0.45),
    ("outlet_block", (1, 2), 0.05),
    ("leak", (1, 2), 0.3),
    ("leak", (3, 4), 0.1),
    ("outlet_block", (3, 4), 0.4),
]


@pytest.mark.parametrize("twins", first(4, *TWINS), ids=str)
@pytest.mark.parametrize("seed", first(1, 1, 2))
def test_two_like_faults_at_once_have_both_names(twins: tuple[str, tuple[int, int], float], seed: int) -> None:
    """Two blocked lower outlets were two pumps with 1.5 of their gain, one of them then stuck on: a trip."""
    kind, targets, size = twins
    faults = [fault(kind, AT_S, target, size) for target in targets]
    data = scenario_data(
        *faults, duration_s=AT_S + 35.0, method="glr", references=REFERENCES, emulator={"parameter_spread": 0.03}
    )
    run = play(data, seed=seed)
    assert run.trips == [], run.told
    assert sorted(f"{one.kind} {one.target}" for one in run.findings) == [f"{kind} {target}" for target in targets]
    for one in run.findings:
        assert one.isolated_s is not None, run.told
        assert AT_S < one.isolated_s < AT_S + 5.0
        assert one.size == pytest.approx(size, abs=3.0 * (one.size_std or 0.0)), "the first size is known roughly"
