"""Recurrences of the differences between section crossings, fitted to many lanes at once.

If the crossings of a lane approach a periodic orbit with p crossings per period, let d_k be the differences between
crossings that are p apart. They obey a linear recurrence d_k = sum_j c_j d_{k-jp}. Its order is 1 for one dominant
multiplier, 2 for a pair, and 3 for all three multipliers of a section with three states. The coefficients are fitted to
the differences by least squares. They determine the sum of all future differences of the states and of any function of
the states (reduced rank extrapolation: Sidi, *Vector Extrapolation Methods*, 2017, chapter 2).
"""

from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.lanes.inputs import Index, PerLane
from vibrojax.lazy import jax

RECURRENCE_MAX_ORDER = 3
"""A section with three states has three multipliers."""

RECURRENCE_MAX_EQUATIONS = 12
"""Maximum number of differences in the fit, the newest. Earlier, the lane may be too far away for a linear map."""

PerLaneInt = Int[np.ndarray, " lanes"]
PerLaneBool = Bool[np.ndarray, " lanes"]
Series = Float[np.ndarray, "_ lanes"]
Numbers = Int[np.ndarray, "..."]
SumsAndMean = tuple[Series, Series | None, PerLane]
"""Sums of which period or impact velocity is the mean: the sum since the previous crossing (of time [s] or of
velocities [m/s]), the number of its terms (None for one term), and the lane's mean."""


class Crossings(NamedTuple):
    """Section crossings, the newest first. The lanes are along the last axis of all arrays.

    - `states`: scaled states (states, crossings, lanes), NaN after the `known` ones.
    - `lag`: distance of the crossings whose differences obey a recurrence.
    - `sums`: period and impact velocity, as sums since the previous crossing.
    """

    states: Float[np.ndarray, "states _ lanes"]
    known: PerLaneInt
    lag: PerLaneInt
    sums: tuple[SumsAndMean, ...] = ()

    def of(self, lanes: Index) -> "Crossings":
        if len(lanes) == len(self.lag):
            return self
        return jax.tree.map(lambda x: np.take(x, lanes, axis=-1), self)

    @property
    def highest(self) -> PerLaneInt:
        """Highest order that has enough differences, 0 if no order has."""
        return np.clip((self.known - self.lag - 1) // self.lag, 0, RECURRENCE_MAX_ORDER)

    def at(self, number: Numbers) -> Float[np.ndarray, "states ..."]:
        """Return the states of the crossings with these numbers."""
        return pick(self.states, number)

    def differences(self, order: int) -> Float[np.ndarray, "_ _ states lanes"]:
        """Return the differences that recurrences up to this order relate: (order + 1, equations, states, lanes)."""
        equations = np.arange(min(len(self.states[0]), RECURRENCE_MAX_EQUATIONS))[:, None]
        states = self.at(self.lag * np.arange(order + 2)[:, None, None] + equations)
        return np.moveaxis(states[:, :-1] - states[:, 1:], 0, 2)

    def are_resolved(self, resolved: float) -> PerLaneBool:
        """Return a mask of the lanes whose newest difference is large enough to determine multipliers."""
        return np.max(np.abs(self.states[:, 0] - self.at(self.lag)), axis=0) > resolved


def pick(series: np.ndarray, number: Numbers) -> np.ndarray:
    """Return the values with these numbers of each lane, the last one for a number beyond the end."""
    *first, length, lanes = series.shape
    return np.take(series.reshape(*first, -1), np.minimum(number, length - 1) * lanes + np.arange(lanes), axis=-1)


class Recurrence(NamedTuple):
    """Fitted recurrence of differences with coefficients c_j.

    `sides`: right-hand sides and left-hand side of its equations, (order + 1, equations, states, lanes), the left-hand
    side first; zeros after a lane's last equation.
    """

    coefficients: Float[np.ndarray, "order lanes"]
    sides: Float[np.ndarray, "_ _ states lanes"]

    def of(self, lanes: Index) -> "Recurrence":
        return Recurrence(*(x if len(lanes) == x.shape[-1] else np.take(x, lanes, axis=-1) for x in self))

    def residual(self) -> PerLane:
        """Return the relative residual of the fit."""
        now, *before = self.sides.reshape(len(self.sides), -1, self.sides.shape[-1])
        off = reduce(np.add, [c * column for c, column in zip(self.coefficients, before, strict=True)]) - now
        return np.sqrt(_sum_of_rows(off**2) / _sum_of_rows(now**2))

    def radius(self) -> PerLane:
        """Return the largest modulus of the roots of the characteristic polynomial, which estimate multipliers."""
        order, lanes = self.coefficients.shape
        companion = np.zeros((lanes, order, order))
        companion[:, 0] = self.coefficients.T
        companion[:, np.arange(1, order), np.arange(order - 1)] = 1.0
        return np.max(np.abs(np.linalg.eigvals(companion)), axis=1)


def fit_recurrence(
    crossings: Crossings, differences: Float[np.ndarray, "_ _ states lanes"], order: int, noise: float
) -> Recurrence:
    """Fit a recurrence of this `order` to the differences by least squares with equally weighted equations."""
    _, most, dimensions, lanes = differences.shape
    equations = np.minimum(crossings.known - (order + 1) * crossings.lag, most)
    within = np.arange(most)[:, None, None] < equations
    sides = np.where(within, differences[: order + 1], 0.0)
    squares = sides[1:] ** 2
    terms = [squares[j, :, state] for state in range(dimensions) for j in range(order)]
    weight = 1 / np.sqrt(reduce(np.add, terms) + noise**2)
    sides *= weight[:, None]
    # Regularization by the rounding noise in the columns: without it, large coefficients would fit noise.
    blurred = 1e-12 + noise**2 * _sum_of_rows(np.where(within[:, 0], weight**2, 0.0))
    gram, right = np.empty((lanes, order, order)), np.empty((lanes, order, 1))
    now, *before = sides.reshape(order + 1, -1, lanes)
    for j, column in enumerate(before):
        right[:, j, 0] = _sum_of_rows(column * now)
        for k in range(j + 1):
            gram[:, j, k] = gram[:, k, j] = _sum_of_rows(column * before[k])
    gram[:, np.arange(order), np.arange(order)] += blurred[:, None]
    return Recurrence(np.linalg.solve(gram, right)[..., 0].T, sides)


def _sum_of_rows(x: Series) -> PerLane:
    """Return the sum of the rows, added in order, so that no bit of a lane depends on the other lanes.

    numpy adds a single column in another order than several.
    """
    return np.add.reduce(x) if x.shape[1] > 1 else np.add.accumulate(x)[-1]


def future_sum(values: Series, fit: Recurrence) -> PerLane:
    """Return the sum of all future differences of `values`: sum_j c_j (d_0 + ... + d_{j-1})/(1 - sum_j c_j).

    `values`: the newest value, and those one lag, two lags, ... before it.
    """
    order = len(fit.coefficients)
    passed = np.cumsum(values[:order] - values[1 : order + 1], axis=0)
    return np.sum(fit.coefficients * passed, axis=0) / (1 - np.sum(fit.coefficients, axis=0))
