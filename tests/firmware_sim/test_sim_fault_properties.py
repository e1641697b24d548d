"""Whatever goes wrong, in any mixture: determinism, limits, and no water made or lost."""

import random
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_sim.faults.catalogue import KINDS
from firmware_sim.frames import FRAME_IDS
from firmware_sim.rig import Rig
from hil.edge.config.scenario_file import FaultKind
from tests.firmware_sim.fault_bench import START, as_bytes, fault
from tests.firmware_sim.sim_bench import MS, SECOND, command, shipped

FRAMES = [*FRAME_IDS, "all"]
NODES = ["pump", "level"]
SHARE = (0.0, 1.0)
PARTS = {
    "pump_effectiveness": ([1, 2], SHARE),
    "pump_dead": ([1, 2], None),
    "pump_stuck_on": ([1, 2], (0.0, 10.0)),
    "pump_lag": ([1, 2], (0.0, 60.0)),
    "valve_split": ([1, 2], SHARE),
    "reservoir_low": ([None, 0], None),
    "leak": ([1, 2, 3, 4], (0.0, 10.0)),
    "outlet_block": ([1, 2, 3, 4], SHARE),
    "sensor_bias": ([1, 2, 3, 4], (-10.24, 10.24)),
    "sensor_drift": ([1, 2, 3, 4], (-10.0, 10.0)),
    "sensor_noise": ([1, 2, 3, 4], (0.0, 10.24)),
    "sensor_stuck": ([1, 2, 3, 4], None),
    "sensor_open": ([1, 2, 3, 4], None),
    "sensor_garbage": ([1, 2, 3, 4], None),
    "frame_loss": (FRAMES, SHARE),
    "frame_burst": (FRAMES, (1, 100)),
    "frame_delay": (FRAMES, (0.0, 2.0)),
    "frame_duplicate": (FRAMES, None),
    "frame_reorder": (FRAMES, None),
    "frame_corrupt": (FRAMES, SHARE),
    "counter_stuck": (FRAMES, None),
    "wrong_length": (FRAMES, (0, 8)),
    "wrong_id": (FRAMES, (0, 0x7FF)),
    "extended_id": (FRAMES, None),
    "remote_frame": (FRAMES, None),
    "babble": ([None, "foreign", "top"], (0.1, 4000.0)),
    "foreign_command": ([None, "PumpCommand"], (0.0, 10.0)),
    "error_frames": ([None, "all"], (0.1, 500.0)),
    "bus_off": ([None, "all"], None),
    "node_reboot": (NODES, None),
    "node_silent": (NODES, None),
    "heartbeat_stop": (NODES, None),
    "clock_jump": (NODES, (-1e7, 1e7)),
}


@st.composite
def any_fault(draw, kinds=tuple(PARTS)):
    kind = draw(st.sampled_from(kinds))
    targets, limits = PARTS[kind]
    value = None
    if limits is not None:
        numbers = st.integers if isinstance(limits[0], int) else st.floats
        value = draw(numbers(*limits))
    at_s = draw(st.floats(0.0, 3.0))
    until_s = draw(st.none() | st.floats(at_s + 0.001, 5.0))
    return fault(kind, draw(st.sampled_from(targets)), value, at_s, until_s)


def faults_of_every_kind(seed):
    """One fault of each kind at a time of its own."""
    chance = random.Random(seed)  # noqa: S311 - a mixture, not secrets
    made = []
    for kind, (targets, limits) in PARTS.items():
        at_s = chance.uniform(0.0, 2.0)
        value = None if limits is None else chance.uniform(*limits) if isinstance(limits[0], float) else limits[1]
        until_s = at_s + (0.05 if kind in ("bus_off", "babble", "node_silent") else chance.uniform(0.1, 1.0))
        made.append(fault(kind, chance.choice(targets), value, at_s, until_s))
    return tuple(made)


def test_every_kind_is_in_the_mixture():
    assert PARTS.keys() == KINDS.keys()


def driven(rig, until_s, cuts=None, chance=None):
    frames, moments = [], []
    for step in range(int(until_s * 10)):
        at_ns = START + step * 100 * MS
        if cuts and at_ns > rig.now_ns:
            moments = sorted(chance.randrange(rig.now_ns, at_ns + 1) for _ in range(cuts))
        for part_ns in moments:
            frames += rig.advance(part_ns)
            rig.truth()
        frames += rig.advance(at_ns)
        rig.receive(command(4.0, 3.0, counter=step % 16), at_ns)
    return frames


@pytest.mark.parametrize("seed", range(4))
def test_results_do_not_depend_on_how_time_is_cut(seed):
    aged = shipped().model_copy(
        update={
            "parameter_spread": 0.03,
            "tanks": shipped().tanks.model_copy(update={"turbulence_cm3_sqrt_s": 1.0}),
            "pumps": shipped().pumps.model_copy(update={"wear_per_h": 5.0}),
        }
    )
    faults, chance = faults_of_every_kind(seed), random.Random(seed)  # noqa: S311 - cuts, not secrets
    whole, cut = Rig(aged, faults, seed, 0), Rig(aged, faults, seed, 0)
    expected, frames = driven(whole, 4.0), driven(cut, 4.0, 7, chance)
    assert as_bytes(frames) == as_bytes(expected)
    assert cut.truth() == whole.truth()
    other = Rig(aged, faults, seed + 100, 0)
    assert as_bytes(driven(other, 4.0)) != as_bytes(expected)


def test_a_fault_s_randomness_does_not_depend_on_its_neighbours():
    noisy = fault("sensor_noise", 1, 0.5)
    alone = driven(Rig(shipped(), (noisy,), 3, 0), 2.0)
    beside = driven(Rig(shipped(), (noisy, fault("frame_loss", "PumpStatus", 0.5)), 3, 0), 2.0)
    lower = [f for f in as_bytes(alone) if f[1] == 0x182]
    assert lower == [f for f in as_bytes(beside) if f[1] == 0x182]


@settings(max_examples=60, deadline=None)
@given(st.lists(any_fault(), max_size=8), st.integers(0, 2**32 - 1), st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_any_list_of_faults_keeps_to_the_limits_and_to_the_water(faults, seed, v1, v2):
    rig = Rig(shipped(), tuple(faults), seed, 0)
    start_cm3 = rig._tanks.contents_cm3
    for step in range(60):
        at_ns = START + step * 100 * MS
        for frame in rig.advance(at_ns):
            assert len(frame.data) <= 8
            assert 0.0 <= frame.timestamp <= at_ns / SECOND
        rig.receive(command(v1, v2, counter=step % 16), at_ns)
        truth = rig.truth()
        assert all(0.0 <= level <= 20.0 for level in truth.levels_cm)
        assert all(0.0 <= volt <= 10.0 for volt in truth.applied_V)
    tanks = rig._tanks
    change_cm3 = tanks.contents_cm3 - start_cm3
    assert abs(tanks.pumped_cm3 + tanks.stirred_cm3 - tanks.drained_cm3 - tanks.spilled_cm3 - change_cm3) < 1e-6


def test_the_controller_s_scenario_file_knows_the_same_kinds():
    assert set(get_args(FaultKind)) == set(KINDS)
