"""`--live web` as another form of `--live-web`, in the commands that have both options."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from typer.core import TyperCommand

LIVE, PAGE, LIVE_PAGE = "--live", "web", "--live-web"


class LiveCommand(TyperCommand):
    """A command with `--live`. Typer has no options with an optional value, and `--live steps` names a scenario."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """See `typer`."""
        return super().parse_args(ctx, with_page(args))


def with_page(args: Sequence[str]) -> list[str]:
    """The words of a command line with `--live-web` for `--live web` and `--live=web`."""
    words = [LIVE_PAGE if word == f"{LIVE}={PAGE}" else word for word in args]
    is_value = [False, *(pair == (LIVE, PAGE) for pair in pairwise(words))]
    has_value = [*is_value[1:], False]
    return [
        LIVE_PAGE if has else word for word, has, is_one in zip(words, has_value, is_value, strict=False) if not is_one
    ]
