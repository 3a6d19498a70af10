"""Computes the registry: every entry with its verdict, every picture, and the datasets that they come from."""

import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

import xarray as xr
from matplotlib.figure import Figure

from vibrojax.devices import precision
from vibrojax.reproduce._answers import Answers
from vibrojax.reproduce._entry import UNREADABLE, VERDICTS, Entry, Here, Unanswered, judged
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import Lane
from vibrojax.reproduce._registry import GROUPS

QUICK_SCENES = ("rotary", "vibro-impact")


@dataclass(frozen=True)
class Result:
    """An entry and what was found."""

    entry: Entry
    here: Here


@dataclass(frozen=True)
class Reproduction:
    """Results and figures by group, the datasets by name, and the seconds that it all took."""

    groups: tuple[tuple[Group, tuple[Result, ...], tuple], ...]
    datasets: dict[str, xr.Dataset] = field(repr=False)
    wall_time: float
    quick: bool

    @property
    def results(self) -> list[Result]:
        """All results, in the order of the registry."""
        return [result for _, results, _ in self.groups for result in results]

    @property
    def score(self) -> dict[str, int]:
        """How many results have each verdict."""
        return {verdict: sum(one.here.verdict == verdict for one in self.results) for verdict in VERDICTS}


def run_reproduction(groups: Iterable[Group] = GROUPS, quick: bool = False, progress: bool = True) -> Reproduction:
    """Compute the entries of `groups` and put each beside what the source says.

    **Arguments:**

    - `quick`: only what closed forms and the points of two scenes answer: half a minute.
    - `progress`: whether to say on stderr what is being computed.

    **Returns:** a `Reproduction`; `write_reproduction` makes a page of it.
    """
    began = time.monotonic()
    chosen = [(group, _chosen(group.entries, quick), _chosen(group.pictures, quick)) for group in groups]
    chosen = [(group, entries, pictures) for group, entries, pictures in chosen if entries or pictures]
    needs = [need for _, *parts in chosen for part in parts for one in part for need in one.needs]
    found = []
    with precision("float64"):
        answers = Answers(needs, _teller(progress, began))
        for group, entries, pictures in chosen:
            results = tuple(Result(entry, judged(entry, _asked(answers, entry))) for entry in entries)
            figures = tuple((picture, _drawn(picture, _asked(answers, picture))) for picture in pictures)
            found.append((group, results, figures))
    return Reproduction(tuple(found), answers.datasets, time.monotonic() - began, quick)


def _asked(answers: Answers, one: Entry | Picture) -> list:
    return [answers[need] for need in one.needs]


def _drawn(picture: Picture, answers: list) -> Figure | None:
    """The figure, or None where there is nothing to draw."""
    if any(isinstance(answer, Unanswered) for answer in answers):
        return None
    try:
        return picture.draw(*answers)
    except UNREADABLE:
        return None


def _chosen(items, quick: bool) -> tuple:
    return tuple(item for item in items if not quick or all(_is_quick(need) for need in item.needs))


def _is_quick(need) -> bool:
    """Whether a need is one more lane of a program that is compiled anyway."""
    plain = isinstance(need, Lane) and not any(isinstance(value, str) for _, value in need.parameters)
    return plain and need.scene in QUICK_SCENES


def _teller(progress: bool, began: float):
    def told(text: str) -> None:
        if progress:
            print(f"{time.monotonic() - began:5.0f} s  {text}", file=sys.stderr, flush=True)

    return told
