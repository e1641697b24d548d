"""The small set of HTML parts that the report is made of. Every text that comes in is escaped here."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape as escape
from typing import Any

WIDE_COLUMNS = 12
"""From so many columns on a table has smaller letters, so that its last columns are on the page."""

_CSS = """
:root{color-scheme:light;--ink:#22303c;--soft:#5f6c78;--rule:#dfe4e8;--wash:#f5f7f9;--blue:#1f6fb2;--orange:#cc5a24;
--green:#2f7d4f;--red:#b3261e}
*{box-sizing:border-box}
body{margin:0;background:#fff;color:var(--ink);font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
main{max-width:1180px;margin:0 auto;padding:1.6rem clamp(.9rem,3vw,2rem) 3rem}
header{border-bottom:2px solid var(--ink);padding-bottom:1rem;margin-bottom:1.4rem}
h1{font-size:1.65rem;line-height:1.2;margin:0 0 .35rem}
h2{font-size:1.12rem;margin:2rem 0 .6rem}
p{margin:.35rem 0}ul{margin:.35rem 0;padding-left:1.2rem}.soft{color:var(--soft)}
.badge{display:inline-block;padding:.05rem .6rem;border-radius:1rem;color:#fff;font-size:.85rem;font-weight:600;
vertical-align:.2em;margin-left:.6rem;background:var(--soft)}
.badge.complete{background:var(--green)}.badge.tripped,.badge.failed{background:var(--red)}
.badge.stopped,.badge.interrupted{background:var(--orange)}
dl.facts{display:flex;flex-wrap:wrap;gap:.2rem 1.8rem;margin:.8rem 0 0}
dl.facts div{display:flex;gap:.4rem}
dl.facts dt{color:var(--soft)}dl.facts dd{margin:0;font-variant-numeric:tabular-nums}
.cards{display:grid;grid-template-columns:repeat(4,1fr);gap:.7rem;margin:1.2rem 0}
@media (max-width:640px){.cards{grid-template-columns:1fr 1fr}}
.cards div{background:var(--wash);border-radius:.5rem;padding:.65rem .85rem}
.cards b{display:block;font-size:1.3rem;line-height:1.25;font-variant-numeric:tabular-nums}
.cards span{color:var(--soft);font-size:.86rem}
.scroll{overflow-x:auto}.named td:first-child{white-space:nowrap}
table{border-collapse:collapse;width:100%;font-size:.93rem;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:.34rem .7rem .34rem 0;border-bottom:1px solid var(--rule);vertical-align:top}
table.wide{font-size:.8rem}.wide th,.wide td{padding-right:.5rem}
th{color:var(--soft);font-weight:600;border-bottom-color:var(--ink)}
.n{text-align:right}td.n{white-space:nowrap}.WARN{color:var(--orange);font-weight:600}.ERROR{color:var(--red);font-weight:600}
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,470px),1fr));gap:1.4rem 1.8rem}
figure{margin:0;break-inside:avoid}figure.wide{grid-column:1/-1}figure svg{width:100%;height:auto;display:block}
figcaption{font-size:.9rem;color:var(--soft);margin-top:.25rem}figcaption b{color:var(--ink)}
details{border-top:1px solid var(--rule);padding:.45rem 0}summary{cursor:pointer;font-weight:600}
pre{background:var(--wash);border-radius:.5rem;padding:.8rem;overflow-x:auto;font-size:.82rem;line-height:1.4}
pre .came{color:var(--green)}pre .went{color:var(--red)}
@media print{body{font-size:11pt}main{max-width:none;padding:0}.figures{grid-template-columns:1fr 1fr}
.scroll{overflow:visible}}
"""


def document(title: str, body: str) -> str:
    """The whole page around its body (HTML)."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_CSS}</style></head>\n<body><main>\n{body}\n</main></body></html>\n"
    )


def section(title: str, body: str) -> str:
    """A headed part; nothing when the body is empty."""
    return f"<section><h2>{escape(title)}</h2>\n{body}</section>\n" if body else ""


def badge(status: str, words: str = "") -> str:
    """A status as a coloured mark. status : of a run, which gives the colour. words : in its place."""
    return f'<span class="badge {escape(status)}">{escape(words or status)}</span>'


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    """A line of names and values."""
    return (
        '<dl class="facts">'
        + "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in pairs)
        + "</dl>\n"
    )


def cards(pairs: Iterable[tuple[str, str]]) -> str:
    """Values large, their names small beneath."""
    return (
        '<div class="cards">'
        + "".join(f"<div><b>{escape(value)}</b><span>{escape(name)}</span></div>" for name, value in pairs)
        + "</div>\n"
    )


def table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numeric: frozenset[int] = frozenset(),
    classes: Sequence[str] | None = None,
) -> str:
    """A table. numeric : columns set flush right. classes : for each row, the class of its second cell."""
    mark = ['class="n"' if column in numeric else "" for column in range(len(heads))]
    wide = ' class="wide"' if len(heads) >= WIDE_COLUMNS else ""
    parts = [f'<div class="scroll"><table{wide}><thead><tr>']
    parts += [f"<th {mark[column]}>{escape(head)}</th>" for column, head in enumerate(heads)]
    parts.append("</tr></thead><tbody>\n")
    for number, row in enumerate(rows):
        parts.append("<tr>")
        for column, cell in enumerate(row):
            own = f'class="{escape(classes[number])}"' if classes is not None and column == 1 else mark[column]
            parts.append(f"<td {own}>{escape(cell)}</td>")
        parts.append("</tr>\n")
    return "".join(parts) + "</tbody></table></div>\n"


def figure(svg: str, title: str, caption: str, *, is_wide: bool = False) -> str:
    """A figure with its caption; `svg` goes in as it is. is_wide : as wide as the page."""
    mark = ' class="wide"' if is_wide else ""
    return f"<figure{mark}>{svg}<figcaption><b>{escape(title)}</b> {escape(caption)}</figcaption></figure>\n"


def fold(title: str, text: str) -> str:
    """A text that is shown on a click."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>\n"


def paragraphs(texts: Iterable[str]) -> str:
    """Each text as a paragraph."""
    return "".join(f"<p>{escape(text)}</p>\n" for text in texts)


def bullets(texts: Sequence[str]) -> str:
    """A list with a point for each text; nothing for none."""
    return "<ul>" + "".join(f"<li>{escape(text)}</li>\n" for text in texts) + "</ul>\n" if texts else ""


def diff(text: str) -> str:
    """A unified difference, lines that went and came in colour."""
    parts = []
    for line in text.splitlines():
        is_name = line.startswith(("+++", "---", "@@"))
        mark = "soft" if is_name else {"+": "came", "-": "went"}.get(line[:1], "")
        parts.append(f'<span class="{mark}">{escape(line)}</span>' if mark else escape(line))
    return "<pre>" + "\n".join(parts) + "</pre>\n"


def number(value: Any, digits: int) -> str:
    """A number with so many digits, a dash for anything else."""
    return f"{value:.{digits}g}" if isinstance(value, (int, float)) else "–"
