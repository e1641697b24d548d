"""Case 60: any two faults of cases 1 to 44 at any time. Whatever happens, no invariant is broken."""

import os
from collections.abc import Sequence
from typing import Any

import pytest

from hil.bench.campaign_case import run_case
from hil.campaigns import cases as listing
from hil.campaigns.row import INVARIANTS, Row
from hil.campaigns.spec import Spec
from hil.core.types import Pair
from hil.edge.config.settings_file import validated
from tests.faults.faults_bench import CONFIG, MOVING, fault, play, scenario_data

FRAMES = ["PumpStatus", "LowerLevels", "UpperLevels", "PumpHeartbeat", "LevelHeartbeat", "PumpCommand", "all"]
TANKS, PUMPS, NODES = [1, 2, 3, 4], [1, 2], ["pump", "level"]


def row(kind: str, targets: Sequence[int | str] = (0,), value_range: Pair | None = None, **also: int) -> dict[str, Any]:
    drawn = {"kind": kind, "targets": list(targets), "also": also}
    return drawn if value_range is None else {**drawn, "value_range": list(value_range)}


POOL = [
    row("frame_loss", FRAMES, (0.01, 1.0)),
    *(row("frame_burst", FRAMES, None, value=count) for count in (1, 3, 5, 15, 16, 32)),
    row("frame_delay", FRAMES, (0.01, 1.0)),
    row("frame_duplicate", FRAMES),
    row("frame_reorder", FRAMES),
    row("frame_corrupt", FRAMES, (0.01, 1.0)),
    row("counter_stuck", FRAMES),
    row("wrong_length", FRAMES),
    row("wrong_id", FRAMES),
    row("extended_id", FRAMES),
    row("remote_frame", FRAMES),
    row("babble", ["foreign"], (10.0, 4000.0)),
    row("babble", ["top"], (10.0, 4000.0)),
    row("foreign_command", [0], (0.0, 10.0)),
    row("error_frames", [0], (1.0, 100.0)),
    row("bus_off"),
    row("node_reboot", NODES),
    row("node_silent", NODES),
    row("heartbeat_stop", NODES),
    *(row("sensor_stuck", TANKS) for _ in range(3)),
    row("sensor_drift", TANKS, (-0.1, 0.1)),
    row("sensor_drift", TANKS, (-0.02, 0.02)),
    row("sensor_bias", TANKS, (-0.5, 0.5)),
    row("sensor_bias", TANKS, (-5.0, 5.0)),
    row("sensor_bias", TANKS, (-10.0, 10.0)),
    row("sensor_noise", TANKS, (0.01, 2.0)),
    *(row("sensor_open", TANKS) for _ in range(2)),
    *(row("sensor_garbage", TANKS) for _ in range(2)),
    *(row("pump_effectiveness", PUMPS, (0.0, 0.95)) for _ in range(3)),
    *(row("pump_dead", PUMPS) for _ in range(2)),
    *(row("pump_stuck_on", PUMPS, (0.0, 10.0)) for _ in range(3)),
    row("pump_lag", PUMPS, (0.3, 10.0)),
    *(row("leak", TANKS, (0.05, 3.0)) for _ in range(3)),
    *(row("outlet_block", TANKS, (0.1, 1.0)) for _ in range(3)),
    *(row("valve_split", PUMPS, (0.2, 0.98)) for _ in range(3)),
    *(row("reservoir_low") for _ in range(2)),
]
STOPS = {"safety": {"lost_lower_level": "stop"}}
RUN_S = 45.0
PAIRS = 2000
SHARDS = 20
EVERY_DAY = (0, 7, 14)
"""The shards of a hundred that the long tests run; the others need `FOURTANK_ALL_PAIRS=1`."""
FIRST_SEED = 1


def drawn(seeds: range) -> tuple[listing.Case, ...]:
    """The cases of these seeds: two faults each, with onsets of their own."""
    spec = {
        "campaign": {"name": "pairs", "scenarios": ["moving"], "first_seed": seeds[0], "seeds": len(seeds)},
        "emulator": {"parameter_spread": 0.03},
        "pairs": {"onset_s": [1.0, 35.0], "pool": POOL},
    }
    base = scenario_data(duration_s=RUN_S, method="glr", references=MOVING)
    base.pop("fault")
    return listing.expand(validated(Spec, spec, "pairs"), [base])


def breaks(outcome: Row, case: listing.Case) -> list[str]:
    """What the run broke; without rate and latch if an unknown sender also commands the node."""
    not_ours = ("rate_broken", "latch_broken", "not_at_rest")
    has_foreign_commands = any(fault["kind"] == "foreign_command" for fault in case.faults)
    return [name for name in outcome.breaks if not (has_foreign_commands and name in not_ours)]


def assert_unbroken(seeds: range) -> None:
    """Run them all; then name every seed that broke something."""
    assert set(INVARIANTS) >= {"overflow", "dry_run", "applied_out_of_range", "rate_broken", "latch_broken"}
    failed = []
    for case in drawn(seeds):
        outcome = run_case(case, CONFIG)
        broken = breaks(outcome, case)
        if broken:
            failed.append(f"seed {case.seed}: {broken} {outcome.broken}; {outcome.reason}; {list(case.faults)}")
    assert not failed, "\n".join(failed)


@pytest.mark.parametrize("seeds", [range(1_000_000 - 10, 1_000_000)], ids=["10 pairs"])
def test_case_60_pairs_sample(seeds: range) -> None:
    """Ten random pairs of faults: the invariants hold."""
    assert_unbroken(seeds)


def test_case_60_a_weak_pump_at_rest_does_not_prove_that_water_comes() -> None:
    """Both pumps lose their water; one is taken for weak and at once hardly driven, while the dead one stands by."""
    assert_unbroken(range(1499, 1500))


def test_case_60_what_no_sensor_shows_is_for_the_rigs_owner() -> None:
    """A lower tank's outlet blocked after its sensor is lost: with `lost_lower_level = "stop"` the pumps are off."""
    faults = fault("sensor_garbage", 13.3, 1), fault("outlet_block", 26.3, 1, 0.9956)
    run = play(scenario_data(*faults, duration_s=RUN_S, method="glr", references=MOVING, rig=STOPS), seed=22772)
    assert (run.outcome.status, run.outcome.reason) == ("stopped", "sensors_lost")
    assert run.outcome.t_s < 20.0
    assert run.emulator.truth().spilled_cm3 == 0.0


@pytest.mark.long
@pytest.mark.parametrize("shard", range(SHARDS) if os.environ.get("FOURTANK_ALL_PAIRS") else EVERY_DAY)
def test_case_60_pairs(shard: int) -> None:
    """Random pairs of faults, a shard of a hundred each: the invariants hold. All two thousand: see `EVERY_DAY`."""
    size = PAIRS // SHARDS
    assert_unbroken(range(FIRST_SEED + shard * size, FIRST_SEED + (shard + 1) * size))
