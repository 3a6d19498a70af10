"""A group of results that belong together on the page, and the pictures beside them."""

from collections.abc import Callable
from dataclasses import dataclass

from vibrojax.reproduce._entry import Entry


@dataclass(frozen=True)
class Picture:
    """A picture in the source's axes.

    - `ids`: the source's figures that it stands for, as texts; `caption`: what is to be seen.
    - `needs`: what must be computed for it; `draw` takes the answers, in their order, and gives the figure.
    """

    ids: str
    caption: str
    needs: tuple
    draw: Callable


@dataclass(frozen=True)
class Group:
    """Entries and pictures under one title, with a short text before them."""

    name: str
    title: str
    text: str
    entries: tuple[Entry, ...]
    pictures: tuple[Picture, ...] = ()
