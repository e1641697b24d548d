"""The live display: what it shows of one step."""

from __future__ import annotations

import io

from rich.console import Console

from hil.cli.run_display import status_table
from hil.core.controller import Output
from hil.core.types import Command, Mode, Pair
from tests.core.core_bench import inputs
from tests.review import toy


def shown(probe_V: Pair) -> str:
    record = next(toy.steps())[0]._replace(probe_V=probe_V)
    console = Console(file=io.StringIO(), width=100)
    console.print(
        status_table(inputs((6.0, 6.4, 0.8, 0.7)), Output(Command((3.3, 2.7), True), (), record), Mode.RUNNING)
    )
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_the_display_shows_a_probe_while_it_moves_the_pumps() -> None:
    assert "of it a probe [V]" in shown((0.3, -0.3))
    assert "+0.300" in shown((0.3, -0.3))
    assert "probe" not in shown((0.0, 0.0))
