"""Every kind of fault by name, and the table of them for people.

A kind is a class with a `kind` in one of the family modules; nothing has to be listed here. `KINDS` feeds the check of
scenarios, `failure_command.COMPONENTS` (the commands and their help), `firmware-sim --faults` and the documentation.
"""

from collections.abc import Iterable
from types import ModuleType

from firmware_sim.faults import bus_faults, frame_faults, node_faults, pump_faults, sensor_faults, tank_faults
from firmware_sim.faults.base import FaultTable, kind_of
from firmware_sim.setting_types import allowed

FAMILIES = (pump_faults, tank_faults, sensor_faults, frame_faults, bus_faults, node_faults)


def kinds_in(families: Iterable[ModuleType]) -> dict[str, type[FaultTable]]:
    """Every class of these modules that is a kind of fault, by the name of the kind, in the order of the source."""
    tables = (one for family in families for one in vars(family).values() if isinstance(one, type))
    return {kind_of(one): one for one in tables if issubclass(one, FaultTable) and "kind" in one.model_fields}


KINDS = kinds_in(FAMILIES)


def targets_of(table: type[FaultTable]) -> str:
    """Targets that a kind takes, as text: "1, 2"."""
    field = table.model_fields["target"]
    return (table.targets_text or allowed(field)) + ("" if field.is_required() else ", or none")


def value_of(table: type[FaultTable]) -> str:
    """Values that a kind takes, with their unit, as text: "0 .. 60 s"; "" for none."""
    field = table.model_fields.get("value")
    if field is None:
        return ""
    return f"{allowed(field)} {table.unit}" + ("" if field.is_required() else ", or none")


def as_markdown(kinds: dict[str, type[FaultTable]] = KINDS) -> str:
    """The table of all kinds for the documentation, with the columns of its head."""
    head = "| kind | acts on | target | value | grows from | command | what happens |\n|---|---|---|---|---|---|---|\n"
    return head + "".join(f"| {' | '.join(_cells(kind, table))} |\n" for kind, table in kinds.items())


def as_text(kinds: dict[str, type[FaultTable]] = KINDS) -> str:
    """The kinds for a terminal: one line each, of kind, what it acts on, targets, values, growth."""
    return "".join(
        f"{kind:20} {f'{table.acts_on} {targets_of(table)}'}{f'; {value_of(table)}' if value_of(table) else ''}"
        f"{f'; grows from {table.grows_from}' if table.grows_from else ''}\n"
        for kind, table in kinds.items()
    )


def _cells(kind: str, table: type[FaultTable]) -> tuple[str, ...]:
    commands = ", ".join(f"`{word.component} {word.word}`" for word in table.words)
    what = " ".join((table.__doc__ or "").split())
    return (
        f"`{kind}`",
        table.acts_on,
        targets_of(table),
        value_of(table) or "-",
        table.grows_from or "-",
        commands,
        what,
    )
