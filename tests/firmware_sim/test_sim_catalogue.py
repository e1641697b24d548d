"""One class makes a kind of fault known everywhere: check, `failure` command, help, table of the docs."""

from types import ModuleType
from typing import Annotated, Literal

import pytest

from firmware_sim.failure_command import components_for
from firmware_sim.faults.base import FailureWord, FaultTable, PumpNumber
from firmware_sim.faults.catalogue import FAMILIES, KINDS, as_markdown, as_text, kinds_in, value_of
from firmware_sim.setting_types import accepts, within


class Worn(FaultTable):
    """A pump loses `value` of its flow per hour."""

    acts_on = "pump"
    unit = "1/h"
    words = (FailureWord("pump", "worn"),)

    kind: Literal["worn"]
    target: PumpNumber
    value: Annotated[float, within(0.0, 2.5)]


@pytest.fixture
def kinds() -> dict[str, type[FaultTable]]:
    """The catalogue with one more class in one more module."""
    module = ModuleType("more_faults")
    vars(module).update(Worn=Worn, FaultTable=FaultTable)
    return kinds_in((*FAMILIES, module))


def test_a_new_class_is_a_kind_a_command_and_a_row_of_the_table(kinds: dict[str, type[FaultTable]]) -> None:
    assert list(kinds) == [*KINDS, "worn"]
    assert components_for(kinds)["pump"].types.keys() >= {"worn", "off", "pump_dead"}
    row = "| `worn` | pump | 1, 2 | 0 .. 2.5 1/h | - | `pump worn` | A pump loses `value` of its flow per hour. |\n"
    assert as_markdown(kinds) == as_markdown() + row
    assert as_text(kinds).splitlines()[-1].split() == ["worn", "pump", "1,", "2;", "0", "..", "2.5", "1/h"]


@pytest.mark.parametrize(("kind", "table"), KINDS.items(), ids=KINDS)
def test_every_kind_says_what_it_acts_on_its_unit_and_how_to_command_it(kind: str, table: type[FaultTable]) -> None:
    assert table.acts_on
    assert table.words
    assert (table.unit != "") == ("value" in table.model_fields)
    assert value_of(table).endswith((table.unit, ", or none"))
    assert f"| `{kind}` | {table.acts_on} | " in as_markdown()
    assert not table.grows_from or "value" in table.model_fields


def test_no_two_kinds_share_a_word_of_a_component() -> None:
    calls = [(word.component, word.word) for table in KINDS.values() for word in table.words]
    assert len(set(calls)) == len(calls)


@pytest.mark.parametrize(("kind", "table"), KINDS.items(), ids=KINDS)
def test_a_target_that_may_be_left_out_is_one_that_the_kind_accepts(kind: str, table: type[FaultTable]) -> None:
    """A default is not checked when a fault is built."""
    field = table.model_fields["target"]
    if not field.is_required():
        assert field.default in accepts(field).choices, kind
