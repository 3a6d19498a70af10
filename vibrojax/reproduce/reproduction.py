"""A run of the reproduction: all results compared with the source, all pictures, and their datasets."""

import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import xarray as xr
from matplotlib.figure import Figure

from vibrojax.compile.xla import precision
from vibrojax.progress import Progress
from vibrojax.reproduce.answers import SourceAnswers
from vibrojax.reproduce.needs import LaneNeed
from vibrojax.reproduce.rules import VERDICTS, Here, Verdict
from vibrojax.reproduce.table import GROUPS, Entry, Group, Picture, drawn, judged

QUICK_SCENES = ("rotary", "vibro-impact")
"""Scenes of a quick run: all their lanes share compiled programs, so further lanes cost little."""


@dataclass(frozen=True)
class Result:
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


def run_reproduction(groups: Iterable[Group] = GROUPS, quick: bool = False, progress: bool = True) -> Reproduction:
    """Compute the results in `groups`, and compare each with the source's statement.

    **Arguments:**

    - `groups`: groups of results and pictures, by default all.
    - `quick`: whether to compute only closed forms and single points of two scenes, which takes half a minute.
    - `progress`: whether to report the current computation and the progress on stderr.

    **Returns:** a `Reproduction`; `write_reproduction` writes it as an HTML page.

    **Example:**

    >>> from vibrojax.reproduce import GROUPS
    >>> classical = [group for group in GROUPS if group.name == "classical"]
    >>> reproduction = vj.run_reproduction(classical, progress=False)
    >>> reproduction.score["agrees"], len(reproduction.results)
    (8, 8)
    """
    began = time.monotonic()
    groups = [_quick_part(group) for group in groups] if quick else list(groups)
    needs = [need for group in groups for need in group.needs]
    report = Progress(len(needs), "answers", progress).say
    reproduced = []
    with precision("float64"):
        answers = SourceAnswers(needs, report)
        for group in groups:
            if not group.entries and not group.pictures:
                continue
            report(f"results and pictures: {group.name}")
            results = (Result(entry, judged(entry, [answers[need] for need in entry.needs])) for entry in group.entries)
            figures = ((each, drawn(each, [answers[need] for need in each.needs])) for each in group.pictures)
            reproduced.append(Reproduced(group, tuple(results), tuple(figures)))
    return Reproduction(tuple(reproduced), answers.datasets, time.monotonic() - began, quick)


def _quick_part(group: Group) -> Group:
    """Return a group with only those results and pictures that a quick run computes."""
    entries = tuple(entry for entry in group.entries if _is_quick(entry))
    return replace(group, entries=entries, pictures=tuple(picture for picture in group.pictures if _is_quick(picture)))


def _is_quick(item: Entry | Picture) -> bool:
    """Return whether all required computations are lanes of `QUICK_SCENES` with the scene's default friction law."""
    lanes = [need for need in item.needs if isinstance(need, LaneNeed) and need.scene in QUICK_SCENES]
    return len(lanes) == len(item.needs) and not any(isinstance(v, str) for lane in lanes for _, v in lane.parameters)
