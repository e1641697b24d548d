"""The emulator's console: each kind that the panel knows is one that the emulator takes, with the values it says."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from textual.widgets import Static

from firmware_sim.failure_command import execute
from firmware_sim.faults.base import Fault
from firmware_sim.faults.pump_faults import PumpEffectiveness
from hil.core.fault_kinds import FaultKind
from hil.panel.console_page import fault_form
from hil.panel.emulator_client import COMPONENTS, EmulatorClient, end_command, value_words
from hil.panel.entry_forms import EntryError
from hil.panel.panel_app import PanelApp
from tests.panel.test_panel import until


class NoRig:
    """Stands for the rig: keeps what it was told."""

    def __init__(self) -> None:
        self.faults: list[Fault] = []

    def inject(self, fault: Fault, now_ns: int) -> None:
        """A fault."""
        del now_ns
        self.faults.append(fault)

    def recover(self, kinds: set[str], targets: set[int | str] | None, now_ns: int) -> int:
        """The end of faults."""
        del kinds, targets, now_ns
        count = len(self.faults)
        self.faults.clear()
        return count


def help_of(kind: FaultKind) -> str:
    return execute(f"failure help {COMPONENTS[kind.acts_on]}", NoRig(), 0)


@pytest.mark.parametrize("kind", FaultKind)
def test_the_emulator_takes_every_kind_as_the_panel_sends_it(kind: FaultKind) -> None:
    words = value_words(kind, help_of(kind))
    form = fault_form(kind, words)
    low = words.split(" ..")[0] if words else ""
    typed = {"target": "1", "value": low, "ramp s": "5" if "-r" in words else "", "ends s": "9"}
    rig = NoRig()
    request = form.check([typed[field.label] for field in form.fields]).request
    answer = execute(str(request["line"]), rig, 0)
    assert answer.startswith(f"ok {kind}"), answer
    assert [fault.kind for fault in rig.faults] == [kind]
    assert execute(end_command(kind), rig, 0).endswith("1 ended")


def test_a_wrong_target_and_a_word_in_place_of_a_number_are_refused() -> None:
    form = fault_form(
        FaultKind.PUMP_EFFECTIVENESS, value_words(FaultKind.PUMP_EFFECTIVENESS, help_of(FaultKind.PUMP_DEAD))
    )
    with pytest.raises(EntryError, match="target 3: must be 1 to 2, or 0 for all"):
        form.check(["3", "0.4", "", ""])
    with pytest.raises(EntryError, match="value much: must be a number"):
        form.check(["1", "much", "", ""])


def test_a_fault_is_injected_from_the_panel_by_keys(tmp_path: Path) -> None:
    rig = NoRig()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        line = (await reader.readline()).decode()
        writer.write(execute(line, rig, 0).encode() + b"\n")
        writer.close()

    async def session() -> None:
        path = tmp_path / "emulator"
        async with await asyncio.start_unix_server(serve, path):
            app = PanelApp(lambda: tmp_path / "none", emulator=EmulatorClient(str(path)))
            async with app.run_test(size=(80, 24)) as pilot:
                await pilot.press("4", "enter")
                await until(pilot, lambda: len(app.screen_stack) == 2)
                await pilot.press("enter", "0", ".", "4", "enter", "enter", "enter")
                await until(pilot, lambda: len(rig.faults) == 1)
                answers = app.query_one("#emulator-answers", Static)
                await until(pilot, lambda: "ok pump_effectiveness 1" in str(answers.render()))
                assert isinstance(rig.faults[0], PumpEffectiveness)
                assert rig.faults[0].value == 0.4

    asyncio.run(session())


def test_a_missing_emulator_is_said(tmp_path: Path) -> None:
    answer = asyncio.run(EmulatorClient(str(tmp_path / "none")).command("failure help"))
    assert answer == f"error: no emulator at {tmp_path / 'none'}: No such file or directory"
