"""`hil demo`: its runs can be built, and its tables say what the runs came to."""

import re
from io import StringIO
from pathlib import Path

from rich.console import Console

from hil.bench.campaign_case import check
from hil.campaigns.cases import Case
from hil.cli import demo_command, demo_tables
from hil.cli.demo_tables import Figures, both
from hil.review import table3
from tests.cli.cli_bench import CONFIG


def drawn(figures: dict[str, Figures], width: int = 80) -> str:
    page = StringIO()
    console = Console(file=page, width=width)
    for part in both(figures, demo_command.RIGS, width):
        console.print(part)
    return page.getvalue()


def row(text: str, *names: str) -> list[str]:
    """The cells of the one row of the last table that has these words."""
    (line,) = (line for line in text.split("Pump gain -60 %")[1].splitlines() if all(name in line for name in names))
    return [cell.strip() for cell in line.strip("│").split("│")]


def test_every_run_can_be_built_and_only_two_are_recorded(tmp_path: Path) -> None:
    jobs = demo_command._jobs(CONFIG, tmp_path)
    for name, job in jobs.items():
        check(Case("key", name, name, job.seed, job.scenario_data), CONFIG, name)
    assert sorted(job.record.name for job in jobs.values() if job.record) == sorted(demo_command.RECORDED)
    assert jobs["recorded"].scenario_data["diagnosis"]["method"] == "glr", "the recording shows the diagnosis at work"


def test_the_diagnosis_shows_its_median_over_the_rigs(tmp_path: Path) -> None:
    iae = dict.fromkeys(table3.TITLES, (5.0, 6.0))
    figures = dict.fromkeys(demo_command._jobs(CONFIG, tmp_path), Figures(iae))
    for seed, (y1, detected) in zip(demo_command.RIGS, ((0.1, 0.2), (0.3, None), (0.2, 0.4)), strict=True):
        figures[f"both pumps, GLR detector, rig {seed}"] = Figures({table3.GAIN_FALL: (y1, 0.5)}, detected, None, 0.012)
    text = drawn(figures)
    assert row(text, "GLR detector", "0.200") == ["", "GLR detector", "0.200", "0.500", "0.4 s", "–", "0.012"]
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text, "nothing is cut off"
    assert row(text, "both pumps") == ["both pumps", "no", "5.000", "6.000", "–", "–", "–"]
    assert "paper's table 3" in text


def test_tables_fit_sixty_columns(tmp_path: Path) -> None:
    """They used to be cut off: 76 columns wide."""
    iae = dict.fromkeys(table3.TITLES, (13.069, 9.2319))
    figures = dict.fromkeys(demo_command._jobs(CONFIG, tmp_path), Figures(iae, 10.04, 100.04, 0.0123))
    text = drawn(figures, 60)
    assert max(map(len, text.splitlines())) <= 60
    assert "…" not in text
    for name in (*demo_tables.FAULTS, "gain fall", "reference step"):
        assert text.count(f"\n{name} ") == 1, "a table for each window and fault"
    assert re.search(r"^no reconfiguration +13\.07 +9\.232 +10\.0 s +100\.0 s +0\.012", text, re.MULTILINE)
    assert re.search(r"^kept +1 +13\.07 +13\.07 +−0\.01 % +13\.07", text, re.MULTILINE)
