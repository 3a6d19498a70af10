"""What an entry, a picture and a group of the page are."""

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from vibrojax.reproduce.needs import Answer, Need, Unanswered
from vibrojax.reproduce.verdicts import DIFFERS, Here


@dataclass(frozen=True)
class Entry:
    """One result of the source.

    **Arguments:**

    - `id`: like `table-5.3.1`, `fig-5.67b`, `eq-5.17`.
    - `what`: what it is about, with its parameters.
    - `source`: what the source says: a number, a range, a count or a trend.
    - `needs`: what must be computed for it (see [vibrojax.reproduce.needs][]).
    - `judge`: takes the answers to `needs`, in their order, and gives `Here`. It never uses the source's number to
      compute ours.
    - `tolerance`: what counts as agreement, and why.
    - `readings`: names of the readings it rests on, R1 and so on.
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
    """A picture in the source's axes.

    **Arguments:**

    - `ids`: the source's figures that it stands for, as texts.
    - `caption`: what is to be seen.
    - `needs`: what must be computed for it.
    - `draw`: takes the answers to `needs`, in their order, and gives the figure.
    """

    ids: str
    caption: str
    needs: tuple[Need, ...]
    draw: Callable[..., Figure]


@dataclass(frozen=True)
class Group:
    """Entries and pictures under one title, with a short text before them."""

    name: str
    title: str
    text: str
    entries: tuple[Entry, ...]
    pictures: tuple[Picture, ...] = ()

    @property
    def needs(self) -> list[Need]:
        """What must be computed for all of it."""
        of_entries = [need for entry in self.entries for need in entry.needs]
        return of_entries + [need for picture in self.pictures for need in picture.needs]


UNREADABLE = (ValueError, IndexError, ZeroDivisionError)
"""What reading a motion raises that has none of what is looked for: no return, no impact, nothing but NaN."""


def judged(entry: Entry, answers: list[Answer]) -> Here:
    """What the entry's judge says; where there is nothing to read in the answers, that is a difference too."""
    missing = [answer.why for answer in answers if isinstance(answer, Unanswered)]
    if missing:
        return Here("nan", DIFFERS, f"could not be computed: {missing[0]}")
    try:
        return entry.judge(*answers)
    except UNREADABLE as problem:
        return Here("nan", DIFFERS, f"nothing to read in what was computed: {problem}")


def drawn(picture: Picture, answers: list[Answer]) -> Figure | None:
    """The figure, or None where there is nothing to draw in the answers."""
    if any(isinstance(answer, Unanswered) for answer in answers):
        return None
    try:
        return picture.draw(*answers)
    except UNREADABLE:
        return None
