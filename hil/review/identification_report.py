"""The report of an identification, `report.html`: one file that needs nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

from hil.core.counted import counted
from hil.core.identification.improvement import Improvement, improvement, misfit_sentence, row_noise_V
from hil.core.identification.result import FittedParameter, Identification
from hil.review import identification_figures as figures
from hil.review import page, run_figures
from hil.review.identification_words import half_width, number, sentence, structure_words


@dataclass(frozen=True)
class ReportFacts:
    """What the report says beside the identification.

    rig_name : of the file that it started from. duration_s : of all records together. voltage_V : (2,) at which the
    pumps' flows are compared. diff, notes, trouble : of the rig files, see `hil.edge.config.identified_rig`.
    """

    rig_name: str
    duration_s: float
    voltage_V: tuple[float, float]
    diff: str = ""
    notes: Sequence[str] = ()
    trouble: str = ""


def render(identification: Identification, facts: ReportFacts) -> str:
    """The page's HTML."""
    found = {one.name: one for one in identification.parameters}
    better = improvement(identification)
    said = {
        one: sentence(one, found, facts.voltage_V[1 if one.name.endswith("2") else 0])
        for one in identification.parameters
    }
    fixed = [text for one, text in said.items() if one.status == "fixed"]
    title = f"{counted(len(fixed), 'parameter', 'parameters')} not estimated"
    if identification.refusal:
        body = _header(identification, facts) + page.section(
            "What the records do not tell",
            _undetermined(identification) + page.bullets([text for one, text in said.items() if one.status != "fixed"]),
        )
        return page.document(f"Identification: {facts.rig_name}", body + _rig_file(identification, facts))
    body = "".join(
        (
            _header(identification, facts),
            _cards(identification, better),
            page.section(
                "What the rig is",
                page.bullets([text for one, text in said.items() if one.status != "fixed"])
                + (page.fold(title, "\n".join(fixed)) if fixed else ""),
            ),
            page.section("What the records do not tell", _undetermined(identification)),
            page.section("Does it predict better?", _held_out(identification, better)),
            page.section("Parameters", _table(identification.parameters)),
            page.section("Figures", _figures(identification)),
            page.section("Rig file", _rig_file(identification, facts)),
        )
    )
    return page.document(f"Identification: {facts.rig_name}", body)


def _header(identification: Identification, facts: ReportFacts) -> str:
    trained = [one.name for one in identification.predictions if not one.is_held_out]
    held_out = [one.name for one in identification.predictions if one.is_held_out]
    pairs = [
        ("started from", facts.rig_name),
        ("records", f"{facts.duration_s / 60.0:.1f} min" if facts.duration_s > 0.0 else ""),
        ("structure", "" if identification.refusal else structure_words(identification)),
        ("fitted to", ", ".join(trained)),
        ("held out", ", ".join(held_out)),
    ]
    state = "failed" if identification.refusal else "stopped" if _is_open(identification) else "complete"
    words = {"failed": "refused", "stopped": "not all identifiable", "complete": "identified"}[state]
    why = f'<p class="ERROR">{page.escape(identification.refusal)}</p>' if identification.refusal else ""
    known = page.facts([(name, text) for name, text in pairs if text])
    return f"<header><h1>Identification{page.badge(state, words)}</h1>{why}{known}</header>\n"


def _is_open(identification: Identification) -> bool:
    return any(one.status == "not identifiable" for one in identification.parameters)


def _cards(identification: Identification, better: Improvement) -> str:
    counts = {
        status: sum(one.status == status for one in identification.parameters)
        for status in ("identified", "fixed", "not identifiable")
    }
    pairs = [
        ("parameters identified", f"{counts['identified']}"),
        ("not identifiable", f"{counts['not identifiable']}"),
        ("held-out error, old file", _millivolts(better.before_V)),
        ("held-out error, identified", _millivolts(better.after_V)),
    ]
    return page.cards(pairs)


def _undetermined(identification: Identification) -> str:
    return page.bullets([one.text for one in identification.null_directions])


def _held_out(identification: Identification, better: Improvement) -> str:
    judges = [one for one in identification.predictions if one.is_held_out]
    errors = zip(identification.holdout_rmse_before_V, identification.holdout_rmse_V, strict=True)
    rows = [
        [f"sensor {tank + 1}", _millivolts(before_V), _millivolts(after_V), _millivolts(row_noise_V(judges, tank))]
        for tank, (before_V, after_V) in enumerate(errors)
    ]
    heads = ["RMS error of the simulation", "old file", "identified", "noise of a row"]
    missing = misfit_sentence(identification)
    warning = f'<p class="WARN">{page.escape(missing)}</p>' if missing else ""
    return page.paragraphs([better.sentence]) + warning + page.table(heads, rows, numeric=frozenset((1, 2, 3)))


def _table(parameters: Sequence[FittedParameter]) -> str:
    heads = ["parameter", "", "old", "identified", "95 % from", "to", "unit", "change"]
    rows = []
    shown = [one for one in parameters if one.status != "fixed"]
    for one in shown:
        half = half_width(one)
        known = one.status == "identified"
        change = f"{(one.value / one.was - 1.0) * 100:+.3g} %" if one.was != 0.0 and one.value != one.was else ""
        ends = [number(one.low, half), number(one.high, half)] if known else ["", ""]
        rows.append([one.name, one.status, f"{one.was:.6g}", number(one.value, half), *ends, one.unit, change])
    marks = ["WARN" if one.status == "not identifiable" else "soft" for one in shown]
    return page.table(heads, rows, numeric=frozenset((2, 3, 4, 5, 7)), classes=marks) if rows else ""


def _figures(identification: Identification) -> str:
    with run_figures.style():
        narrow = [*_interval_figures(identification), *_prediction_figures(identification)]
        wide = _record_figures(identification)
    drawn = "".join(page.figure(svg, title, text) for title, text, svg in narrow if svg)
    drawn += "".join(page.figure(svg, title, text, is_wide=True) for title, text, svg in wide)
    return f'<div class="figures">{drawn}</div>\n' if drawn else ""


def _interval_figures(identification: Identification) -> list[tuple[str, str, str]]:
    text = "Values and 95 % intervals in per cent of the old value."
    return [
        ("Intervals.", text, figures.intervals(identification.parameters)),
        ("New in the file.", "Parameters that were zero before.", figures.new_values(identification.parameters)),
    ]


def _prediction_figures(identification: Identification) -> list[tuple[str, str, str]]:
    before = {one.name: one for one in identification.predictions_before}
    parts = [
        (
            "Held-out record.",
            f"Record {one.name}, which had no part in the fit: measured, and predicted by both files.",
            figures.held_out(before[one.name], one),
        )
        for one in identification.predictions
        if one.is_held_out and one.name in before
    ]
    if identification.predictions:
        text = "Of all records together; grey: 95 % band for white noise."
        parts.append(("Autocorrelation of the residuals.", text, figures.autocorrelation(identification.predictions)))
    return parts


def _record_figures(identification: Identification) -> list[tuple[str, str, str]]:
    shown, model = identification.predictions, identification.model
    if not shown:
        return []
    return [
        ("Residuals.", "Reading less prediction; shaded: 95 % of the noise.", figures.residuals(shown)),
        ("Readings.", "Measured (pale) and predicted; grey: held out.", figures.readings(shown)),
        ("Levels.", "The same as levels, by the identified sensors.", figures.levels(shown, model)),
    ]


def _rig_file(identification: Identification, facts: ReportFacts) -> str:
    if identification.refusal:
        return page.paragraphs([f"No rig file was written; {facts.rig_name} stays as it is."])
    parts = page.paragraphs(list(facts.notes))
    if facts.trouble:
        parts = f'<p class="ERROR">No run can use the identified file: {page.escape(facts.trouble)}</p>' + parts
    lines = facts.diff.splitlines()
    changed = sum(line.startswith("+") and not line.startswith("+++") for line in lines)
    summary = f"{counted(changed, 'line differs', 'lines differ')} from {facts.rig_name}"
    return parts + (
        page.paragraphs([f"{summary}."]) + page.diff(facts.diff)
        if lines
        else page.paragraphs([f"The identified file says the same as {facts.rig_name}."])
    )


def _millivolts(value_V: float) -> str:
    if not isfinite(value_V):
        return "–"
    return f"{value_V * 1e3:.3g} mV" if value_V < 0.9995 else f"{value_V:.3g} V"
