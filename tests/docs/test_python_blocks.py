"""Every Python block of the pages runs as it is written."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCKS = [
    pytest.param(block, id=f"{page.relative_to(ROOT)}:{number}")
    for page in PAGES
    for number, block in enumerate(re.findall(r"^```python\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S), 1)
]


def test_the_readme_has_a_python_block() -> None:
    assert any(block.id == "README.md:1" for block in BLOCKS)


@pytest.mark.long
@pytest.mark.parametrize("block", BLOCKS)
def test_a_python_block_runs(
    block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "block", "exec"), {"__name__": "__main__"})  # noqa: S102 - our own pages
    if "iae_Vs" in block:
        out = capsys.readouterr().out
        assert re.fullmatch(r"\{'gain_fall': \(0\.3\d+, 0\.2\d+\), 'reference_step': \(1\.\d+, 1\.\d+\)\}\n", out), out
