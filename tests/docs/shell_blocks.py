"""Shell blocks of the documentation's pages, and the marks that say which of them a test can't run.

A block is fenced and marked `sh`. The tests run every block of a page, in order, in one empty folder. A block that they
can't run has a comment on the line above it, `<!-- shell: REASON -->`, with one of the reasons in `REASONS`.
`<!-- shell: long -->` is for a block that runs with the tests marked `long`.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
QUICK = ("README.md", "docs/tutorial/first-run.md")
TIMEOUT_S = 120.0
OUTPUT = "output.txt"
"""What the last block printed, in its folder."""
LONG = "long"
REASONS = {
    "needs a rig",
    "needs root",
    "needs a guest kernel",
    "needs a screen",
    "needs a run",
    "needs two terminals",
    "needs a copy of the project",
    "needs minutes on all cores",
    "changes your own shell",
    "runs this test itself",
    "a part of make demo",
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


def name_of(page: Path) -> str:
    """Path of a page, as a test's name."""
    return page.relative_to(ROOT).as_posix()


def run_block(block: ShellBlock, folder: Path, timeout_s: float = TIMEOUT_S) -> None:
    """Run a block as bash does, in `folder`, with the commands on the path. Its background jobs end with it."""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    output = folder / OUTPUT
    with output.open("w") as log:
        process = subprocess.Popen(
            ["bash", "-eu", "-o", "pipefail", "-c", block.text],
            cwd=folder,
            env={**os.environ, "PATH": path},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            code: int | str = process.wait(timeout=timeout_s)
        except subprocess.TimeoutExpired:
            code = f"no end within {timeout_s:g} s"
        finally:
            with contextlib.suppress(ProcessLookupError):  # nothing of this block's process group is left
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    assert code == 0, f"{name_of(block.page)}:{block.line} ended with {code}:\n{output.read_text()}"


def run_page(page: Path, folder: Path) -> None:
    """Run a page's blocks one after the other in one folder."""
    for block in shell_blocks(page):
        if block.is_run:
            run_block(block, folder)
