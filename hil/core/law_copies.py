"""Copies of what a control law is given, so that whatever it does to them can't change what the interlocks work with.

Dataclasses are frozen, but `object.__setattr__` changes a frozen one all the same; a NamedTuple like `Estimate` can't
be changed at all. The laws of this project only read what they are given, so they get it as it is.
"""

from __future__ import annotations

from dataclasses import fields, replace
from operator import attrgetter
from typing import Any, TypeVar

from hil.core.control_law import LawInputs
from hil.core.following import Followed
from hil.core.reference_path import RunReferences
from hil.core.start_phase import StartPhase
from hil.core.types import Diagnosis

Record = TypeVar("Record")

_VALUES: dict[type[Any], Any] = {
    kind: attrgetter(*(field.name for field in fields(kind)))
    for kind in (LawInputs, Diagnosis, Followed, RunReferences, StartPhase)
}
"""All values of a record in the order of its constructor: at every step, a third of the time of `replace`."""


OWN_LAWS = "hil.core.laws."
"""The package of this project's laws."""


def is_own(law: object) -> bool:
    """Whether a law is one of this project's."""
    return type(law).__module__.startswith(OWN_LAWS)


def copied(record: Record) -> Record:
    """A record like it, with the same values."""
    kind = type(record)
    values = _VALUES.get(kind)
    return replace(record) if values is None else kind(*values(record))  # type: ignore[type-var]


def inputs_of_law(known: LawInputs, references: RunReferences) -> LawInputs:
    """The inputs with copies of all records in them that can be changed, since the loop goes on to use them.

    references : those in `known`.
    """
    new = copied(known)
    start = references.start
    for name, value in (
        ("diagnosis", copied(known.diagnosis)),
        ("followed", copied(known.followed)),
        ("references", RunReferences(references.schedule, None if start is None else copied(start), references.moves)),
    ):
        object.__setattr__(new, name, value)
    return new
