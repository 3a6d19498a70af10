"""A run: every entry with its verdict, every picture, and the datasets that they come from."""

import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import xarray as xr
from matplotlib.figure import Figure

from vibrojax.compile.devices import precision
from vibrojax.progress import Progress
from vibrojax.reproduce.answers import Answers
from vibrojax.reproduce.entry import Entry, Group, Picture, drawn, judged
from vibrojax.reproduce.groups import GROUPS
from vibrojax.reproduce.needs import Answer, Lane, Need
from vibrojax.reproduce.verdicts import VERDICTS, Here, Verdict

QUICK_SCENES = ("rotary", "vibro-impact")


@dataclass(frozen=True)
class Result:
    """An entry and what is computed here beside it."""

    entry: Entry
    here: Here


class Reproduced(NamedTuple):
    """A group with its results, and its pictures with their figures (None: nothing to draw in what was computed)."""

    group: Group
    results: tuple[Result, ...]
    figures: tuple[tuple[Picture, Figure | None], ...]


@dataclass(frozen=True)
class Reproduction:
    """Results and figures by group, the datasets by name, and the seconds that it all took."""

    groups: tuple[Reproduced, ...]
    datasets: dict[str, xr.Dataset] = field(repr=False)
    wall_time: float
    quick: bool

    @property
    def results(self) -> list[Result]:
        """All results, in the order of the page."""
        return [result for group in self.groups for result in group.results]

    @property
    def score(self) -> dict[Verdict, int]:
        """How many results have each verdict."""
        return {verdict: sum(one.here.verdict == verdict for one in self.results) for verdict in VERDICTS}


def run_reproduction(groups: Iterable[Group] = GROUPS, quick: bool = False, progress: bool = True) -> Reproduction:
    """Compute the entries of `groups` and put each beside what the source says.

    **Arguments:**

    - `quick`: only what closed forms and the points of two scenes answer: half a minute.
    - `progress`: whether to say on stderr what is being computed, and how far it is.

    **Returns:** a `Reproduction`; `write_reproduction` makes a page of it.

    **Example:**

    >>> from vibrojax.reproduce import GROUPS
    >>> classical = [group for group in GROUPS if group.name == "classical"]
    >>> found = vj.run_reproduction(classical, progress=False)
    >>> found.score["agrees"], len(found.results)
    (8, 8)
    """
    began = time.monotonic()
    chosen = [_quick(group) for group in groups] if quick else list(groups)
    needs = [need for group in chosen for need in group.needs]
    report = Progress(len(needs), "answers", progress).say
    reproduced = []
    with precision("float64"):
        answers = Answers(needs, report)
        for group in chosen:
            if not group.entries and not group.pictures:
                continue
            report(f"results and pictures: {group.name}")
            results = tuple(Result(entry, judged(entry, _answers_to(entry, answers))) for entry in group.entries)
            figures = tuple((picture, drawn(picture, _answers_to(picture, answers))) for picture in group.pictures)
            reproduced.append(Reproduced(group, results, figures))
    return Reproduction(tuple(reproduced), answers.datasets, time.monotonic() - began, quick)


def _answers_to(one: Entry | Picture, answers: Answers) -> list[Answer]:
    return [answers[need] for need in one.needs]


def _quick(group: Group) -> Group:
    """The entries and pictures of a group that a quick run answers."""
    entries = tuple(entry for entry in group.entries if all(map(_is_quick, entry.needs)))
    pictures = tuple(picture for picture in group.pictures if all(map(_is_quick, picture.needs)))
    return replace(group, entries=entries, pictures=pictures)


def _is_quick(need: Need) -> bool:
    """Whether a need is one more lane of a program that is compiled anyway."""
    if not isinstance(need, Lane) or need.scene not in QUICK_SCENES:
        return False
    return not any(isinstance(value, str) for _, value in need.parameters)
