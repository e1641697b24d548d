"""The references of a scenario as output voltages over the time of a run: steps, ramps and trajectories."""

from __future__ import annotations

from pathlib import Path

from hil.core.reference_path import ReferenceMove, RunReferences
from hil.core.tanks import equilibrium
from hil.core.types import Pair
from hil.edge.config.rig_file import Rig
from hil.edge.config.scenario_file import Reference, Scenario
from hil.edge.config.settings_file import SettingsError
from hil.edge.config.trajectory_file import load_trajectory

Schedule = tuple[tuple[float, Pair], ...]
Moves = tuple[tuple[int, ReferenceMove], ...]


def reference_plan(scenario: Scenario, rig: Rig, where: str) -> tuple[Schedule, Moves]:
    """Schedule and moves of `hil.core.reference_path.RunReferences`.

    The first entry is that of time 0: the operating point's levels, unless a reference at 0 gives others. where : the
    scenario file, relative to which trajectories are found. Raises SettingsError, also when a reference lies below
    empty or above the level that trips.
    """
    k = rig.tank_model.level_gain_V_cm
    highest = k * rig.safety.level_max_cm
    h1, h2, _, _ = equilibrium(rig.tank_model, rig.operating_drives)
    levels_V: Pair = (k * h1, k * h2)
    schedule: list[tuple[float, Pair]] = [(0.0, levels_V)]
    moves: list[tuple[int, ReferenceMove]] = []
    for index, reference in enumerate(scenario.reference):
        at_s = reference.at_s
        before_V = RunReferences(tuple(schedule), None, tuple(moves)).requested(at_s)
        points: tuple[tuple[float, Pair], ...] = ()
        if reference.file is not None:
            points = load_trajectory(Path(where).parent / reference.file, k, highest)
            levels_V = points[-1][1]
        else:
            levels_V = _end_of(reference, levels_V, k)
            points = ((reference.ramp_s, levels_V),) if reference.ramp_s > 0.0 else ()
        if not all(0.0 <= level <= highest for level in levels_V):
            raise SettingsError(
                f"{where}: reference[{index}]: leads to {levels_V[0]:g}, {levels_V[1]:g} V, outside 0..{highest:g} V "
                f"(safety.level_max_cm {rig.safety.level_max_cm:g})"
            )
        first_V = points[0][1] if points and points[0][0] == 0.0 else before_V if points else levels_V
        if at_s == 0.0 and len(schedule) == 1:
            schedule[0] = (0.0, first_V)
            if not points:
                continue
        if points and points[0][0] > 0.0:
            points = ((0.0, before_V), *points)
        schedule.append((at_s, levels_V))
        if len(points) > 1:
            times_s, values_V = zip(*((at_s + t_s, value) for t_s, value in points), strict=True)
            moves.append((len(schedule) - 1, ReferenceMove(times_s, values_V)))
    return tuple(schedule), tuple(moves)


def _end_of(reference: Reference, before_V: Pair, level_gain_V_cm: float) -> Pair:
    """(2,) where a step or ramp leads to."""
    if reference.change_V is not None:
        return before_V[0] + reference.change_V[0], before_V[1] + reference.change_V[1]
    if reference.levels_cm is not None:
        return level_gain_V_cm * reference.levels_cm[0], level_gain_V_cm * reference.levels_cm[1]
    return reference.levels_V or before_V
