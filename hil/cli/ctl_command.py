"""`hil ctl`: words of a command line to a request of the control channel, and what is shown of the answer."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from hil.cli import exit_codes
from hil.cli.complaint import complain, interruptible
from hil.edge.control.client import ControlClient, Message, RequestError, find_run, listed_run
from hil.edge.control.socket_path import ControlError

WATCH_HZ = 1.0
ANSWER_S = 5.0
STOP_ANSWER_S = 1.0
"""For a stop; then SIGTERM does the same."""
KEEP = "-"


class CtlValueError(ValueError):
    """Values that the action does not take."""


@dataclass(frozen=True, slots=True)
class CtlOptions:
    """action, values : what is asked. cm, change, ramp_s : of a reference. folder, socket : which run."""

    action: str
    values: tuple[str, ...]
    cm: bool
    change: bool
    ramp_s: float
    as_json: bool
    folder: Path | None
    socket: Path | None


def run(options: CtlOptions) -> int:
    """Do it; the exit code."""
    try:
        keys = request_keys(options)
    except CtlValueError as error:
        return complain(str(error), exit_codes.BAD_INPUT)
    timeout_s = STOP_ANSWER_S if options.action == "stop" else ANSWER_S
    try:
        path = find_run(options.folder, options.socket)
        with ControlClient.connect(path, timeout_s) as client, interruptible():
            if options.action == "status":
                return _status(client, options.as_json)
            if options.action == "watch":
                return _watch(client, options.as_json)
            return _ask(client, options.action, keys)
    except RequestError as error:
        return complain(str(error), exit_codes.BAD_INPUT)
    except ControlError as error:
        return _without_answer(options, str(error))
    except (AttributeError, KeyError, TypeError) as error:  # of another version, or no run at all
        text = f"its answer is not in the form that this hil knows ({type(error).__name__}: {error})"
        return _without_answer(options, text)


def _without_answer(options: CtlOptions, why: str) -> int:
    """What to do when the control channel fails: a stop is sent as a signal, if the run's process is known."""
    run = listed_run(options.folder, options.socket)
    if run is None:
        return complain(why, exit_codes.NOT_DONE)
    if options.action == "stop" and run.process.terminate():
        typer.echo(f"SIGTERM sent to process {run.pid}: the pumps ramp down and the run ends ({why})")
        return 0
    return complain(f"{why}; process {run.pid} goes on, hil ctl stop ends it", exit_codes.NOT_DONE)


def request_keys(options: CtlOptions) -> dict[str, Any]:
    """The keys of the request. Raises CtlValueError that says what the action needs."""
    action, values = options.action, options.values
    if (options.cm or options.change or options.ramp_s > 0.0) and action != "reference":
        raise CtlValueError(f"--cm, --change and --ramp are for reference, not for {action}")
    match action:
        case "reference":
            return _reference(options)
        case "manual":
            return {"voltage_V": _pumps(values)} if values else {}
        case "bypass" | "shelve":
            name, time_s = _exactly(values, 2, f"{action} needs a name and seconds")
            return {"interlock" if action == "bypass" else "alarm": name, "for_s": _number(time_s, "seconds")}
        case "note":
            if not values:
                raise CtlValueError("note needs a text")
            return {"text": " ".join(values)}
        case "mark" | "ack":
            (name,) = _exactly(values, 1, f"{action} needs a name")
            return {"name" if action == "mark" else "alarm": name}
    _exactly(values, 0, f"{action} takes no values")
    return {}


def _reference(options: CtlOptions) -> dict[str, Any]:
    if options.cm and options.change:
        raise CtlValueError("--cm and --change: give one; a change is in V")
    values = _exactly(options.values, 2, "reference needs two values, for output 1 and 2 (- keeps one)")
    unit = "levels_cm" if options.cm else "change_V" if options.change else "levels_V"
    pair = [None if value == KEEP else _number(value, "reference") for value in values]
    return {unit: pair} | ({"ramp_s": options.ramp_s} if options.ramp_s > 0.0 else {})


def _pumps(values: Sequence[str]) -> list[float | None]:
    volts: list[float | None] = [None, None]
    for value in values:
        pump, is_given, voltage = value.partition("=")
        if pump not in ("1", "2") or not is_given or volts[int(pump) - 1] is not None:
            raise CtlValueError(f"manual {value}: must be 1=VOLTS and 2=VOLTS, each once")
        volts[int(pump) - 1] = _number(voltage, "manual")
    return volts


def _exactly(values: Sequence[str], count: int, text: str) -> Sequence[str]:
    if len(values) != count:
        raise CtlValueError(f"{text}, not {' '.join(values) or 'none'}")
    return values


def _number(value: str, what: str) -> float:
    try:
        number = float(value) if value.isascii() and "_" not in value else math.nan  # Python takes 6_4 for 64
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise CtlValueError(f"{what} {value}: must be a number")
    return number


def _ask(client: ControlClient, action: str, keys: dict[str, Any]) -> int:
    answer = client.ask(action, **keys)
    if answer["ok"]:
        typer.echo(answer["text"])
        return 0
    is_bad = answer["reason"] in ("bad_request", "too_long")
    return complain(answer["text"], exit_codes.BAD_INPUT if is_bad else exit_codes.NOT_DONE)


def _status(client: ControlClient, as_json: bool) -> int:
    state = client.state()
    typer.echo(json.dumps({**client.hello, **state}) if as_json else "\n".join(status_lines(client.hello, state)))
    return 0


def status_lines(hello: Message, state: Message) -> list[str]:
    """A state as lines of text."""
    t_s, coming = state["t_s"], state["next"]
    time_text = "not begun" if t_s is None else f"{t_s:.1f} s"
    held = ", the scenario's clock is held" if state["held"] else ""
    lines = [f"{hello['scenario']}: {state['mode']}, {time_text}{held}, in {hello['folder']}"]
    rows = (
        ("level [cm]", state["measured_cm"], 2),
        ("reference [cm]", state["reference_cm"], 2),
        ("target [cm]", state["target_cm"], 2),
        ("command [V]", state["command_V"], 3),
        ("applied [V]", state["applied_V"], 3),
        ("effectiveness", state["effectiveness"], 2),
    )
    for name, values, digits in rows:
        lines.append(f"{name:15}" + "".join("       –" if v is None else f"{v:8.{digits}f}" for v in values))
    if state["interlock"] or state["waits_for"]:
        lines.append(f"{state['interlock'] or 'waits for'}: {state['waits_for'] or 'can be cleared'}")
    lines += [f"{name} bypassed for {left_s:.0f} s more" for name, left_s in state["bypassed"].items()]
    if coming is not None:
        lines.append(f"next: {coming['what']} in {coming['in_s']:.0f} s")
    lines += [f"alarm {row['key']} ({row['priority']}, {row['state']}): {row['title']}" for row in state["alarms"]]
    return lines


def _watch(client: ControlClient, as_json: bool) -> int:
    """States and events until the run ends. 0 only if it has said how: a killed run has not."""
    answer = client.ask("subscribe", rate_hz=WATCH_HZ)
    if not answer["ok"]:
        return complain(answer["text"], exit_codes.NOT_DONE)
    has_ended = False
    try:
        for message in client.messages():
            if as_json:
                typer.echo(json.dumps(message))
            elif "state" in message:
                typer.echo(_brief(message["state"]))
            elif "event" in message:
                typer.echo(f"{message['event']['severity']:5} {message['event']['text']}")
            has_ended |= message.get("event", {}).get("code") == "end"
    except ControlError as error:
        return 0 if has_ended else complain(str(error), exit_codes.NOT_DONE)
    return 0


def _brief(state: Message) -> str:
    """A state in one line."""
    t_s = state["t_s"]
    levels = " ".join(f"{level:6.2f}" for level in state["measured_cm"])
    volts = " ".join(f"{voltage:5.2f}" for voltage in state["applied_V"])
    return f"{'     –' if t_s is None else f'{t_s:8.1f}'} s  {state['mode']:9} {levels} cm  {volts} V"
