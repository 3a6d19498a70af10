"""The source's results as data: rows of `results.csv`; groups, pictures, findings and readings from `source.toml`.

The fields `value`, `rule` and `draw` are expressions in the syntax of jinja2. They can use the variables that
`collect` in `answers.py` returns, `x` for the result of `value`, and all public names of `_MODULES`. `here` and
`remark` are strings with such expressions in braces. If `here` is empty, the text of the rule's judgement is used.
"""

import csv
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined
from matplotlib.figure import Figure

from vibrojax.models.physics.contact import contact_time, restitution
from vibrojax.models.physics.rock import ROCKS
from vibrojax.plot.style import styled
from vibrojax.reproduce import closed_forms, figures, maps, motions, pictures_maps, pictures_motions, rules
from vibrojax.reproduce.answers import Answer, Unanswered, collect
from vibrojax.reproduce.needs import Labelled, Need, read_needs
from vibrojax.reproduce.rules import DIFFERS, FIELD, Here, formatted


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

    @property
    def needs(self) -> list[Need]:
        """The computations that all entries require, followed by those that all pictures require."""
        of_entries = [need for entry in self.entries for need in entry.needs]
        return of_entries + [need for picture in self.pictures for need in picture.needs]


@dataclass(frozen=True)
class Finding:
    """A finding about a difference from the source, and the ids of the results that it explains.

    `text` states what the difference means for those who build or operate such a drill.
    """

    text: str
    ids: tuple[str, ...]


UNREADABLE = (ValueError, IndexError, ZeroDivisionError)
"""Errors raised if a motion lacks what is evaluated: no section crossing, no impact, or only NaN."""


def judged(entry: Entry, answers: list[Answer]) -> Here:
    """Return the judgement of an entry, given the computed values.

    Values that are missing or cannot be evaluated count as a difference from the source.
    """
    missing = [answer.reason for answer in answers if isinstance(answer, Unanswered)]
    if missing:
        return Here("nan", DIFFERS, f"could not be computed: {missing[0]}")
    try:
        return entry.judge(*answers)
    except UNREADABLE as problem:
        return Here("nan", DIFFERS, f"the computation has nothing to read: {problem}")


def drawn(picture: Picture, answers: list[Answer]) -> Figure | None:
    """Return the figure, or None if computed values are missing or contain nothing to draw."""
    if any(isinstance(answer, Unanswered) for answer in answers):
        return None
    try:
        return picture.draw(*answers)
    except UNREADABLE:
        return None


_MODULES = (rules, maps, motions, closed_forms, figures, pictures_motions, pictures_maps)
EXPRESSIONS = Environment(undefined=StrictUndefined)
EXPRESSIONS.globals |= {name: value for module in _MODULES for name, value in vars(module).items() if name[0] != "_"}
EXPRESSIONS.globals |= {name: getattr(np, name) for name in ("abs", "array", "cos", "diff", "pi", "ptp", "sqrt")}
EXPRESSIONS.globals |= {"ROCKS": ROCKS, "contact_time": contact_time, "restitution": restitution}


@cache
def compiled(expression: str) -> Callable[[Mapping[str, Any]], Any]:
    """Compile an expression to a function of a mapping from variable names to values."""
    return EXPRESSIONS.compile_expression(expression, undefined_to_none=False)


def fill(text: str, names: Mapping[str, Any]) -> str:
    """Return the text after replacing expressions in braces by their formatted values."""
    return FIELD.sub(lambda field: formatted(compiled(field[1])(names), field[2] or ""), text)


def _judge(row: Mapping[str, str], needs: tuple[Labelled, ...], *answers: Answer) -> Here:
    """Evaluate the expressions of a row of `results.csv` with the computed values, and return the judgement.

    `answers`: computed values of each of the `needs`, in order.
    """
    names = collect(needs, list(answers))
    if row["value"]:
        names["x"] = compiled(row["value"])(names)
    judgement: Here = compiled(row["rule"])(names)
    text = fill(row["here"], names) or judgement.text
    return Here(text, judgement.verdict, fill(row["remark"], names) or judgement.note)


def _draw(expression: str, needs: tuple[Labelled, ...], *answers: Answer) -> Figure:
    """Draw a picture: evaluate its expression with the computed values (`answers`) of all `needs`."""
    return styled(compiled(expression))(collect(needs, list(answers)))


def _flowing(text: str) -> str:
    """Return the text on one line, with single blanks between words."""
    return " ".join(text.split())


_FOLDER = files("vibrojax.reproduce")
_SOURCE = tomllib.loads((_FOLDER / "source.toml").read_text(encoding="utf-8"))
ROWS = list(csv.DictReader((_FOLDER / "results.csv").read_text(encoding="utf-8").splitlines()))


def _needs(text: str) -> tuple[tuple[Labelled, ...], tuple[Need, ...]]:
    """Return the computations that `text` specifies, first with their labels and then without."""
    labelled = read_needs(text, _SOURCE["needs"], _SOURCE["maps"])
    return labelled, tuple(need for _, need in labelled)


def _entry(row: Mapping[str, str]) -> Entry:
    labelled, needs = _needs(row["needs"])
    tolerance = _flowing(_SOURCE["tolerances"].get(row["tolerance"], row["tolerance"]))
    judge = partial(_judge, row, labelled)
    return Entry(row["id"], row["what"], row["source"], needs, judge, tolerance, tuple(row["readings"].split()))


def _picture(row: Mapping[str, str]) -> Picture:
    labelled, needs = _needs(row["needs"])
    return Picture(row["ids"], _flowing(row["caption"]), needs, partial(_draw, _flowing(row["draw"]), labelled))


def _group(group: Mapping[str, Any]) -> Group:
    entries = tuple(_entry(row) for row in ROWS if row["group"] == group["name"])
    pictures = tuple(map(_picture, group.get("pictures", ())))
    return Group(group["name"], group["title"], _flowing(group["text"]), entries, pictures)


GROUPS = tuple(map(_group, _SOURCE["groups"]))
"""All groups of related results, in the order of the HTML page."""
FINDINGS = tuple(Finding(_flowing(row["text"]), tuple(row["ids"].split())) for row in _SOURCE["findings"])
"""All findings, the most important first."""
READINGS = {name: _flowing(text) for name, text in _SOURCE["readings"].items()}
"""The readings by name: how the source was interpreted where it is misprinted or incomplete."""
