"""The report of a benchmark: one HTML file without references to anything outside."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from hil.campaigns import benchmark_table as texts
from hil.campaigns.benchmark_figures import Looks, course_ratios, error_and_noise, overall_ratios
from hil.campaigns.contests import Contest
from hil.campaigns.row import Row
from hil.campaigns.standing import Standings
from hil.campaigns.standings import NOISE_TOLERANCE, how_it_ended
from hil.edge.record.file_writing import write_atomically
from hil.review import page
from hil.review.run_figures import style

MAX_ROWS = 60
METHOD = (
    "A seed is the same rig, noise and fault for everybody, so entrants are compared seed by seed. Score of a run in a "
    "window: the IAE of both outputs. A run that ended before the window did is behind every run that ended: it counts "
    "as infinitely worse in ratio and rank, and is in no median of IAE.",
    "Ratio: median over the seeds of the score over that of the window's best, the entrant with the lowest median. "
    "Rank: mean over the seeds of the rank, equal scores sharing theirs. Limits: 95 % percentile bootstrap over the "
    "seeds, 2000 draws, the same for everybody. An entrant whose limits contain 1 is not told apart from the best.",
    "At equal noise: median score over the lowest one among the entrants whose sigma(v) is at most "
    f"{NOISE_TOLERANCE:g} times its own; 1 where nobody does better without more noise.",
)


def write_benchmark_report(path: Path, name: str, runs: Sequence[tuple[Contest, Row]], standings: Standings) -> Path:
    """Write the report and say where."""
    write_atomically(path, render(name, runs, standings))
    return path


def render(name: str, runs: Sequence[tuple[Contest, Row]], standings: Standings) -> str:
    """The page's HTML."""
    looks = Looks([one.entrant for one in standings.overall])
    rows = [row for _, row in runs]
    parts = [_header(name, rows, standings), _cards(rows, standings)]
    with style():
        parts += [_rig(standings, rig, looks) for rig in standings.rigs]
        parts.append(page.section("How it is compared", page.paragraphs(METHOD)))
        for course in standings.courses:
            own = sorted(standings.on(course), key=lambda one: one.rank.value)
            body = _named(texts.course_heads(), map(texts.course_line, own))
            figures = page.figure(course_ratios(own, looks), "Ratios", "to the best of this window") + page.figure(
                error_and_noise(own, looks),
                "Error and noise",
                "down and to the left is better; dashed: none is better in both",
            )
            title = f"{course.name}, rig {course.rig}"
            parts.append(page.section(title, body + f'<div class="figures">{figures}</div>\n'))
    parts.append(page.section("Detection", _detections(standings)))
    parts.append(page.section("Runs that did not go on to their end", _endings(runs)))
    parts.append(page.section("Broken invariants", _broken(runs)))
    return page.document(f"Benchmark {name}", "".join(parts))


def _header(name: str, rows: Sequence[Row], standings: Standings) -> str:
    state = "failed" if any(row.breaks for row in rows) else "complete"
    facts = [
        ("runs", str(len(rows))),
        ("laws", str(len({one.entrant.law for one in standings.overall}))),
        ("detectors", str(len({one.entrant.detector for one in standings.overall}))),
        ("rigs", ", ".join(standings.rigs)),
        ("seeds", f"{len(standings.seeds)}, {standings.seeds[0]} to {standings.seeds[-1]}"),
    ]
    return f"<header><h1>{page.escape(name)}{page.badge(state)}</h1>{page.facts(facts)}</header>\n"


def _cards(rows: Sequence[Row], standings: Standings) -> str:
    best = min(standings.overall, key=lambda one: one.rank.value)
    return page.cards(
        [
            ("best mean rank", best.entrant.name),
            ("runs that tripped", str(sum(bool(row.trip_cause) for row in rows))),
            ("runs that broke an invariant", str(sum(bool(row.breaks) for row in rows))),
            ("simulated", f"{sum(row.hours for row in rows):.3g} h"),
        ]
    )


def _rig(standings: Standings, rig: str, looks: Looks) -> str:
    courses = [course for course in standings.courses if course.rig == rig]
    heads, lines = texts.heads(courses), texts.lines(standings, rig)
    parts = 1 + len(texts.SUMMARY_HEADS)
    summary = _named(heads[:parts], [line[:parts] for line in lines])
    errors = _named([heads[0], *heads[parts:]], [[line[0], *line[parts:]] for line in lines])
    overall = [one for one in standings.overall if one.entrant.rig == rig]
    figure = page.figure(overall_ratios(overall, looks), "All windows", "1: the best of every window")
    about = f'<p class="soft">{page.escape(texts.ABOUT)}</p>'
    return page.section(f"Rig {rig}", f'{summary}<div class="figures">{figure}</div>\n') + page.section(
        f"IAE of outputs 1 / 2 [V s], rig {rig}", errors + about
    )


def _named(heads: Sequence[str], lines: Iterable[Sequence[str]], words: int = 1) -> str:
    """A table whose first column is a name. words : how many columns are none of figures."""
    return f'<div class="named">{page.table(heads, lines, numeric=frozenset(range(words, len(heads))))}</div>\n'


def _detections(standings: Standings) -> str:
    lines = [texts.detection_line(one) for one in standings.detections]
    return _named(texts.detection_heads(), lines, words=2) if lines else ""


def _endings(runs: Sequence[tuple[Contest, Row]]) -> str:
    lines = [
        [row.key, contest.case.label, contest.scenario, str(row.seed), how_it_ended(row),
         f"{3600.0 * row.hours:.1f}"]
        for contest, row in runs
        if how_it_ended(row)
    ]  # fmt: skip
    if not lines:
        return ""
    more = f"<p>and {len(lines) - MAX_ROWS} more, in runs.csv</p>" if len(lines) > MAX_ROWS else ""
    return page.table(["case", "entrant", "scenario", "seed", "how", "at [s]"], lines[:MAX_ROWS]) + more


def _broken(runs: Sequence[tuple[Contest, Row]]) -> str:
    lines = [
        [row.key, contest.case.label, contest.scenario, str(row.seed), row.broken]
        for contest, row in runs
        if row.breaks
    ]
    return page.table(["case", "entrant", "scenario", "seed", "what"], lines[:MAX_ROWS]) if lines else ""
