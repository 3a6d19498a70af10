"""The source's results, compared with computed values: rows of `results.csv`; groups and texts from `source.toml`.

The fields `value`, `rule` and `draw` are expressions in the syntax of jinja2. They can use the variables that
`collect` in `computations.py` returns, `x` for the result of `value`, and all public names of `_MODULES`. `here` and
`remark` are strings with such expressions in braces. If `here` is empty, the text of the rule's judgement is used.
"""

import csv
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import xarray as xr
from jinja2 import Environment, StrictUndefined
from matplotlib.figure import Figure

from source import closed_forms, maps, motions, pictures_maps, pictures_motions, rules
from source.computations import Answer, Labelled, Need, SourceAnswers, Unanswered, collect, read_needs
from source.rules import DIFFERS, FIELD, VERDICTS, Here, Verdict, formatted
from vibrojax.compile.xla import precision
from vibrojax.physics.contact import contact_time, restitution
from vibrojax.physics.rock import ROCKS
from vibrojax.pictures.style import settings
from vibrojax.progress import Progress

T = TypeVar("T")

QUICK_SCENES = ("rotary", "vibro-impact")
"""Scenes of a quick run: all their lanes share compiled programs, so further lanes cost little."""

UNREADABLE = (ValueError, IndexError, ZeroDivisionError)
"""Errors raised if a motion lacks what is evaluated: no section crossing, no impact, or only NaN."""


@dataclass(frozen=True)
class Entry:
    """One result of the source: its id such as `fig-5.67b`, its subject (`what`), and the source's statement about it.

    - `needs`: the computations that the comparison requires.
    - `judge`: function that takes the computed values of all `needs`, in order, and returns the judgement.
    - `tolerance`: explanation of what counts as agreement.
    - `readings`: names (R1, R2, ...) of the readings of the source that the result depends on.
    """

    id: str
    what: str
    source: str
    needs: tuple[Need, ...]
    judge: Callable[..., Here]
    tolerance: str
    readings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Picture:
    """A picture of computed values, with the same axes as the source's figures `ids`.

    - `needs`: the computations that the picture requires.
    - `draw`: function that takes the computed values of all `needs`, in order, and returns the figure.
    """

    ids: str
    caption: str
    needs: tuple[Need, ...]
    draw: Callable[..., Figure]


@dataclass(frozen=True)
class Group:
    """Results of the source (`entries`) and pictures under a common title, with an introductory text."""

    name: str
    title: str
    text: str
    entries: tuple[Entry, ...]
    pictures: tuple[Picture, ...] = ()


class Finding(NamedTuple):
    """A finding about a difference from the source, and the ids of the results that it explains.

    `text` states what the difference means for those who build or operate such a drill.
    """

    text: str
    ids: tuple[str, ...]


class Result(NamedTuple):
    """A result of the source (`entry`), and the computed value with its verdict, such as "agrees"."""

    entry: Entry
    here: Here


class Reproduced(NamedTuple):
    """A group with its results and pictures; a figure is None if there is nothing to draw."""

    group: Group
    results: tuple[Result, ...]
    figures: tuple[tuple[Picture, Figure | None], ...]


@dataclass(frozen=True)
class Reproduction:
    """Results and figures by group, the datasets by name, and the run time `wall_time` [s]."""

    groups: tuple[Reproduced, ...]
    datasets: dict[str, xr.Dataset] = field(repr=False)
    wall_time: float
    quick: bool

    @property
    def results(self) -> list[Result]:
        """All results, in the order of the HTML page."""
        return [result for group in self.groups for result in group.results]

    @property
    def score(self) -> dict[Verdict, int]:
        """The number of results that agree, agree in trend, differ, or cannot be compared with the source."""
        return {verdict: sum(result.here.verdict == verdict for result in self.results) for verdict in VERDICTS}


EXPRESSIONS = Environment(undefined=StrictUndefined)
for _module in (rules, maps, motions, closed_forms, pictures_motions, pictures_maps):
    EXPRESSIONS.globals |= {name: value for name, value in vars(_module).items() if name[0] != "_"}
EXPRESSIONS.globals |= {
    name: getattr(np, name) for name in ("abs", "arcsin", "array", "cos", "diff", "pi", "ptp", "sqrt")
}
EXPRESSIONS.globals |= {"ROCKS": ROCKS, "contact_time": contact_time, "restitution": restitution}


@cache
def compiled(expression: str) -> Callable[[Mapping[str, Any]], Any]:
    """Compile an expression to a function of a mapping from variable names to values."""
    return EXPRESSIONS.compile_expression(expression, undefined_to_none=False)


def _judge(row: Mapping[str, str], needs: tuple[Labelled, ...], *answers: Answer) -> Here:
    """Evaluate the expressions of a row of `results.csv` with the computed values, and return the judgement."""
    names = collect(needs, list(answers))

    def fill(text: str) -> str:
        return FIELD.sub(lambda field: formatted(compiled(field[1])(names), field[2] or ""), text)

    if row["value"]:
        names["x"] = compiled(row["value"])(names)
    judgement: Here = compiled(row["rule"])(names)
    return Here(fill(row["here"]) or judgement.text, judgement.verdict, fill(row["remark"]) or judgement.note)


def _draw(expression: str, needs: tuple[Labelled, ...], *answers: Answer) -> Figure:
    with settings():
        return compiled(expression)(collect(needs, list(answers)))


def _evaluated(function: Callable[..., T], answers: Sequence[Answer]) -> T | str:
    """Return `function(*answers)`, or the reason why it cannot be evaluated."""
    for answer in answers:
        if isinstance(answer, Unanswered):
            return f"could not be computed: {answer.reason}"
    try:
        return function(*answers)
    except UNREADABLE as problem:
        return f"the computation has nothing to read: {problem}"


def judged(entry: Entry, answers: Sequence[Answer]) -> Here:
    """Return the judgement of an entry, given the computed values.

    Values that are missing or cannot be evaluated count as a difference from the source.
    """
    here = _evaluated(entry.judge, answers)
    return Here("nan", DIFFERS, here) if isinstance(here, str) else here


def run_reproduction(groups: Iterable[Group] | None = None, quick: bool = False, progress: bool = True) -> Reproduction:
    """Compute the results in `groups`, and compare each with the source's statement.

    **Arguments:**

    - `groups`: groups of results and pictures, by default all.
    - `quick`: whether to compute only closed forms and single points of two scenes, which takes half a minute.
    - `progress`: whether to report the current computation and the progress on stderr.

    **Returns:** a `Reproduction`; `write_reproduction` writes it as an HTML page.
    """
    began = time.monotonic()
    groups = list(GROUPS if groups is None else groups)
    if quick:
        groups = [
            replace(
                group,
                entries=tuple(filter(_is_quick, group.entries)),
                pictures=tuple(filter(_is_quick, group.pictures)),
            )
            for group in groups
        ]
    needs: list[Need] = []
    for group in groups:
        needs += [need for entry in group.entries for need in entry.needs]
        needs += [need for picture in group.pictures for need in picture.needs]
    report = Progress(len(needs), "answers", progress).say
    reproduced = []
    with precision("float64"):
        answers = SourceAnswers(needs, report)
        for group in groups:
            if not group.entries and not group.pictures:
                continue
            report(f"results and pictures: {group.name}")
            results = (Result(entry, judged(entry, [answers[need] for need in entry.needs])) for entry in group.entries)
            drawn = ((each, _evaluated(each.draw, [answers[need] for need in each.needs])) for each in group.pictures)
            figures = ((each, None if isinstance(figure, str) else figure) for each, figure in drawn)
            reproduced.append(Reproduced(group, tuple(results), tuple(figures)))
    return Reproduction(tuple(reproduced), answers.datasets, time.monotonic() - began, quick)


def _is_quick(item: Entry | Picture) -> bool:
    """Return whether all required computations are lanes of `QUICK_SCENES` with the scene's default friction law."""
    return all(
        need.kind == "lanes" and need.scene in QUICK_SCENES and need.numbers == need.parameters for need in item.needs
    )


_FOLDER = Path(__file__).parent
_SOURCE = tomllib.loads((_FOLDER / "source.toml").read_text(encoding="utf-8"))
ROWS = list(csv.DictReader((_FOLDER / "results.csv").read_text(encoding="utf-8").splitlines()))


def _flowing(text: str) -> str:
    """Return the text on one line, with single blanks between words."""
    return " ".join(text.split())


def _with_needs(function: Callable[..., T], row: Any, text: str) -> tuple[tuple[Need, ...], Callable[..., T]]:
    """Return the computations that `text` specifies, and a function of their values, which evaluates `row`."""
    labelled = read_needs(text, _SOURCE["needs"], _SOURCE["maps"])
    return tuple(need for _, need in labelled), partial(function, row, labelled)


def _entry(row: Mapping[str, str]) -> Entry:
    tolerance = _flowing(_SOURCE["tolerances"].get(row["tolerance"], row["tolerance"]))
    needs, judge = _with_needs(_judge, row, row["needs"])
    return Entry(row["id"], row["what"], row["source"], needs, judge, tolerance, tuple(row["readings"].split()))


def _picture(row: Mapping[str, str]) -> Picture:
    return Picture(row["ids"], _flowing(row["caption"]), *_with_needs(_draw, _flowing(row["draw"]), row["needs"]))


GROUPS = tuple(
    Group(
        group["name"],
        group["title"],
        _flowing(group["text"]),
        tuple(_entry(row) for row in ROWS if row["group"] == group["name"]),
        tuple(map(_picture, group.get("pictures", ()))),
    )
    for group in _SOURCE["groups"]
)
"""All groups of related results, in the order of the HTML page."""
FINDINGS = tuple(Finding(_flowing(row["text"]), tuple(row["ids"].split())) for row in _SOURCE["findings"])
"""All findings, the most important first."""
READINGS = {name: _flowing(text) for name, text in _SOURCE["readings"].items()}
"""The readings by name: how the source was interpreted where it is misprinted or incomplete."""
