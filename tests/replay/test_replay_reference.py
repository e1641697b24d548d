"""The reference run: 30 s in real time, with a loss and an operator's requests, replayed at every change.

It was recorded with the emulator as another process, over slcan. Of ticks.csv only the columns are kept that a replay
reads. If a change of behaviour is wanted: `hil replay tests/replay/reference --update`, and the difference of
reference.json belongs to the change.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.replay.replay_run import ReplayOptions, ReplayResult, replay

REFERENCE = Path(__file__).parent / "reference"


@pytest.fixture(scope="module")
def result() -> ReplayResult:
    return replay(REFERENCE, ReplayOptions())


def test_the_controller_does_on_a_recorded_run_what_it_did(result: ReplayResult) -> None:
    """Commands within one count on the wire, 0.2 mV, alarms within a step and 1 %: what another processor may round."""
    assert result.is_same, result.summary
    assert result.comparison is not None
    assert result.comparison.compared == len(result.recorded.steps) == 307
    assert [one.kind for one in result.replayed_alarms] == ["pump_effectiveness"]


def test_what_an_operator_asked_for_is_asked_for_again(result: ReplayResult) -> None:
    """A note, a reference, pumps by hand and back; and the step whose time is not recorded is said."""
    assert [one.action for asked in result.recorded.requests.values() for one in asked] == [
        "note",
        "reference",
        "manual",
        "auto",
    ]
    assert result.replayed.event_text.count('"operator"') == 4
    assert "the step before control" in " ".join(result.doubts)
