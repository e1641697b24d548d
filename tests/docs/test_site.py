"""The documentation site builds without a warning, and a browser that shows it fetches nothing from a server."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tools.reference.pages import write_pages

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make docs` builds it, in a folder of its own."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(ROOT / "docs", folder / "docs")
    shutil.copy(ROOT / "mkdocs.yml", folder)
    for name in ("hil", "firmware_sim"):
        (folder / name).symlink_to(ROOT / name)
    write_pages(folder / "docs/reference")
    command = [str(Path(sys.executable).parent / "zensical"), "build", "--clean", "--strict"]
    built = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    assert "No issues found" in built.stdout + built.stderr
    return folder / "site"


def test_pages_fetch_nothing_from_a_server(site: Path) -> None:
    fetched = re.compile(
        r"<(?:script|img|iframe|source)[^>]+src=[\"']?(?:https?:)?//[^>]+>|<link[^>]+href=[\"']?(?:https?:)?//[^>]+>"
    )
    for page in site.rglob("*.html"):
        assert not fetched.findall(page.read_text(encoding="utf-8")), page.name
    for style in site.rglob("*.css"):
        assert not re.findall(r"url\([\"']?(?:https?:)?//", style.read_text(encoding="utf-8")), style.name


def test_the_api_page_has_the_docstring_of_every_function(site: Path) -> None:
    page = (site / "reference/api.html").read_text(encoding="utf-8")
    for name in ("simulate", "run", "campaign", "design", "load", "GainDesign", "FaultDetector", "SettingsError"):
        assert f'id="hil.{name}"' in page
    assert "<code>duration_s</code>" in page


@pytest.mark.parametrize(
    ("page", "text"),
    [
        ("own-design", "LqrDesign"),
        ("own-design", "fourtank_hil.designs"),
        ("own-detector", "InnovationDetector"),
        ("own-law", "TwoPi"),
        ("plant-elsewhere", "rig.fmu"),
    ],
)
def test_the_examples_are_shown_on_their_pages(site: Path, page: str, text: str) -> None:
    """The formatter once rewrote the line that includes a file, so that the page showed that line."""
    html = (site / f"how-to/{page}.html").read_text(encoding="utf-8")
    code = " ".join(re.findall(r"<code>(.*?)</code>", html, re.DOTALL))
    shown = re.sub(r"<[^>]+>", "", code)
    assert f"class {text}" in shown or f'"{text}"' in shown.replace("&quot;", '"')
    assert "--8" not in shown


def test_every_page_is_in_the_navigation() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert all(page in navigation for page in pages if not page.startswith("examples/"))
