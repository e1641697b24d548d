"""The whole rig on its handed-in clock: order, timing, determinism, scenario time, truth."""

import random
from collections import Counter

import can
import pytest

from firmware_sim.faults import PumpEffectiveness
from firmware_sim.faults.base import Fault
from firmware_sim.frames import (
    LEVEL_HEARTBEAT_ID,
    LOWER_LEVELS_ID,
    PUMP_HEARTBEAT_ID,
    STATUS_ID,
    UPPER_LEVELS_ID,
    NodeState,
    Rejection,
)
from firmware_sim.pump_node import Change
from firmware_sim.rig import Rig
from firmware_sim.settings import EmulatorSettings, equilibrium_cm, load
from tests.firmware_sim.sim_bench import CONFIG, MS, SECOND, command, emulator, shipped


def bench(
    settings: EmulatorSettings | None = None,
    faults: tuple[Fault | PumpEffectiveness, ...] = (),
    seed: int = 1,
    changes: list[Change] | None = None,
) -> Rig:
    return Rig(settings or shipped(), faults, seed, 0xDEADBEEF, changes.append if changes is not None else None)


def drive(
    rig: Rig, until_ns: int, period_ns: int = 100 * MS, v: tuple[float, float] = (3.0, 3.0), first_counter: int = 0
) -> list[can.Message]:
    """Command the rig once a period from now on; return all frames."""
    frames, counter = [], first_counter
    while rig.now_ns < until_ns:
        frames += rig.advance(rig.now_ns + period_ns)
        rig.receive(command(*v, counter=counter % 16), rig.now_ns)
        counter += 1
    return frames


def as_bytes(frames: list[can.Message]) -> list[tuple[float, int, bytes]]:
    return [(frame.timestamp, frame.arbitration_id, bytes(frame.data)) for frame in frames]


def test_frames_are_due_at_multiples_of_their_periods_in_the_stated_order() -> None:
    frames = bench().advance(SECOND)
    counts = Counter(frame.arbitration_id for frame in frames)
    assert counts == {
        STATUS_ID: 21,
        LOWER_LEVELS_ID: 41,
        UPPER_LEVELS_ID: 41,
        PUMP_HEARTBEAT_ID: 11,
        LEVEL_HEARTBEAT_ID: 11,
    }
    at_once = [frame.arbitration_id for frame in frames if frame.timestamp == 0.4]
    assert at_once == [LOWER_LEVELS_ID, UPPER_LEVELS_ID, STATUS_ID, PUMP_HEARTBEAT_ID, LEVEL_HEARTBEAT_ID]
    times = [frame.timestamp for frame in frames]
    assert times == sorted(times)
    levels_ms = [round(f.timestamp * 1000, 6) for f in frames if f.arbitration_id == LOWER_LEVELS_ID]
    assert levels_ms == list(range(200, 1001, 20))


def test_a_run_is_the_same_to_the_byte_for_a_seed_and_other_for_another() -> None:
    runs = [as_bytes(drive(bench(seed=seed), 5 * SECOND)) for seed in (4, 4, 5)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_results_do_not_depend_on_how_time_is_cut_nor_on_who_asks_for_the_truth() -> None:
    cutter = random.Random(3)  # noqa: S311 - cuts, not secrets
    whole, cut = bench(seed=2), bench(seed=2)
    expected, frames = [], []
    for step in range(40):
        at_ns = (step + 1) * 100 * MS
        expected += whole.advance(at_ns)
        for part_ns in sorted(cutter.randrange(at_ns - 100 * MS, at_ns + 1) for _ in range(7)):
            frames += cut.advance(part_ns)
            cut.truth()
        frames += cut.advance(at_ns)
        for rig in (whole, cut):
            rig.receive(command(4.0, 2.0, counter=step % 16), at_ns)
    assert as_bytes(frames) == as_bytes(expected)
    assert cut.truth() == whole.truth()


def test_watchdog_trips_on_time_in_between_everything_else() -> None:
    changes: list[Change] = []
    rig = bench(changes=changes)
    rig.advance(300 * MS)
    rig.receive(command(3.0, 3.0), 301 * MS + 7)
    rig.advance(10 * SECOND)
    trip = changes[-1]
    assert (trip.t_ns, trip.state, trip.applied_V, trip.cause) == (
        551 * MS + 7,
        NodeState.TRIPPED,
        (0.0, 0.0),
        "watchdog",
    )


def test_a_command_at_the_very_deadline_comes_too_late() -> None:
    rig = bench()
    rig.receive(command(3.0, 3.0), 300 * MS)
    assert rig.receive(command(3.0, 3.0, counter=1), 550 * MS) is None
    assert rig.truth().pump_state is NodeState.TRIPPED


def test_a_command_that_waited_too_long_finds_the_node_tripped() -> None:
    rig = bench()
    rig.receive(command(3.0, 3.0), 300 * MS)
    rig.receive(command(3.0, 3.0, counter=1), 900 * MS)
    assert rig.truth().applied_V == (0.0, 0.0)


def test_frames_due_before_a_command_are_kept_for_the_next_advance() -> None:
    rig = bench()
    rig.receive(command(3.0, 3.0), 300 * MS)
    frames = rig.advance(300 * MS)
    assert frames[0].timestamp == 0.0
    assert frames[-1].timestamp == 0.3
    assert rig.advance(300 * MS) == []


def test_boots_at_zero_volts_and_applies_what_it_was_told() -> None:
    rig = bench()
    rig.advance(300 * MS)
    assert rig.truth().applied_V == (0.0, 0.0)
    rig.receive(command(3.0, 10.0), 300 * MS)
    first_V, second_V = rig.truth().applied_V
    assert first_V == pytest.approx(3.0, abs=0.0013)
    assert second_V == 10.0
    rig.advance(350 * MS)
    assert rig.pump.accepted == 1


def test_the_rig_is_held_until_the_pump_node_first_runs() -> None:
    rig = bench()
    start = rig.truth().levels_cm
    assert start == equilibrium_cm(shipped())
    rig.advance(30 * SECOND)
    assert rig.truth().levels_cm == start
    assert rig.truth().scenario_s is None
    drive(rig, 31 * SECOND)
    assert rig.truth().levels_cm != start
    assert rig.truth().scenario_s == pytest.approx(0.9)
    assert rig.start_ns == round(30.1 * SECOND)


def test_the_scenario_waits_for_the_end_of_the_controller_s_start_phase() -> None:
    """The tanks are free from the first command on; the faults wait for the first one without the flag."""
    rig = bench(faults=(PumpEffectiveness(at_s=0.3, kind="pump_effectiveness", target=2, value=0.4),))
    start = rig.truth().levels_cm
    for number in range(5, 25):
        rig.advance(number * 100 * MS)
        assert rig.receive(command(3.0, 3.0, counter=number % 16, starts=number < 20), rig.now_ns) is None
    assert rig.start_ns == 2000 * MS
    assert rig.truth().levels_cm != start
    assert rig.truth().scenario_s == pytest.approx(0.4)
    assert rig.truth().effectiveness == (1.0, 0.4)


def test_without_hold_the_tanks_drain_from_power_up() -> None:
    rig = bench(emulator(tanks={"hold_until_run": False}))
    rig.advance(30 * SECOND)
    assert all(now < start for now, start in zip(rig.truth().levels_cm, equilibrium_cm(shipped()), strict=True))


def test_a_trip_does_not_hold_the_tanks() -> None:
    rig = bench()
    drive(rig, SECOND)
    rig.advance(60 * SECOND)
    truth = rig.truth()
    assert truth.pump_state is NodeState.TRIPPED
    assert truth.levels_cm[0] < 10.0


def test_faults_run_in_scenario_time() -> None:
    fault = PumpEffectiveness(at_s=2.0, kind="pump_effectiveness", target=2, value=0.4)
    rig = bench(faults=(fault,))
    drive(rig, 3 * SECOND)
    assert rig.start_ns == 200 * MS
    assert rig.truth().effectiveness == (1.0, 0.4)
    other = bench(faults=(fault,))
    drive(other, 2 * SECOND)
    assert other.truth().effectiveness == (1.0, 1.0)
    other.advance(2200 * MS - 1)
    assert other.truth().effectiveness == (1.0, 1.0)
    other.advance(2200 * MS)
    assert other.truth().effectiveness == (1.0, 0.4)


def test_the_paper_s_scenario_settles_at_the_levels_of_its_smaller_flow() -> None:
    settings, faults = load(CONFIG / "emulator.toml", CONFIG / "scenarios/paper_ideal.toml")
    rig = bench(settings, faults)
    drive(rig, 199 * SECOND)
    assert rig.truth().levels_cm == pytest.approx(equilibrium_cm(settings), abs=1e-6)
    drive(rig, 900 * SECOND, first_counter=rig.pump.accepted)
    reduced = emulator(tanks={"start_V": [1.2, 1.2]})
    assert rig.truth().effectiveness == (0.4, 0.4)
    assert rig.truth().levels_cm == pytest.approx(equilibrium_cm(reduced), abs=1e-3)


def test_pumps_at_full_voltage_overflow_and_the_truth_says_so() -> None:
    rig = bench()
    drive(rig, 200 * SECOND, v=(10.0, 10.0))
    assert max(rig.truth().levels_cm) == 20.0
    assert rig.truth().spilled_cm3 > 0.0


def test_power_off_puts_out_zero_volts_even_with_a_clock_that_went_back() -> None:
    changes: list[Change] = []
    rig = bench(changes=changes)
    drive(rig, SECOND)
    rig.power_off(0)
    assert rig.truth().applied_V == (0.0, 0.0)
    assert {change.node for change in changes if change.cause == "shutdown"} == {"pump", "level"}
    assert changes[-1].t_ns == SECOND


def test_time_never_goes_back() -> None:
    rig = bench()
    rig.advance(SECOND)
    with pytest.raises(ValueError, match="before 1000000000 ns"):
        rig.advance(SECOND - 1)
    with pytest.raises(ValueError, match="before"):
        rig.receive(command(), 0)


def test_next_event_is_exact() -> None:
    rig = bench()
    rig.advance(210 * MS)
    assert rig.next_event_ns == 220 * MS
    rig.receive(command(3.0, 3.0), 215 * MS)
    rig.advance(460 * MS)
    assert rig.next_event_ns == 465 * MS
    assert rig.advance(465 * MS) == []
    assert rig.truth().pump_state is NodeState.TRIPPED


def test_receive_says_why_a_frame_was_refused() -> None:
    rig = bench()
    rig.advance(300 * MS)
    assert rig.receive(command(10.0002, 0.0), 300 * MS) is Rejection.RANGE
    assert rig.receive(command(1.0, 0.0), 300 * MS) is None
    assert rig.receive(command(1.0, 0.0), 300 * MS) is Rejection.DUPLICATE
