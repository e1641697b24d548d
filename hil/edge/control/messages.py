"""The requests that a client can send, as docs/reference/control-channel.md has them, checked key by key."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from hil.core.live_request import Author, LiveAction, LiveRequest
from hil.core.types import TripCause
from hil.edge.config.complaints import complaint
from hil.edge.config.scenario_file import BypassableName
from hil.edge.config.settings_file import LevelCm, LevelVolts, Section, Volts

VERSION = 1
MAX_RATE_HZ = 20.0
MAX_RAMP_S = 86400.0
MAX_SHELVE_S = 3600.0

Change = Annotated[float, Field(ge=-1000.0, le=1000.0, allow_inf_nan=False)]


class MessageError(ValueError):
    """A line that is no request. request_id : its id, as far as it has one."""

    def __init__(self, text: str, request_id: object = None) -> None:
        super().__init__(text)
        self.request_id = request_id


class ClientRequest(Section):
    """What all requests have."""

    v: Literal[1] = 1
    id: int | float | Annotated[str, Field(max_length=64)] | None = None
    do: str


class ReferenceRequest(ClientRequest):
    """References in one of three units; null keeps one."""

    do: Literal["reference"]
    levels_V: tuple[LevelVolts | None, LevelVolts | None] | None = None
    levels_cm: tuple[LevelCm | None, LevelCm | None] | None = None
    change_V: tuple[Change | None, Change | None] | None = None
    ramp_s: Annotated[float, Field(ge=0.0, le=MAX_RAMP_S, allow_inf_nan=False)] = 0.0

    @model_validator(mode="after")
    def _says_it_once(self) -> Self:
        given = [k for k in ("levels_V", "levels_cm", "change_V") if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError(f"reference has {', '.join(given) or 'none'} of levels_V, levels_cm, change_V: give one")
        if getattr(self, given[0]) == (None, None):
            raise ValueError(f"{given[0]} = [null, null] changes nothing")
        return self


class ManualRequest(ClientRequest):
    """Pumps by hand; null keeps one."""

    do: Literal["manual"]
    voltage_V: tuple[Volts | None, Volts | None] | None = None


class BypassRequest(ClientRequest):
    """Leaves an interlock out for a time."""

    do: Literal["bypass"]
    interlock: BypassableName
    for_s: Annotated[float, Field(gt=0.0, le=600.0, allow_inf_nan=False)]


class PlainRequest(ClientRequest):
    """Requests without keys of their own."""

    do: Literal["auto", "clear", "stop", "hold", "resume", "here", "state"]


class NoteRequest(ClientRequest):
    """A note for the record."""

    do: Literal["note"]
    text: Annotated[str, Field(min_length=1, max_length=1000)]


class MarkRequest(ClientRequest):
    """A mark in the record."""

    do: Literal["mark"]
    name: Annotated[str, Field(min_length=1, max_length=64)]


class AckRequest(ClientRequest):
    """Acknowledges an alarm, or all."""

    do: Literal["ack"]
    alarm: Annotated[str, Field(min_length=1, max_length=64)]


class ShelveRequest(ClientRequest):
    """Hides an alarm for a time."""

    do: Literal["shelve"]
    alarm: Annotated[str, Field(min_length=1, max_length=64)]
    for_s: Annotated[float, Field(ge=0.0, le=MAX_SHELVE_S, allow_inf_nan=False)]


class SubscribeRequest(ClientRequest):
    """States and events from now on."""

    do: Literal["subscribe"]
    rate_hz: Annotated[float, Field(ge=0.0, le=MAX_RATE_HZ, allow_inf_nan=False)] = 10.0
    events: bool = True


REQUESTS: dict[str, type[ClientRequest]] = {
    "reference": ReferenceRequest,
    "manual": ManualRequest,
    "auto": PlainRequest,
    "bypass": BypassRequest,
    "clear": PlainRequest,
    "stop": PlainRequest,
    "hold": PlainRequest,
    "resume": PlainRequest,
    "note": NoteRequest,
    "mark": MarkRequest,
    "ack": AckRequest,
    "shelve": ShelveRequest,
    "subscribe": SubscribeRequest,
    "here": PlainRequest,
    "state": PlainRequest,
}
"""What a client can ask for -> its message."""


def parse(line: bytes) -> ClientRequest:
    """One line as a request. Raises MessageError that names what is wrong."""
    try:
        data = json.loads(line.decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        text = str(error) or type(error).__name__
        raise MessageError(f"not a JSON object in UTF-8: {text}") from None
    if not isinstance(data, dict):
        raise MessageError(f"not a JSON object but a {type(data).__name__}")
    request_id = _echoed(data.get("id"))
    do = data.get("do")
    if not isinstance(do, str) or do not in REQUESTS:
        shown = repr(do)[:80]
        raise MessageError(f"do = {shown}: must be one of {', '.join(REQUESTS)}", request_id)
    model = REQUESTS[do]
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise MessageError(complaint(model, error)[:400], request_id) from None
    except RecursionError:
        raise MessageError("nested too deeply", request_id) from None


def live_request(message: ClientRequest, number: int, author: Author) -> LiveRequest:
    """The request as the control step takes it."""
    sent: dict[str, Any] = _printable(message.model_dump(mode="json", exclude_unset=True, exclude={"v", "id"}))
    values = {k: v for k, v in message.model_dump(exclude={"v", "id", "do"}).items() if v is not None}
    text = values.pop("text", None) or values.pop("name", None) or values.pop("alarm", None) or ""
    if "interlock" in values:
        values["interlock"] = TripCause(values["interlock"])
    return LiveRequest(number, LiveAction(message.do), author, sent, text=_printable(text), **values)


def answer_line(request_id: object, t_s: float | None, text: str, reason: str = "") -> bytes:
    """An answer. reason : a code for programs of a refusal; "" if the request was accepted."""
    answer: dict[str, object] = {"v": VERSION, "id": request_id, "ok": not reason, "t_s": t_s}
    if reason:
        answer["reason"] = reason
    return to_line({**answer, "text": text})


def to_line(message: dict[str, object]) -> bytes:
    """One message. Numbers that JSON does not have become null."""
    try:
        return json.dumps(message, allow_nan=False).encode() + b"\n"
    except ValueError:
        return json.dumps(_finite(message)).encode() + b"\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and value - value != 0.0 else value


def _printable(value: Any) -> Any:
    """Text as it may stand in a record and on a terminal."""
    if isinstance(value, dict):
        return {key: _printable(item) for key, item in value.items()}
    if not isinstance(value, str):
        return value
    return "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in value)


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _echoed(request_id: object) -> object:
    """The id to answer a wrong request with."""
    is_plain = isinstance(request_id, int | float) or (isinstance(request_id, str) and len(request_id) <= 64)
    return request_id if is_plain else None
