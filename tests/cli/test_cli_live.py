"""The forms of `--live` on a command line."""

import pytest

from hil.cli.live_command import with_page


@pytest.mark.parametrize(
    ("given", "means"),
    [
        (["hold", "--live", "web", "--out", "x"], ["hold", "--live-web", "--out", "x"]),
        (["--live=web", "hold"], ["--live-web", "hold"]),
        (["--live", "hold", "web"], ["--live", "hold", "web"]),
        (["hold", "--out", "web"], ["hold", "--out", "web"]),
        (["hold", "--live"], ["hold", "--live"]),
        ([], []),
    ],
)
def test_live_web_is_the_page_and_any_other_word_after_live_is_not(given: list[str], means: list[str]) -> None:
    assert with_page(given) == means
