"""Faults by command while the rig runs, in the words of PX4's `failure` command.

    failure <component> <failure type> [-i INSTANCE] [-v VALUE] [-r SECONDS] [-p SECONDS -d DUTY] [-t SECONDS]
    failure <component> ok [-i INSTANCE]
    failure help [<component>]

Instance 0, or none, means all of them. -r: the fault grows to its value in that time. -p, -d: it is there for the
share DUTY of every period. -t: it ends after that time. `ok` ends what acts on the component now. A failure type is
one of the component's words or a kind of fault by its own name; both come from the fault catalogue. The answer is one
line: "ok ..." or "error: ...".
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

from pydantic import ValidationError

from firmware_sim.faults.base import Fault, FaultTable
from firmware_sim.faults.catalogue import KINDS, value_of

USAGE = "failure <component> <failure type> [-i INSTANCE] [-v VALUE] [-r SECONDS] [-p SECONDS -d DUTY] [-t SECONDS]"

OPTIONS = {"-t": "until_s", "-r": "ramp_s", "-p": "period_s", "-d": "duty"}
"""Options, beside instance and value, and the keys of a [[fault]] that they set."""

TARGETS: dict[str, tuple[int | str, ...]] = {
    "pump": (1, 2),
    "valve": (1, 2),
    "reservoir": (0,),
    "tank": (1, 2, 3, 4),
    "level": (1, 2, 3, 4),
    "node": ("pump", "level"),
    "bus": ("all",),
    "frames": ("all",),
}
"""Components, and the fault's target for each of their instances 1, 2, ..."""

FRAME_COMPONENTS = {
    "pump_command": "PumpCommand",
    "pump_status": "PumpStatus",
    "lower_levels": "LowerLevels",
    "upper_levels": "UpperLevels",
    "pump_heartbeat": "PumpHeartbeat",
    "level_heartbeat": "LevelHeartbeat",
}
"""Components that are one frame each; they have the failure types of `frames`."""


class FailureCommandError(ValueError):
    """A command that can't be carried out."""


@dataclass(frozen=True)
class FailureType:
    """What a failure type stands for: a kind, its value if none is given, its target if it has its own."""

    kind: str
    value: float | None = None
    target: str | None = None


@dataclass(frozen=True)
class Component:
    """Something that can fail. targets : of instances 1, 2, ... . owns_kinds : `ok` ends its kinds on any target."""

    targets: tuple[int | str, ...]
    types: Mapping[str, FailureType]
    owns_kinds: bool = True


def components_for(kinds: Mapping[str, type[FaultTable]]) -> dict[str, Component]:
    """The components with the failure types that these kinds of fault name in their `words`."""
    components = {name: Component(targets, _types_of(name, kinds)) for name, targets in TARGETS.items()}
    frame_types = components["frames"].types
    frames = {name: Component((frame,), frame_types, owns_kinds=False) for name, frame in FRAME_COMPONENTS.items()}
    return {**components, **frames}


def _types_of(component: str, kinds: Mapping[str, type[FaultTable]]) -> dict[str, FailureType]:
    """Failure types of a component: the words first, then the kinds' own names."""
    calls = [(kind, call) for kind, table in kinds.items() for call in table.words if call.component == component]
    types = {call.word: FailureType(kind, call.value, call.target) for kind, call in calls}
    own_names: dict[str, FailureType] = {}
    for kind, call in calls:
        own_names.setdefault(kind, FailureType(kind, target=call.target))
    return {**types, **own_names}


COMPONENTS = components_for(KINDS)


class Injector(Protocol):
    """What a command acts on: the rig."""

    def inject(self, fault: Fault, now_ns: int) -> None:
        """Let a fault begin now."""

    def recover(self, kinds: set[str], targets: set[int | str] | None, now_ns: int) -> int:
        """End what is active of these kinds and targets (None: any); return how many faults that were."""


@dataclass(frozen=True)
class FailureOptions:
    """What follows a failure type.

    instance : 0 for all. value : None where none was given. times : the others that were given, by key of a [[fault]].
    """

    instance: int = 0
    value: float | None = None
    times: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FailureCommand:
    """A checked command: its component and failure type exist."""

    component_name: str
    component: Component
    type_name: str
    options: FailureOptions = field(default_factory=FailureOptions)

    @property
    def targets(self) -> tuple[int | str, ...]:
        """Targets that the instance selects."""
        instance = self.options.instance
        return self.component.targets if instance == 0 else self.component.targets[instance - 1 : instance]


def execute(line: str, rig: Injector, now_ns: int) -> str:
    """Carry a command out on the rig at now_ns and return its answer. Raises nothing for bad commands."""
    try:
        words = line.split()
        if words[:2] == ["failure", "help"]:
            return _help(words[2:])
        command = parse(words)
        if command.type_name == "ok":
            kinds = {failure_type.kind for failure_type in command.component.types.values()}
            is_any = command.component.owns_kinds and command.options.instance == 0
            count = rig.recover(kinds, None if is_any else set(command.targets), now_ns)
            return f"ok {command.component_name}: {count} ended"
        faults = build(command)
    except FailureCommandError as error:
        return f"error: {error}"
    for fault in faults:
        rig.inject(fault, now_ns)
    return f"ok {faults[0].kind} {', '.join(str(fault.target) for fault in faults)}"


def parse(words: list[str]) -> FailureCommand:
    """Read a command. Raises FailureCommandError."""
    if not words or words[0] != "failure":
        raise FailureCommandError(f"unknown command {words[0]!r}: {USAGE}" if words else f"empty: {USAGE}")
    if len(words) < 2:
        raise FailureCommandError(f"component is missing: one of {', '.join(COMPONENTS)}")
    name, component = words[1], _component(words[1])
    if len(words) < 3 or words[2] not in ("ok", *component.types):
        what = f"{name} has no failure type {words[2]!r}" if len(words) > 2 else f"failure type of {name} is missing"
        raise FailureCommandError(f"{what}: one of ok, {', '.join(component.types)}")
    options = _options(words[3:])
    highest = len(component.targets)
    if not 0 <= options.instance <= highest:
        raise FailureCommandError(f"-i {options.instance}: {name} has instances 1 .. {highest}, and 0 for all")
    if words[2] == "ok" and (options.value is not None or options.times):
        raise FailureCommandError(f"{name} ok takes neither -v nor -t, -r, -p, -d")
    return FailureCommand(name, component, words[2], options)


def build(command: FailureCommand) -> tuple[Fault, ...]:
    """Make the faults that a command asks for, one for each target. Raises FailureCommandError."""
    failure_type, options = command.component.types[command.type_name], command.options
    table, called = KINDS[failure_type.kind], f"{command.component_name} {command.type_name}"
    value = failure_type.value if options.value is None else options.value
    if "value" not in table.model_fields and options.value is not None:
        raise FailureCommandError(f"{called} takes no -v")
    given: dict[str, Any] = {"kind": failure_type.kind, "at_s": 0.0}
    given |= {} if value is None else {"value": value}
    given |= options.times
    targets = command.targets if failure_type.target is None else (failure_type.target,)
    try:
        return tuple(cast(Fault, table.model_validate({**given, "target": target})) for target in targets)
    except ValidationError as error:
        complaint = error.errors(include_url=False)[0]
    key = complaint["loc"][0]
    if complaint["type"] == "missing":
        raise FailureCommandError(f"{called} needs -v VALUE: {value_of(table)}")
    option = next((option for option, name in OPTIONS.items() if name == key), "-v")
    shown = value if option == "-v" else options.times.get(str(key))
    raise FailureCommandError(f"{option}{'' if shown is None else f' {shown:g}'}: {_in_options(complaint['msg'])}")


def _in_options(message: str) -> str:
    """A message about a [[fault]], with the options in place of the keys."""
    for option, key in OPTIONS.items():
        message = message.replace(key, option)
    return message


def _component(name: str) -> Component:
    if name not in COMPONENTS:
        raise FailureCommandError(f"unknown component {name!r}: one of {', '.join(COMPONENTS)}")
    return COMPONENTS[name]


def _help(names: list[str]) -> str:
    """The components, or one component's failure types with the values that they take."""
    if not names:
        return f"ok {USAGE}; components: {', '.join(COMPONENTS)}"
    component = _component(names[0])
    types = []
    for name, failure_type in component.types.items():
        table = KINDS[failure_type.kind]
        value, growth = value_of(table), "; -r" if table.grows_from else ""
        types.append(f"{name} (-v {value}{growth})" if value else name)
    return f"ok {names[0]} -i 1 .. {len(component.targets)}: ok, {', '.join(types)}"


def _options(words: list[str]) -> FailureOptions:
    found: dict[str, float] = {}
    for flag, text in zip(words[::2], [*words[1::2], None], strict=False):
        if flag not in ("-i", "-v", *OPTIONS):
            raise FailureCommandError(f"unknown option {flag!r}: must be one of -i, -v, {', '.join(OPTIONS)}")
        if text is None:
            raise FailureCommandError(f"{flag} needs a number")
        if flag in found:
            raise FailureCommandError(f"{flag} is given twice")
        found[flag] = _number(flag, text)
    instance = found.get("-i", 0.0)
    if not instance.is_integer():
        raise FailureCommandError(f"-i {instance:g}: must be a whole number")
    return FailureOptions(
        int(instance), found.get("-v"), {key: found[option] for option, key in OPTIONS.items() if option in found}
    )


def _number(flag: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise FailureCommandError(f"{flag} {text}: must be a number")
    return number
