"""The shell blocks of README and tutorial run as they are written, in an empty folder; README has a live run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.docs.shell_blocks import OUTPUT, ROOT, run_page

pytestmark = pytest.mark.live


def test_the_shell_blocks_of_the_readme_run(tmp_path: Path) -> None:
    run_page(ROOT / "README.md", tmp_path)
    assert json.loads((tmp_path / "runs/mine/run.json").read_text())["status"] == "complete"
    assert json.loads((tmp_path / "runs/live/run.json").read_text())["status"] == "complete"


@pytest.mark.long
def test_the_shell_blocks_of_the_tutorial_run_and_print_its_figures(tmp_path: Path) -> None:
    page = ROOT / "docs/tutorial/first-run.md"
    (tmp_path / "config").symlink_to(ROOT / "config")
    run_page(page, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"config", "runs", OUTPUT}, "nothing is left beside the runs"
    kpi = json.loads((tmp_path / "runs/first/kpi.json").read_text())
    text = page.read_text(encoding="utf-8")
    for name, (first, second) in kpi["iae_Vs"].items():
        assert f"│ {name:14} │ {first:11.3f} │ {second:11.3f} │" in text
    kept = json.loads((tmp_path / "runs/kept/kpi.json").read_text())
    assert kept["iae_Vs"]["gain_fall"][0] > 10.0 * kpi["iae_Vs"]["gain_fall"][0]
    settings = [json.loads((tmp_path / f"runs/{name}/run.json").read_text())["settings"] for name in ("first", "kept")]
    settings[0]["scenario"]["control"]["reconfigure"] = False
    assert settings[0] == settings[1], "one setting is changed"
