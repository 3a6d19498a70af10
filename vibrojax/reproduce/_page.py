"""The results as one page that loads nothing from outside: score, differences, then the groups with their pictures."""

import base64
import re
from html import escape
from io import BytesIO

from vibrojax.reproduce._entry import DIFFERS, NOT_COMPARED, VERDICTS
from vibrojax.reproduce._findings import FINDINGS, Finding
from vibrojax.reproduce._readings import READINGS
from vibrojax.reproduce._run import Reproduction, Result
from vibrojax.reproduce._style import STYLE
from vibrojax.store.provenance import source

_CLASSES = dict(zip(VERDICTS, ("differs", "uncompared", "trend", "agrees"), strict=True))
_EXPLAINED = [name for finding in FINDINGS for name in finding.ids]
_LEGEND = (
    "Agrees: within the tolerance that stands beside the result, with its reason. Agrees in trend: the tendency that "
    "the source shows is here too, but it gives no number for it, or ours is another one. Differs: what the source "
    "says does not hold here. Cannot be compared: its text does not say enough."
)


def page(found: Reproduction) -> str:
    """The page as HTML text, pictures within it."""
    results = found.results
    differing = sorted((one for one in results if one.here.verdict == DIFFERS), key=lambda one: _weight(one.entry.id))
    sections = [
        _head(found),
        _findings([one.entry.id for one in differing]),
        _first("What differs", differing),
        _first("What cannot be compared", [one for one in results if one.here.verdict == NOT_COMPARED]),
        *(_group(*part) for part in found.groups),
        _readings(),
        f"<footer>{escape(source())}; {len(results)} results in {found.wall_time:.0f} s. "
        "The datasets lie beside this page.</footer>",
    ]
    title = "The source, reproduced"
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(sections)
        + "\n</main>\n</body>\n</html>\n"
    )


def _text(text: str) -> str:
    """Text with what stands in backquotes as code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(text))


def _head(found: Reproduction) -> str:
    score = found.score
    tiles = "".join(
        f'<li class="{_CLASSES[verdict]}"><b>{score[verdict]}</b> {escape(verdict)}</li>'
        for verdict in reversed(VERDICTS)
    )
    links = "".join(f'<a href="#{group.name}">{escape(group.title)}</a>' for group, _, _ in found.groups)
    quick = "<p><strong>A quick run: only a part of the results.</strong></p>" * found.quick
    return (
        "<header><h1>The source, reproduced</h1>"
        "<p>Batako, <cite>A self-exciting system for percussive-rotary drilling</cite>, beside what vibrojax computes "
        "from the same equations. Every number here is a simulation or a closed form of this run; none of the source's "
        "numbers goes into ours. What the source does not say was read in one way (R1, R2, ..., listed below), and the "
        "reading is named beside the result.</p>"
        f'{quick}<ul class="score">{tiles}</ul><p>{escape(_LEGEND)}</p>'
        f'<nav>{links}<a href="#readings">Readings</a></nav></header>'
    )


def _weight(name: str) -> int:
    """Where a result stands among the findings, the weightiest first."""
    return _EXPLAINED.index(name) if name in _EXPLAINED else len(_EXPLAINED)


def _findings(differing: list[str]) -> str:
    """What the differences mean, each with the results that it explains; those of no finding come last."""
    rest = Finding("Not explained:", tuple(name for name in differing if name not in _EXPLAINED))
    items = []
    for finding in (*FINDINGS, rest):
        links = [f'<a href="#{name}">{name}</a>' for name in finding.ids if name in differing]
        items += [f"<li>{_text(finding.text)} <small>{', '.join(links)}</small></li>"] if links else []
    return f'<section><h2>What the differences mean</h2><ol class="findings">{"".join(items)}</ol></section>'


def _first(title: str, results: list[Result]) -> str:
    """Results of one verdict of all groups, with why."""
    if not results:
        return f"<section><h2>{title}</h2><p>Nothing.</p></section>"
    return f"<section><h2>{title}</h2>{_results(results, 'linked')}</section>"


def _group(group, results, figures) -> str:
    pictures = "".join(_figure(picture, figure) for picture, figure in figures)
    text = "".join(f"<p>{_text(part)}</p>" for part in group.text.split("\n\n") if part)
    return (
        f'<section id="{group.name}"><h2>{escape(group.title)}</h2>{text}'
        f'<div class="pictures">{pictures}</div>{_results(results)}</section>'
    )


def _figure(picture, figure) -> str:
    if figure is None:
        return f"<p>{escape(picture.ids)}: nothing to draw in what was computed.</p>"
    content = BytesIO()
    figure.savefig(content, format="png", dpi=120)
    image = base64.b64encode(content.getvalue()).decode()
    return (
        f'<figure><img src="data:image/png;base64,{image}" alt="{escape(picture.ids)}: {escape(picture.caption)}">'
        f"<figcaption><b>{escape(picture.ids)}.</b> {_text(picture.caption)}</figcaption></figure>"
    )


def _results(results, ids: str = "anchors") -> str:
    """A table of results; `ids`: whether theirs are `anchors`, or `linked` to where they are."""
    if not results:
        return ""
    head = "".join(f"<th>{name}</th>" for name in ("", "what", "source", "here", "verdict"))
    rows = "".join(_row(result, ids == "anchors") for result in results)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _row(result: Result, anchor: bool) -> str:
    entry, here = result.entry, result.here
    name = escape(entry.id)
    at, shown = (f' id="{name}"', name) if anchor else ("", f'<a href="#{name}">{name}</a>')
    links = " ".join(f'<a href="#{name}" title="{escape(READINGS[name])}">{name}</a>' for name in entry.readings)
    note = f'<p class="note">{_text(here.note)}</p>' if here.note else ""
    counted = "" if here.verdict == NOT_COMPARED else f"Counted as agreement: {escape(entry.tolerance)}. "
    told = f'<p class="tolerance">{counted}{links}</p>'
    return (
        f'<tr class="{_CLASSES[here.verdict]}"{at}><td class="id">{shown}</td>'
        f"<td>{escape(entry.what)}{note}{told}</td>"
        f'<td data-name="source">{escape(entry.source)}</td><td data-name="here">{_text(here.text)}</td>'
        f'<td class="verdict">{escape(here.verdict)}</td></tr>'
    )


def _readings() -> str:
    items = "".join(f'<dt id="{name}">{name}</dt><dd>{_text(text)}</dd>' for name, text in READINGS.items())
    return f'<section id="readings"><h2>Readings</h2><dl>{items}</dl></section>'
