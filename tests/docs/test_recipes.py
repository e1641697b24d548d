"""The recipes of CONTRIBUTING and the paths that documentation and code name: every file is there."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from tools.reference import FOLDER
from tools.reference.pages import PAGES

ROOT = Path(__file__).resolve().parents[2]
GENERATED = {(FOLDER / name).relative_to(ROOT).as_posix() for name in PAGES}


def recipes() -> list[tuple[str, str]]:
    """Title and files of each recipe: (title, path)."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## How to add")[2]
    found = []
    for part in re.split(r"^\*\*", text, flags=re.MULTILINE)[1:]:
        title = part.partition("**")[0]
        for row in re.findall(r"^\| (?!file |---)([^|]*) \|", part, re.MULTILINE):
            found += [(title, path) for path in re.findall(r"`([^`]+)`", row)]
    return found


def tracked_texts() -> list[Path]:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    endings = (".py", ".md", ".toml", ".sh", ".yml", "Makefile")
    return [ROOT / name for name in listed if name.endswith(endings) and (ROOT / name).is_file()]


@pytest.mark.parametrize(("title", "path"), recipes(), ids=lambda text: text)
def test_every_file_that_a_recipe_names_exists(title: str, path: str) -> None:
    assert (ROOT / path).exists(), f"{title}: {path}"


def test_every_recipe_has_a_file() -> None:
    titles = {title for title, _ in recipes()}
    wanted = {
        "A design in this project",
        "A fault detector in this project",
        "A kind of fault that the emulator plays",
        "A recorded signal",
        "A command",
        "A rig",
    }
    assert wanted <= titles


@pytest.mark.parametrize(
    ("title", "most"),
    [
        ("A design in this project", 2),
        ("A fault detector in this project", 2),
        ("A recorded signal", 1),
        ("A command", 2),
    ],
)
def test_a_change_touches_few_files(title: str, most: int) -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (?!file |---)", text.partition(f"**{title}**")[2].partition("\n**")[0], re.MULTILINE)
    assert len(rows) <= most


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a checkout")
def test_every_page_that_a_text_names_exists() -> None:
    """Modules, messages and tests send people to pages of the documentation."""
    missing = [
        f"{file.relative_to(ROOT)}: {path}"
        for file in tracked_texts()
        for path in set(re.findall(r"\bdocs/[A-Za-z0-9_./-]*\.md\b", file.read_text(encoding="utf-8")))
        if not (ROOT / path).is_file() and path not in GENERATED
    ]
    assert not missing
