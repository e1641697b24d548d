"""The generated pages by file name, and the function that makes each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tools.reference.api import api_page
from tools.reference.command_line import command_line_page
from tools.reference.fault_kinds import fault_kinds_page
from tools.reference.frames import frames_page
from tools.reference.settings import settings_page
from tools.reference.signals import signals_page

PAGES: dict[str, Callable[[], str]] = {
    "api.md": api_page,
    "command-line.md": command_line_page,
    "settings.md": settings_page,
    "frames.md": frames_page,
    "signals.md": signals_page,
    "fault-kinds.md": fault_kinds_page,
}


def write_pages(folder: Path) -> None:
    """Write all pages. A page that has not changed is not touched: `make docs-serve` builds at every change."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, page in PAGES.items():
        text = page()
        file = folder / name
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")
