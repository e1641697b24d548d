"""Every shell block of the documentation is run, or says on the line above it why a test can't run it.

Those of README and tutorial run in tests/live.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import pytest

from tests.docs.shell_blocks import (
    LONG,
    OUTPUT,
    QUICK,
    REASONS,
    ROOT,
    ShellBlock,
    name_of,
    run_block,
    run_page,
    shell_blocks,
)

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCKS = [block for page in PAGES for block in shell_blocks(page)]


OTHERS = [page for page in PAGES if name_of(page) not in QUICK and any(block.is_run for block in shell_blocks(page))]


@pytest.mark.long
@pytest.mark.parametrize("page", OTHERS, ids=name_of)
def test_the_shell_blocks_of_the_other_pages_run(page: Path, tmp_path: Path) -> None:
    if "nc -N" in page.read_text(encoding="utf-8") and shutil.which("nc") is None:
        pytest.skip("needs nc, of Debian's netcat-openbsd")
    run_page(page, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("block", [b for b in BLOCKS if b.mark == LONG], ids=lambda b: f"{name_of(b.page)}:{b.line}")
def test_a_long_shell_block_runs(block: ShellBlock, tmp_path: Path) -> None:
    """In a folder that looks like a checkout to make, so that the run's files do not land in the project."""
    for name in ("Makefile", "pyproject.toml", "requirements.lock", "hil", "firmware_sim", "config"):
        (tmp_path / name).symlink_to(ROOT / name)
    environment = tmp_path / ".venv"
    environment.mkdir()
    for entry in Path(sys.prefix).iterdir():
        if entry.name != ".installed":
            (environment / entry.name).symlink_to(entry)
    (environment / ".installed").touch()
    run_block(block, tmp_path, timeout_s=1200.0)
    shown = shown_output(block)
    printed = [line.rstrip() for line in (tmp_path / OUTPUT).read_text(encoding="utf-8").splitlines()]
    assert [line for line in shown if line not in printed] == []


def shown_output(block: ShellBlock) -> list[str]:
    """Lines of the text block below the comment `output`, between this block and the next one; none without it."""
    after = "".join(block.page.read_text(encoding="utf-8").splitlines(keepends=True)[block.line :])
    until_next = re.split(r"^```sh$", after, flags=re.MULTILINE)[0]
    shown = re.search(r"^<!-- output -->\n```text\n(.*?)^```$", until_next, re.MULTILINE | re.DOTALL)
    return shown[1].splitlines() if shown else []


def test_a_block_that_is_not_run_has_a_known_reason() -> None:
    for block in BLOCKS:
        assert not block.mark or block.mark == LONG or block.mark in REASONS, (
            f"{name_of(block.page)}:{block.line}: {block.mark}"
        )


def test_readme_and_tutorial_have_blocks_that_are_run() -> None:
    for name in ("README.md", "docs/tutorial/first-run.md", "docs/how-to/inject-a-fault.md"):
        assert any(block.is_run for block in shell_blocks(ROOT / name)), name


def test_no_command_stands_outside_a_shell_block() -> None:
    """An indented block is not marked as shell, so no test would run it."""
    for page in PAGES:
        text = re.sub(r"^ *```.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        commands = re.findall(
            r"^ {4,}(?:\$ )?(?:hil|make|firmware-sim|python|ip|candump|apt-get) .*$", text, re.MULTILINE
        )
        assert not commands, f"{name_of(page)}: {commands}"


def test_marks_and_indented_blocks_are_read(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "a\n```sh\nhil --version\n```\n<!-- shell: needs root -->\n```sh\nip link\n```\n"
        "1. x\n\n    ```sh\n    cat <<E\n      b\n    E\n    ```\n```toml\n[x]\n```\n"
    )
    blocks = shell_blocks(page)
    assert [(block.mark, block.text) for block in blocks] == [
        ("", "hil --version\n"),
        ("needs root", "ip link\n"),
        ("", "cat <<E\n  b\nE\n"),
    ]
    assert [block.line for block in blocks] == [3, 7, 12]
