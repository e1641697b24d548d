"""Faults by command while the rig runs, in the words of PX4's `failure` command.

    failure <component> <failure type> [-i INSTANCE] [-v VALUE] [-t SECONDS]
    failure <component> ok [-i INSTANCE]

Instance 0, or none, means all of them. `ok` ends what acts on the component now. A failure type is one of the
component's words or a kind of fault by its own name. The answer is one line: "ok ..." or "error: ...".
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

from pydantic import ValidationError

from firmware_sim.faults.base import Fault
from firmware_sim.faults.catalogue import KINDS

USAGE = "failure <component> <failure type> [-i INSTANCE] [-v VALUE] [-t SECONDS]"


class CommandError(ValueError):
    """A command that can't be carried out."""


@dataclass(frozen=True)
class Word:
    """A failure type: the kind that it stands for, its value if none is given, its target if it has its own."""

    kind: str
    value: float | None = None
    target: str | None = None


@dataclass(frozen=True)
class Component:
    """Something that can fail. targets : of instances 1, 2, ... . owns_kinds : `ok` ends its kinds on any target."""

    targets: tuple[int | str, ...]
    words: Mapping[str, Word]
    owns_kinds: bool = True


def _words(**kinds: str | Word) -> dict[str, Word]:
    """Words of a component, its kinds' own names among them."""
    words = {word: Word(kind) if isinstance(kind, str) else kind for word, kind in kinds.items()}
    own_names = {word.kind: Word(word.kind, target=word.target) for word in reversed(words.values())}
    return {**words, **own_names}


_FRAME_WORDS = _words(
    off=Word("frame_loss", 1.0),
    intermittent="frame_loss",
    burst="frame_burst",
    delayed="frame_delay",
    duplicate="frame_duplicate",
    reorder="frame_reorder",
    garbage=Word("frame_corrupt", 1.0),
    stuck="counter_stuck",
    short="wrong_length",
    wrong="wrong_id",
    extended="extended_id",
    remote="remote_frame",
)

COMPONENTS: dict[str, Component] = {
    "pump": Component(
        (1, 2), _words(off="pump_dead", stuck="pump_stuck_on", slow="pump_lag", wrong="pump_effectiveness")
    ),
    "valve": Component((1, 2), _words(wrong="valve_split")),
    "reservoir": Component((0,), _words(off="reservoir_low")),
    "tank": Component((1, 2, 3, 4), _words(leak="leak", blocked="outlet_block")),
    "level": Component(
        (1, 2, 3, 4),
        _words(
            off="sensor_open",
            stuck="sensor_stuck",
            garbage="sensor_garbage",
            wrong="sensor_bias",
            drift="sensor_drift",
            noise="sensor_noise",
        ),
    ),
    "node": Component(
        ("pump", "level"),
        _words(off="node_silent", reboot="node_reboot", no_heartbeat="heartbeat_stop", clock="clock_jump"),
    ),
    "bus": Component(
        ("all",),
        _words(
            off="bus_off",
            errors="error_frames",
            babble=Word("babble", target="foreign"),
            flood=Word("babble", target="top"),
            command=Word("foreign_command", target="PumpCommand"),
        ),
    ),
    "frames": Component(("all",), _FRAME_WORDS),
    "pump_command": Component(("PumpCommand",), _FRAME_WORDS, owns_kinds=False),
    "pump_status": Component(("PumpStatus",), _FRAME_WORDS, owns_kinds=False),
    "lower_levels": Component(("LowerLevels",), _FRAME_WORDS, owns_kinds=False),
    "upper_levels": Component(("UpperLevels",), _FRAME_WORDS, owns_kinds=False),
    "pump_heartbeat": Component(("PumpHeartbeat",), _FRAME_WORDS, owns_kinds=False),
    "level_heartbeat": Component(("LevelHeartbeat",), _FRAME_WORDS, owns_kinds=False),
}


class Injector(Protocol):
    """What a command acts on: the rig."""

    def inject(self, fault: Fault, now_ns: int) -> None:
        """Let a fault begin now."""

    def recover(self, kinds: set[str], targets: set[int | str] | None, now_ns: int) -> int:
        """End what is active of these kinds and targets (None: any); return how many faults that were."""


@dataclass(frozen=True)
class Options:
    """What follows a failure type; None where nothing was given. instance 0 : all."""

    instance: int = 0
    value: float | None = None
    lasts_s: float | None = None


@dataclass(frozen=True)
class Command:
    """A command that names something that is there."""

    component_name: str
    component: Component
    type_name: str
    options: Options = field(default_factory=Options)

    @property
    def targets(self) -> tuple[int | str, ...]:
        """Targets meant by the instance."""
        instance = self.options.instance
        return self.component.targets if instance == 0 else self.component.targets[instance - 1 : instance]


def obey(line: str, rig: Injector, now_ns: int) -> str:
    """Carry a command out on the rig at now_ns and return its answer. Raises nothing for bad commands."""
    try:
        words = line.split()
        if words == ["failure", "help"]:
            return f"ok {USAGE}; components: {', '.join(COMPONENTS)}"
        command = parse(words)
        if command.type_name == "ok":
            kinds = {word.kind for word in command.component.words.values()}
            is_any = command.component.owns_kinds and command.options.instance == 0
            count = rig.recover(kinds, None if is_any else set(command.targets), now_ns)
            return f"ok {command.component_name}: {count} ended"
        faults = build(command)
    except CommandError as error:
        return f"error: {error}"
    for fault in faults:
        rig.inject(fault, now_ns)
    return f"ok {faults[0].kind} {', '.join(str(fault.target) for fault in faults)}"


def parse(words: list[str]) -> Command:
    """Read a command. Raises CommandError."""
    if not words or words[0] != "failure":
        raise CommandError(f"unknown command {words[0]!r}: {USAGE}" if words else f"empty: {USAGE}")
    if len(words) < 2 or words[1] not in COMPONENTS:
        what = f"unknown component {words[1]!r}" if len(words) > 1 else "component is missing"
        raise CommandError(f"{what}: one of {', '.join(COMPONENTS)}")
    name, component = words[1], COMPONENTS[words[1]]
    if len(words) < 3 or words[2] not in ("ok", *component.words):
        what = f"{name} has no failure type {words[2]!r}" if len(words) > 2 else f"failure type of {name} is missing"
        raise CommandError(f"{what}: one of ok, {', '.join(component.words)}")
    options = _options(words[3:])
    highest = len(component.targets)
    if not 0 <= options.instance <= highest:
        raise CommandError(f"-i {options.instance}: {name} has instances 1 .. {highest}, and 0 for all")
    if words[2] == "ok" and (options.value is not None or options.lasts_s is not None):
        raise CommandError(f"{name} ok takes neither -v nor -t")
    return Command(name, component, words[2], options)


def build(command: Command) -> tuple[Fault, ...]:
    """Make the faults that a command asks for, one for each target. Raises CommandError."""
    word, options = command.component.words[command.type_name], command.options
    table, called = KINDS[word.kind], f"{command.component_name} {command.type_name}"
    value = word.value if options.value is None else options.value
    if "value" not in table.model_fields and options.value is not None:
        raise CommandError(f"{called} takes no -v")
    given: dict[str, Any] = {"kind": word.kind, "at_s": 0.0}
    given |= {} if value is None else {"value": value}
    given |= {} if options.lasts_s is None else {"until_s": options.lasts_s}
    targets = command.targets if word.target is None else (word.target,)
    try:
        return tuple(cast(Fault, table.model_validate({**given, "target": target})) for target in targets)
    except ValidationError as error:
        complaint = error.errors(include_url=False)[0]
    key = complaint["loc"][0]
    if complaint["type"] == "missing":
        raise CommandError(f"{called} needs -v VALUE")
    option, shown = ("-t", options.lasts_s) if key == "until_s" else ("-v", value)
    raise CommandError(f"{option} {shown:g}: {complaint['msg']}")


def _options(words: list[str]) -> Options:
    found: dict[str, float] = {}
    for flag, text in zip(words[::2], [*words[1::2], None], strict=False):
        if flag not in ("-i", "-v", "-t"):
            raise CommandError(f"unknown option {flag!r}: -i, -v and -t there are")
        if text is None:
            raise CommandError(f"{flag} needs a number")
        if flag in found:
            raise CommandError(f"{flag} is there twice")
        found[flag] = _number(flag, text)
    instance = found.get("-i", 0.0)
    if not instance.is_integer():
        raise CommandError(f"-i {instance:g}: must be a whole number")
    return Options(int(instance), found.get("-v"), found.get("-t"))


def _number(flag: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise CommandError(f"{flag} {text}: must be a number")
    return number
