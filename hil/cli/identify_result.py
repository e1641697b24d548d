"""The end of `hil identify`: writes the result, shows it, and replaces the rig file where that is wanted and earned."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hil.bench.identification_result import NotReplacedError, WrittenResult, replace_rig, write_result
from hil.cli import exit_codes
from hil.cli.complaint import complain
from hil.core.identification.improvement import misfit_sentence
from hil.core.identification.result import FittedParameter, Identification
from hil.review.identification_words import half_width, number, structure_words


def finish(
    console: Console,
    identification: Identification,
    rig_path: Path,
    out: Path,
    *,
    write: bool,
    now: datetime,
    duration_s: float | None = None,
    rerun: bool = True,
) -> int:
    """Write the result into the folder `out` and show it. Returns the exit code.

    write : whether to replace the rig file. Raises SettingsError, IncompleteRecordError.
    """
    result = write_result(identification, rig_path, out, duration_s=duration_s, rerun=rerun)
    _show(console, identification, result, rig_path)
    if identification.refusal:
        return complain(f"nothing was identified: {identification.refusal}", exit_codes.NOT_DONE)
    if not write:
        if result.improvement.is_enough and not result.trouble:
            _say(console, f"{rig_path} is as before; --write replaces it, and keeps a copy")
        return 0
    try:
        copy = replace_rig(result, rig_path, now)
    except NotReplacedError as error:
        return complain(str(error), exit_codes.NOT_DONE)
    _say(console, f"{rig_path} has the identified values; the old file is kept as {copy}")
    return 0


def _show(console: Console, identification: Identification, result: WrittenResult, rig_path: Path) -> None:
    if not identification.refusal:
        console.print(parameter_table(identification.parameters))
        _say(console, f"structure: {structure_words(identification)}")
        _say(console, result.improvement.sentence)
        if missing := misfit_sentence(identification):
            _say(console, missing)
    for direction in identification.null_directions:
        _say(console, f"not determined: {direction.text}")
    if result.rig is not None:
        _say(console, result.diff or f"{rig_path} says this already")
    for note in result.notes:
        _say(console, note)
    if result.trouble:
        _say(console, f"no run can use {result.rig}: {result.trouble}")
    _say(console, f"report: {result.report}")


def parameter_table(parameters: Sequence[FittedParameter]) -> Table:
    """A row for each parameter that was estimated."""
    table = Table(expand=False)
    for heading in ("", "old", "identified", "± 95 %", "unit"):
        table.add_column(heading, justify="right" if heading not in ("", "unit") else "left", no_wrap=True)
    for one in parameters:
        if one.status == "fixed":
            continue
        half = half_width(one)
        known = f"{half:.2g}" if one.status == "identified" else "[red]unknown[/]"
        unit = "" if one.unit == "1" else one.unit
        table.add_row(escape(one.name), f"{one.was:.5g}", number(one.value, half), known, unit)
    return table


def _say(console: Console, text: str) -> None:
    console.print(text, highlight=False, markup=False, soft_wrap=True)
