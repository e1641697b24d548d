"""Whatever goes wrong, in any mixture: determinism, limits, and no water made or lost."""

import random
from collections.abc import Callable
from typing import Any

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from firmware_sim.faults.base import FaultTable
from firmware_sim.faults.catalogue import KINDS
from firmware_sim.rig import Rig
from firmware_sim.setting_types import accepts
from hil.core.fault_kinds import FaultKind
from tests.firmware_sim.fault_bench import START, as_bytes, fault
from tests.firmware_sim.sim_bench import MS, SECOND, command, shipped

NARROWER = {"frame_burst": (1, 100), "frame_delay": (0.0, 2.0), "error_frames": (0.1, 500.0)}
"""Values that leave something to see within some seconds."""


def parts_of(kind: str, table: type[FaultTable]) -> tuple[list[int | str | None], tuple[float, float] | None]:
    """Targets of a kind, None where it may be left out, and the limits of its value, None if it has none."""
    fields = table.model_fields
    targets = [*([] if fields["target"].is_required() else [None]), *accepts(fields["target"]).choices]
    limits = accepts(fields["value"]).numbers if "value" in fields else None
    return targets, NARROWER.get(kind, limits)


PARTS = {kind: parts_of(kind, table) for kind, table in KINDS.items()}


@st.composite
def any_fault(draw: st.DrawFn, kinds: tuple[str, ...] = tuple(PARTS)) -> Any:
    kind = draw(st.sampled_from(kinds))
    targets, limits = PARTS[kind]
    value = None
    if limits is not None:
        numbers: Callable[..., st.SearchStrategy[float]] = st.integers if isinstance(limits[0], int) else st.floats
        value = draw(numbers(*limits))
    at_s = draw(st.floats(0.0, 3.0))
    until_s = draw(st.none() | st.floats(at_s + 0.001, 5.0))
    more = {"ramp_s": draw(st.floats(0.0, 4.0))} if KINDS[kind].grows_from and draw(st.booleans()) else {}
    if draw(st.booleans()):
        more |= {"period_s": draw(st.floats(0.05, 2.0)), "duty": draw(st.floats(0.001, 0.999))}
    return fault(kind, draw(st.sampled_from(targets)), value, at_s, until_s, **more)


def faults_of_every_kind(seed: int) -> tuple[Any, ...]:
    """One fault of each kind at a time of its own."""
    chance = random.Random(seed)  # noqa: S311 - a mixture, not secrets
    made = []
    for kind, (targets, limits) in PARTS.items():
        at_s = chance.uniform(0.0, 2.0)
        value = None if limits is None else chance.uniform(*limits) if isinstance(limits[0], float) else limits[1]
        until_s = at_s + (0.05 if kind in ("bus_off", "babble", "node_silent") else chance.uniform(0.1, 1.0))
        more = {"ramp_s": chance.uniform(0.0, 1.5)} if KINDS[kind].grows_from else {}
        more |= {"period_s": chance.uniform(0.05, 0.5), "duty": 0.6} if chance.random() < 0.3 else {}
        made.append(fault(kind, chance.choice(targets), value, at_s, until_s, **more))
    return tuple(made)


@pytest.mark.parametrize("kind", PARTS)
def test_both_ends_of_a_kind_s_range_are_accepted_and_what_lies_beyond_is_refused(kind: str) -> None:
    """The limits that the documentation and the help show are those that the check applies."""
    targets, _ = PARTS[kind]
    limits = accepts(KINDS[kind].model_fields["value"]).numbers if "value" in KINDS[kind].model_fields else None
    for target in targets:
        if limits is None:
            fault(kind, target)
            continue
        low, high = limits
        assert [fault(kind, target, value).value for value in limits] == [low, high]
        for beyond in (low - 1, high + 1):
            with pytest.raises(ValidationError):
                fault(kind, target, beyond)
    with pytest.raises(ValidationError):
        fault(kind, "no such target", None if limits is None else limits[0])


def driven(rig: Rig, until_s: float, cuts: int | None = None, chance: random.Random | None = None) -> list[can.Message]:
    frames, moments = [], []
    for step in range(int(until_s * 10)):
        at_ns = START + step * 100 * MS
        if cuts and at_ns > rig.now_ns:
            assert chance is not None
            moments = sorted(chance.randrange(rig.now_ns, at_ns + 1) for _ in range(cuts))
        for part_ns in moments:
            frames += rig.advance(part_ns)
            rig.truth()
        frames += rig.advance(at_ns)
        rig.receive(command(4.0, 3.0, counter=step % 16), at_ns)
    return frames


@pytest.mark.parametrize("seed", range(4))
def test_results_do_not_depend_on_how_time_is_cut(seed: int) -> None:
    aged = shipped().model_copy(
        update={
            "parameter_spread": 0.03,
            "tanks": shipped().tanks.model_copy(update={"turbulence_cm3_sqrt_s": 1.0, "datum_cm": 2.0}),
            "pumps": shipped().pumps.model_copy(
                update={"wear_per_h": 5.0, "delay_s": (0.013, 0.31), "split_scatter": 0.1, "dead_zone_V": 0.5}
            ),
            "sensors": shipped().sensors.model_copy(update={"wave_V": 0.01}),
        }
    )
    faults, chance = faults_of_every_kind(seed), random.Random(seed)  # noqa: S311 - cuts, not secrets
    whole, cut = Rig(aged, faults, seed, 0), Rig(aged, faults, seed, 0)
    expected, frames = driven(whole, 4.0), driven(cut, 4.0, 7, chance)
    assert as_bytes(frames) == as_bytes(expected)
    assert cut.truth() == whole.truth()
    other = Rig(aged, faults, seed + 100, 0)
    assert as_bytes(driven(other, 4.0)) != as_bytes(expected)


def test_a_fault_s_randomness_does_not_depend_on_its_neighbours() -> None:
    noisy = fault("sensor_noise", 1, 0.5)
    alone = driven(Rig(shipped(), (noisy,), 3, 0), 2.0)
    beside = driven(Rig(shipped(), (noisy, fault("frame_loss", "PumpStatus", 0.5)), 3, 0), 2.0)
    lower = [f for f in as_bytes(alone) if f[1] == 0x182]
    assert lower == [f for f in as_bytes(beside) if f[1] == 0x182]


@settings(max_examples=60, deadline=None)
@given(st.lists(any_fault(), max_size=8), st.integers(0, 2**32 - 1), st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_any_list_of_faults_keeps_to_the_limits_and_to_the_water(
    faults: list[Any], seed: int, v1: float, v2: float
) -> None:
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


def test_the_controller_s_scenario_file_knows_the_same_kinds() -> None:
    assert set(FaultKind) == set(KINDS)
    for kind in FaultKind:
        assert KINDS[kind].acts_on.startswith(kind.acts_on), kind
