"""The shipped scenarios keep the limits that they ship with."""

from pathlib import Path

import pytest

import hil
from hil.bench.acceptance_run import AcceptanceRun, is_end_judged
from hil.edge.config.settings_file import default_config_dir
from tests.closed_loop.shipped_limits import assert_kept

FILES = sorted((default_config_dir() / "scenarios").glob("*.toml"))
ENDLESS = {"hold"}
QUICK = ("pump_returns",)
LONG = [file.stem for file in FILES if file.stem not in (*ENDLESS, *QUICK, "paper_ideal")]
"""`paper_ideal` is judged where it is run, in test_loop_table3.py."""


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.long) for name in LONG)])
def test_a_shipped_scenario_keeps_its_limits(name: str) -> None:
    assert_kept(hil.simulate(name).kpi, name)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_every_shipped_scenario_that_ends_has_limits(file: Path) -> None:
    """Beyond the ones that any run keeps."""
    accepts = AcceptanceRun(file, Path("unused")).load().scenario.accept
    assert bool(accepts) == (file.stem not in ENDLESS)
    checks = {accept.check for accept in accepts}
    if accepts:
        assert {"no_trip", "level_max_cm"} < checks
        assert not is_end_judged(accepts), "it has to be complete"
