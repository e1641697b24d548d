"""What a client refuses to send: a run would not read it, and could not say to which request it answers."""

from __future__ import annotations

import math
import time
from pathlib import Path

import pytest

from hil.cli import exit_codes
from hil.cli.ctl_command import CtlOptions, CtlValueError, request_keys
from hil.edge.control.client import RequestError
from hil.edge.control.socket_path import MAX_LINE
from tests.control.control_bench import Bench, ctl


@pytest.mark.parametrize(
    ("do", "keys", "said"),
    [
        ("reference", {"levels_cm": [math.nan, 12.0]}, "reference: JSON can't say this"),
        ("reference", {"levels_cm": [12.0, 12.0], "ramp_s": math.inf}, "reference: JSON can't say this"),
        ("note", {"text": Path("a")}, "note: JSON can't say this"),
        ("note", {"text": "x" * 100_000}, f"bytes; it may have {MAX_LINE}"),
    ],
)
def test_what_no_run_would_read_is_refused_at_once(bench: Bench, do: str, keys: dict[str, object], said: str) -> None:
    """A client waited 5 s for the answer to an infinite ramp, and lost its connection by a long note."""
    with bench.connect() as client:
        begun_s = time.monotonic()
        with pytest.raises(RequestError, match=said):
            client.ask(do, **keys)
        assert time.monotonic() - begun_s < 4.0
        assert client.state()["mode"] == "RUNNING", "the connection goes on"


def test_the_longest_line_is_sent(bench: Bench) -> None:
    """Answered by what is too long in it, not by the end of the connection."""
    with bench.connect() as client:
        frame = len('{"v": 1, "id": 1, "do": "note", "text": ""}\n')
        answer = client.ask("note", text="x" * (MAX_LINE - frame))
        assert answer["reason"] == "bad_request"
        assert answer["text"].endswith("must be a text of 1 to 1000 characters")
        with pytest.raises(RequestError):
            client.ask("note", text="x" * (MAX_LINE - frame + 1))


def test_hil_ctl_says_why_a_note_is_too_long(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    assert ctl("note", "x" * 100_000, folder=bench.path.parent) == exit_codes.BAD_INPUT
    said = capsys.readouterr().err
    assert said == f"hil: note: a request of 100044 bytes; it may have {MAX_LINE}\n"


@pytest.mark.parametrize("value", ["6_4", "1_0", "٦", "nan", "inf", "1e999", "0x10", "", "6,4"])
def test_what_looks_like_a_number_to_python_alone_is_none(value: str) -> None:
    """An underscore for a point made 64 of 6.4."""
    options = CtlOptions("reference", (value, "6"), False, False, 0.0, False, None, None)
    with pytest.raises(CtlValueError, match="must be a number"):
        request_keys(options)
