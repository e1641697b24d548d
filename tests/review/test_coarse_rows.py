"""The recording of a long run: fewer rows, and every peak."""

from __future__ import annotations

from math import inf
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.edge.record.coarse_rows import MAX_STEPS, coarseness, extreme_rows
from hil.edge.record.recorder import Recorder
from hil.edge.record.rerun_log import RerunLog, RunCard
from hil.edge.record.run_folder import RunFolder
from tests.review import toy
from tests.review.test_rerun_log import rows, states


@pytest.mark.parametrize(
    ("duration_s", "period_s", "coarser"), [(500.0, 0.1, 1), (1e4, 0.1, 1), (86400.0, 0.1, 9), (inf, 0.1, 1)]
)
def test_only_a_run_of_many_steps_is_drawn_coarser(duration_s: float, period_s: float, coarser: int) -> None:
    assert coarseness(duration_s, period_s) == coarser
    assert duration_s == inf or duration_s / period_s / coarser <= MAX_STEPS


@settings(max_examples=50)
@given(
    st.integers(0, 700),
    st.integers(1, 6),
    st.integers(1, 12),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.3, 1.0]),
)
def test_the_lowest_and_the_highest_value_of_each_column_stay(
    count: int, columns: int, coarser: int, seed: int, missing: float
) -> None:
    random = np.random.default_rng(seed)
    values = random.standard_normal((count, columns))
    values[random.random(values.shape) < missing] = np.nan
    kept = extreme_rows(values, coarser)
    assert (np.diff(kept) > 0).all()
    stretch = (2 * columns + 1) * coarser
    assert len(kept) <= (2 * columns + 1) * -(-count // stretch) + 1
    for start in range(0, count, stretch):
        inside = kept[(kept >= start) & (kept < start + stretch)]
        for column in values[start : start + stretch].T:
            known = column[np.isfinite(column)]
            if len(known):
                assert np.nanmax(column[inside - start]) == known.max()
                assert np.nanmin(column[inside - start]) == known.min()
    if count:
        assert kept[-1] == count - 1


def test_a_coarse_recording_is_small_and_has_the_peak_of_a_single_step(tmp_path: Path) -> None:
    sizes, latest_ms = [], 4.0
    for coarser in (1, 9):
        folder = RunFolder.create(tmp_path / f"run{coarser}", toy.plan())
        card = RunCard("long", {}, "")
        log = RerunLog(folder.rrd_path, card, level_gain_V_cm=0.5, mode="lockstep", batch_ticks=500, coarser=coarser)
        recorder = Recorder.open(folder, timeline=log)
        for record, truth in toy.steps(until_s=250.0):
            recorder.tick(record, truth)
        recorder.close("complete", "")
        sizes.append(folder.rrd_path.stat().st_size)
    lateness = [row["Scalars:scalars"][0] for row in rows(folder.rrd_path, "/bench/lateness")]
    assert sum(value * 1e3 >= latest_ms for value in lateness) == 3, "steps 699, 1399, 2099"
    assert len(lateness) < 2500 / 9 + 20
    assert sizes[1] < 0.3 * sizes[0]
    assert states(folder.rrd_path, "/states/mode") == [["RUNNING"], ["DEGRADED"]]
    times = [row["run_time"] for row in rows(folder.rrd_path, "/levels/tank1")]
    assert times == sorted(times)
