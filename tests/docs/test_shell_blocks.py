"""Every shell block of README and the documentation is run, or says on the line above it why a test can't run it."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.shell_blocks import LONG, REASONS, ShellBlock, shell_blocks

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCKS = [block for page in PAGES for block in shell_blocks(page)]
QUICK = ("README.md", "docs/tutorial/first-run.md")
TIMEOUT_S = 120.0


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


OTHERS = [page for page in PAGES if name_of(page) not in QUICK and any(block.is_run for block in shell_blocks(page))]


def run_block(block: ShellBlock, folder: Path) -> None:
    """Run a block as bash does, in `folder`, with the commands on the path. Its background jobs end with it."""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    output = folder / "output.txt"
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
            code: int | str = process.wait(timeout=TIMEOUT_S)
        except subprocess.TimeoutExpired:
            code = f"no end within {TIMEOUT_S:g} s"
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


@pytest.mark.live
@pytest.mark.parametrize("name", QUICK)
def test_the_shell_blocks_of_readme_and_tutorial_run(name: str, tmp_path: Path) -> None:
    run_page(ROOT / name, tmp_path)


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
    run_block(block, tmp_path)


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
