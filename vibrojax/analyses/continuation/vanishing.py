"""Where a quantity that is known at a few points of a line is going to vanish: its zero foretold."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

Known = Float[np.ndarray, "lanes 3"]

LONE_DOUBT = 0.1
"""Part of the way ahead that is doubted where only two points are known."""


class Foretold(NamedTuple):
    """Where quantities vanish, and by how much that may be off; NaN where too little is known."""

    at: Float[np.ndarray, " lanes"]
    doubt: Float[np.ndarray, " lanes"]


def foretold(at: Known, value: Known) -> Foretold:
    """The zeros of quantities from their last three values, the last one first; NaN where there are fewer.

    By inverse interpolation of the quantity or of its square, with its sign, whichever is nearer to a straight line:
    beside a graze some quantities go as the root of the distance.
    """
    with np.errstate(all="ignore"):
        plain, bent = _interpolated(at, value)
        square, bent_square = _interpolated(at, value * np.abs(value))
        better = bent_square < bent
    return Foretold(np.where(better, square.at, plain.at), np.where(better, square.doubt, plain.doubt))


def entered(known: np.ndarray, lanes: Int[np.ndarray, " some"], value: Float[np.ndarray, " some"]) -> None:
    """Put what was found last of `lanes` before what was known."""
    known[lanes, 1:] = known[lanes, :-1]
    known[lanes, 0] = value


def _interpolated(at: Known, value: Known) -> tuple[Foretold, Float[np.ndarray, " lanes"]]:
    """By Neville's scheme; and how far apart the zeros of the straight lines are."""
    (s1, s2, s3), (y1, y2, y3) = at.T, value.T
    last, before = s1 - y1 * (s2 - s1) / (y2 - y1), s2 - y2 * (s3 - s2) / (y3 - y2)
    best = last + (last - before) * y1 / (y3 - y1)
    three = np.isfinite(best)
    found = np.where(three, best, last), np.where(three, np.abs(best - last), LONE_DOUBT * np.abs(last - s1))
    return Foretold(*found), np.abs(last - before)
