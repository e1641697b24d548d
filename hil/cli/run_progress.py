"""A progress bar that counts runs, or steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


@contextmanager
def run_progress(console: Console, name: str, total: int) -> Iterator[Callable[[], None]]:
    """Shows the bar on a terminal, and gives what is to be called after each run."""
    with _bar(console) as bar:
        task = bar.add_task(name, total=total)
        yield lambda: bar.advance(task)


@contextmanager
def progress(console: Console, name: str) -> Iterator[Callable[[int, int], None]]:
    """Shows the bar on a terminal, and gives what is to be called with how many are done, and of how many."""
    with _bar(console) as bar:
        task = bar.add_task(name, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _bar(console: Console) -> Progress:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
