"""Shell blocks of the documentation's pages, and the marks that say which of them a test can't run.

A block is fenced and marked `sh`. The tests run every block of a page, in order, in one empty folder. A block that they
can't run has a comment on the line above it, `<!-- shell: REASON -->`, with one of the reasons in `REASONS`.
`<!-- shell: long -->` is for a block that runs with the tests marked `long`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

LONG = "long"
REASONS = {
    "needs a rig",
    "needs root",
    "needs a screen",
    "needs a run",
    "needs a copy of the project",
    "needs minutes on all cores",
    "changes your own shell",
    "runs this test itself",
}

_BLOCK = re.compile(
    r"(?:^[ ]*<!-- shell: (?P<mark>[^>]*) -->\n)?^(?P<indent>[ ]*)```(?P<language>[^\n]*)\n(?P<text>.*?)^[ ]*```$",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class ShellBlock:
    """One block. mark : the comment above it, or ""."""

    page: Path
    line: int
    text: str
    mark: str = ""

    @property
    def is_run(self) -> bool:
        """Whether the quick tests run it."""
        return not self.mark


def shell_blocks(page: Path) -> list[ShellBlock]:
    """All shell blocks of a page, in order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in _BLOCK.finditer(text):
        if match["language"].split(" ")[0] in ("sh", "bash", "shell", "console"):
            line = text.count("\n", 0, match.start("text")) + 1
            body = "".join(one.removeprefix(match["indent"]) for one in match["text"].splitlines(keepends=True))
            found.append(ShellBlock(page, line, body, (match["mark"] or "").strip()))
    return found
