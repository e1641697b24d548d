"""A run folder through today's controller: the same commands, or the first difference."""

from __future__ import annotations

from pathlib import Path

from hil.replay.replay_run import ReplayOptions, replay


def test_a_fresh_run_is_repeated_bit_by_bit(recorded_run: Path) -> None:
    """Every command, with its counter, and every event."""
    result = replay(recorded_run, ReplayOptions(tolerance_V=0.0))
    assert result.comparison is not None
    assert (result.comparison.differing, result.comparison.rounded, result.comparison.first) == (0, 0, None)
    assert result.comparison.compared == len((recorded_run / "sent.log").read_text().splitlines()) > 240
    assert result.expected == result.replayed.payloads
    assert result.recorded_alarms
    assert result.recorded_alarms == result.replayed_alarms
    assert result.doubts == ()
