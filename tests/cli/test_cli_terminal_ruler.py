"""Levels that somebody types while the pumps run: nothing waits for the terminal."""

import io
import os
from collections.abc import Iterator

import pytest
from rich.console import Console

from hil.cli.terminal_ruler import TerminalRuler
from hil.edge.host.typed_lines import TypedLines


@pytest.fixture
def typing() -> Iterator[tuple[TerminalRuler, int]]:
    """A ruler, and where to type."""
    reading, writing = os.pipe()
    yield TerminalRuler(Console(file=io.StringIO()), TypedLines(reading)), writing
    os.close(reading)


def test_levels_come_one_tank_after_the_other_and_an_empty_line_leaves_one_out(
    typing: tuple[TerminalRuler, int],
) -> None:
    ruler, keys = typing
    ruler.ask((0, 1, 2, 3))
    assert ruler.take() == ()
    assert not ruler.is_done()
    os.write(keys, b"12.3\n")
    assert ruler.take() == ((0, 12.3, 0.1),)
    os.write(keys, b"\nabc\n-1\n4,5\n0\n")
    taken = [ruler.take() for _ in range(5)]
    assert [level for levels in taken for level in levels] == [(2, 4.5, 0.1), (3, 0.0, 0.1)]
    assert ruler.is_done()
    os.close(keys)


def test_a_reader_who_sees_half_millimetres_says_so() -> None:
    reading, writing = os.pipe()
    ruler = TerminalRuler(Console(file=io.StringIO()), TypedLines(reading), sd_cm=0.05)
    ruler.ask((0,))
    os.write(writing, b"12.35\n")
    assert ruler.take() == ((0, 12.35, 0.05),)
    os.close(writing)
    os.close(reading)


def test_the_end_of_the_input_ends_the_questions(typing: tuple[TerminalRuler, int]) -> None:
    ruler, keys = typing
    ruler.ask((0, 1, 2, 3))
    os.close(keys)
    assert ruler.take() == ()
    assert ruler.is_done()


def test_nothing_is_taken_before_it_is_asked_for(typing: tuple[TerminalRuler, int]) -> None:
    ruler, keys = typing
    os.write(keys, b"3\n")
    os.close(keys)
    assert ruler.take() == ()
