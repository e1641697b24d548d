"""The lines that a client may send: what is a request, and what is said of all others."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.live_request import Author, LiveRequest
from hil.edge.control.messages import REQUESTS, MessageError, answer_line, live_request, parse, to_line

AUTHOR = Author("ann", 1, 1)

GOOD: dict[str, dict[str, object]] = {
    "reference": {"levels_cm": [12.5, None], "ramp_s": 20},
    "manual": {"voltage_V": [None, 3]},
    "bypass": {"interlock": "dry_run", "for_s": 60.0},
    "note": {"text": "valve 2 turned"},
    "mark": {"name": "a"},
    "ack": {"alarm": "all"},
    "shelve": {"alarm": "alarm:1", "for_s": 0},
    "subscribe": {"rate_hz": 20},
}


def line(do: str, **keys: object) -> bytes:
    return json.dumps({"v": 1, "id": 7, "do": do, **keys}).encode()


@pytest.mark.parametrize("do", REQUESTS)
def test_every_request_of_the_reference_page_is_understood(do: str) -> None:
    message = parse(line(do, **GOOD.get(do, {})))
    assert (message.do, message.id) == (do, 7)
    if do not in ("subscribe", "state"):
        request = live_request(message, 3, AUTHOR)
        assert (request.number, request.action.value, request.author) == (3, do, AUTHOR)
        assert request.sent["do"] == do


BAD = {
    "not json": (b"reference 6.4 6.7", "not a JSON object"),
    "not UTF-8": (b'{"do": "\xff"}', "not a JSON object in UTF-8"),
    "a list": (b"[1]", "not a JSON object but a list"),
    "unknown": (line("explode"), "do = 'explode': must be one of reference, manual"),
    "another version": (line("auto", v=2), "v = 2: must be 1"),
    "unknown key": (line("auto", speed=3), "speed = 3: unknown key"),
    "a key is missing": (line("note"), "missing: text"),
    "text for a number": (line("reference", levels_V=["6.4", 6.7]), "levels_V[0] = '6.4': must be"),
    "not finite": (b'{"do": "reference", "levels_V": [NaN, 6.0]}', "NaN is no number of JSON"),
    "overflow": (b'{"do": "reference", "levels_V": [1e999, 6.0]}', "levels_V[0] = inf"),
    "two units": (line("reference", levels_V=[6, 6], levels_cm=[12, 12]), "has levels_V, levels_cm of"),
    "no values": (line("reference"), "has none of"),
    "changes nothing": (line("reference", change_V=[None, None]), "change_V = [null, null] changes nothing"),
    "three pumps": (line("manual", voltage_V=[1, 2, 3]), "voltage_V"),
    "too high": (line("manual", voltage_V=[10.1, 2]), "voltage_V[0] = 10.1: must be"),
    "true for a number": (line("bypass", interlock="dry_run", for_s=True), "for_s = True: must be a number above 0"),
    "never bypassed": (line("bypass", interlock="high_level", for_s=5), "interlock = 'high_level': must be one of"),
    "too long a note": (line("note", text="x" * 1001), "...: must be a text of 1 to 1000 characters"),
    "an empty note": (line("note", text=""), "text = '': must be a text of 1 to 1000 characters"),
    "nested": (b'{"do": ' + b"[" * 3000 + b"]" * 3000 + b"}", ""),
}


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_line_is_answered_with_key_value_and_range(name: str) -> None:
    data, text = BAD[name]
    with pytest.raises(MessageError, match=r"(?s).*") as caught:
        parse(data)
    assert text in str(caught.value), str(caught.value)
    assert len(str(caught.value)) <= 450


def test_text_is_printable_in_record_and_terminal() -> None:
    """An escape sequence would change the operator's terminal; a lone surrogate can't be written as UTF-8."""
    request = live_request(parse(rb'{"do": "note", "text": "a\u001b[2Jb"}'), 1, AUTHOR)
    assert (request.text, request.sent["text"]) == ("a?[2Jb", "a?[2Jb")
    with pytest.raises(MessageError, match="text = "):
        parse(rb'{"do": "note", "text": "a\ud800"}')


def test_numbers_that_json_does_not_have_are_null() -> None:
    assert json.loads(to_line({"a": [float("nan"), (float("inf"), 1.0)]})) == {"a": [None, [None, 1.0]]}
    assert json.loads(answer_line("x", None, "why", "not_while")) == {
        "v": 1,
        "id": "x",
        "ok": False,
        "t_s": None,
        "reason": "not_while",
        "text": "why",
    }


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
KEYS = ("id", "v", "levels_V", "levels_cm", "change_V", "ramp_s", "voltage_V", "interlock", "for_s", "text", "alarm")
MESSAGES = st.fixed_dictionaries(
    {"do": st.sampled_from([*REQUESTS]) | VALUES}, optional=dict.fromkeys(KEYS, VALUES)
).map(lambda message: json.dumps(message).encode())


def outcome(data: bytes) -> None:
    """A request, or an error that has a text and can be answered."""
    try:
        message = parse(data)
    except MessageError as error:
        answer = json.loads(answer_line(error.request_id, 1.0, str(error), "bad_request"))
        assert answer["text"]
        return
    if message.do not in ("subscribe", "state"):
        assert isinstance(live_request(message, 1, AUTHOR), LiveRequest)


@settings(max_examples=60)
@given(MESSAGES | st.binary(max_size=200))
def test_whatever_comes_is_a_request_or_one_clear_error(data: bytes) -> None:
    outcome(data)
