"""How tests are shared out among processes: the slowest first; what shares a fixture stays together. No deadlines."""

from __future__ import annotations

import gc
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from xdist.scheduler import LoadScopeScheduling

SHARED = ("live/test_live_after_a_kill.py",)
"""Files whose tests share what is started once, where others are shared out test by test (`--dist loadgroup`)."""

SLOW = (
    "docs/test_shell_blocks.py::test_a_long_shell_block_runs",
    "closed_loop/test_loop_table3.py::test_the_shipped_ideal_scenario_reproduces_table_3",
    "faults/test_faults_pairs.py::test_case_60_pairs[",
    "faults/test_faults_frames.py::test_case_02_random_loss_for_an_hour",
    "examples/test_own_package.py",
    "faults/test_faults_plant.py",
    "glr/test_glr_detector.py",
    "identification/test_identification_estimates.py",
    "faults/test_faults_slcan.py",
    "faults/test_faults_sensors.py",
    "closed_loop/test_loop_realistic.py",
    "faults/test_faults_pumps.py",
    "cli/test_cli_simulate.py",
    "campaign/test_campaign_cases.py",
    "review/test_report.py",
    "identification/test_identify.py",
    "review/test_recorder_process.py",
    "doctor/test_doctor_conformance.py",
    "closed_loop/test_loop_table3.py",
    "closed_loop/test_loop_real_rig.py",
    "docs/test_site.py",
    "glr/test_glr_filter.py",
    "faults/test_faults_start_phase.py",
    "cli/test_cli_bad_input.py",
    "faults/test_faults_unknown.py",
    "doctor/test_doctor_checks.py",
    "closed_loop/test_loop_single_loss.py",
    "identification/test_identification_result.py",
    "panel/test_panel.py",
    "faults/test_faults_frames.py",
    "faults/test_faults_pairs.py",
    "cli/test_cli_full_disk.py",
    "cli/test_cli_identify.py",
    "glr/test_glr_inflow_check.py",
    "glr/test_glr_compiled.py",
    "live/test_live_shell_blocks.py",
    "live/test_live_doctor.py::test_the_emulator_conforms_as_a_process",
    "live/test_live_faults.py::test_case_52",
    "live/test_live_doctor.py",
)
"""Slowest first, by `pytest --durations`; those at the top are long ones."""


def pytest_pycollect_makemodule(module_path: Path) -> None:
    """Before a module is imported; live tests draw no examples, and need not load hypothesis."""
    if module_path.parent.name != "live":
        _take_deadlines_away()


@cache
def _take_deadlines_away() -> None:
    """No limit of 200 ms for an example: a busy machine exceeds it, and it is no requirement."""
    from hypothesis import settings

    settings.register_profile("no deadline", settings.default, deadline=None)
    settings.load_profile("no deadline")


@pytest.fixture(autouse=True)
def _no_pause_after_a_line_over_tcp(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """pyserial waits 0.3 s after it has closed one, for servers that aren't ready yet; those in this process are."""
    if request.node.get_closest_marker("live") is None:
        from serial.urlhandler import protocol_socket

        monkeypatch.setattr(protocol_socket, "time", SimpleNamespace(sleep=lambda _s: None))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Only where tests are shared out; the others keep the order of the files."""
    if hasattr(config, "workerinput"):
        items.sort(key=_rank)


def pytest_collection_finish() -> None:
    """What was imported and collected until now stays: no search for garbage goes through all of it again."""
    gc.freeze()


def _rank(item: pytest.Item) -> int:
    name = item.nodeid.removeprefix("tests/")
    return next((rank for rank, slow in enumerate(SLOW) if name.startswith(slow)), len(SLOW))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling | None:
    """For `--dist loadgroup`: this xdist can't see the groups of this pytest, so they are files, given here."""
    if config.getvalue("dist") != "loadgroup":
        return None
    from xdist.scheduler import LoadScopeScheduling

    class TestByTest(LoadScopeScheduling):  # type: ignore[misc]  # xdist has no types
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return file if file.endswith(SHARED) else nodeid

    return TestByTest(config, log)
