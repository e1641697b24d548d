"""Records that are built quickly: the same as other frozen dataclasses, but for the time that it takes."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import FrozenInstanceError, dataclass, field, replace

import pytest

from hil.core.quick_records import quickly_built
from hil.core.types import Command


@quickly_built
@dataclass(frozen=True, slots=True)
class Recorded:
    """A record whose field has the name of a local variable of `quickly_built`; a default, and a factory."""

    record: float
    names: tuple[str, ...] = ("a", "b")
    values: dict[str, float] = field(default_factory=dict)


def test_a_record_has_the_values_it_was_given_and_its_defaults() -> None:
    """By position or by name; every record has its own dictionary."""
    one, other = Recorded(1.0), Recorded(record=2.0, names=(), values={"k": 3.0})
    assert type(one) is Recorded
    assert (one.record, one.names, one.values) == (1.0, ("a", "b"), {})
    assert (other.record, other.names, other.values) == (2.0, (), {"k": 3.0})
    assert one.values is not Recorded(1.0).values
    assert repr(one) == "Recorded(record=1.0, names=('a', 'b'), values={})"


def test_wrong_arguments_are_errors() -> None:
    """Of the same kind as those of any function."""
    with pytest.raises(TypeError, match="record"):
        Recorded()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="unknown"):
        Recorded(1.0, unknown=2.0)  # type: ignore[call-arg]


def test_a_record_is_frozen() -> None:
    """Neither assignment nor deletion changes it."""
    command = Command((1.0, 2.0), enable=True)
    with pytest.raises(FrozenInstanceError):
        command.enable = False  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        del command.voltage_V
    assert command == Command(voltage_V=(1.0, 2.0), enable=True)


def test_a_record_is_compared_replaced_and_copied_as_others_are() -> None:
    """Equality and hash by value."""
    command = Command((1.0, 2.0), enable=True)
    assert replace(command, clear_trip=True) == Command((1.0, 2.0), enable=True, clear_trip=True)
    assert hash(command) == hash(Command((1.0, 2.0), enable=True))
    assert deepcopy(command) == command


def test_a_class_that_does_more_when_it_is_built_is_refused() -> None:
    """Its own constructor, a base class's fields and `__post_init__` would be left out."""

    @dataclass(frozen=True)
    class WithoutSlots:
        value: float

    @dataclass(slots=True)
    class Open:
        value: float

    @dataclass(frozen=True, slots=True)
    class Checked:
        value: float

        def __post_init__(self) -> None:
            """Checks nothing."""

    @dataclass(frozen=True, slots=True)
    class Derived(Recorded):
        value: float = 0.0

    for kind in (WithoutSlots, Open, Checked, Derived):
        with pytest.raises(TypeError, match=kind.__name__):
            quickly_built(kind)
