"""Drift: the distance of a lane from its limit, extrapolated from its last section crossings, for many lanes at once.

If the crossings of a lane approach a periodic orbit with p crossings per period, let d_k be the differences between
crossings that are p apart. They obey a linear recurrence d_k = sum_j c_j d_{k-jp}. Its order is 1 for one dominant
multiplier, 2 for a pair, and 3 for all three multipliers of a section with three states. The coefficients are fitted to
the differences by least squares. They determine the sum of all future differences of the states and of any function of
the states (reduced rank extrapolation: Sidi, *Vector Extrapolation Methods*, 2017, chapter 2).
"""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.compile.trees import map_leaves
from vibrojax.lanes.inputs import Features, Index, PerLane
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.repeats import GROWTH, INTERVAL, REPEATS_WITHIN, TIME, rock_scale, state_name
from vibrojax.measures.since_start import half_names, stored_scales
from vibrojax.scenes import Section

RECURRENCE_MAX_ORDER = 3
"""A section with three states has three multipliers."""

RECURRENCE_MAX_EQUATIONS = 12
"""Maximum number of differences in the fit, the newest. Earlier, the lane may be too far away for a linear map."""

DRIFT_RESOLVED = 1e4
"""Differences determine multipliers if they exceed the rounding noise by this factor, and ten times the error tolerance
of the steps."""

FITS, FITS_CLOSELY = 0.3, 0.02
"""Relative residuals of a fit: below the first, differences obey a recurrence at all. Below the second, the fit is so
close that the recurrence is taken as the true one."""

GROWS, DECAYS = 1.0005, 0.999
"""Modulus of the dominant multiplier above which a lane moves away from an orbit, and below which it approaches."""

LANES_AT_ONCE = 1024
"""Number of lanes whose recurrences are fitted together. Their arrays fit into the cache."""

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
        return map_leaves(lambda x: np.take(x, lanes, axis=-1), self)

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


def drift(features: Features, section: Section, precision: str, tolerance: float) -> PerLane:
    """Return the relative distance of period, impact velocity and rate of penetration from their limits, the largest.

    It is NaN for a lane that is not periodic. It is infinite if the section crossings move away from the orbit,
    approach an orbit with a shorter period, or determine neither.

    **Arguments:** `features`: (lanes,), and (lanes, returns) for the last section crossings, the newest last;
    `precision`: that of the features, "float64" or "float32"; `tolerance`: relative error tolerance of the steps.
    """
    cycles = np.nan_to_num(features["cycles"]).astype(int)
    return _in_parts(
        cycles, lambda lanes: section_crossings(features, lanes, cycles[lanes], section), precision, tolerance
    )


def drift_under_pulses(features: Features, states: Sequence[str], precision: str, tolerance: float) -> PerLane:
    """Return the relative distance of the growth of the hole per pulse from its limit, for scenes under pulses.

    The beginnings of pulses take the place of section crossings. A motion is periodic if the `states` at the last
    pulses repeat within 1e-3 of their scales. Without pulses nothing repeats, and the result is NaN.
    """
    if not states:
        return np.full(len(features["rate_of_penetration"]), np.nan)
    rows = np.stack([features[state_name(name)].T[::-1] / features[rock_scale(name)] for name in states]).astype(float)
    known = np.sum(np.isfinite(rows[0]), axis=0)
    cycles = np.zeros(len(known), int)
    with np.errstate(invalid="ignore"):
        for repeat in range(MOST_CYCLES, 0, -1):
            moves = np.any(np.abs(rows[:, repeat:] - rows[:, :-repeat]) > REPEATS_WITHIN, axis=(0, 1))
            cycles[~moves & (known > 3 * repeat)] = repeat

    def crossings(lanes: Index) -> Crossings:
        growth = (features[GROWTH].T[::-1, lanes].astype(float), None, features["slip_per_impact"][lanes])
        return Crossings(rows[..., lanes], known[lanes], cycles[lanes], (growth,))

    return _in_parts(cycles, crossings, precision, tolerance)


def _in_parts(cycles: PerLaneInt, crossings: Callable[[Index], Crossings], precision: str, tolerance: float) -> PerLane:
    """Return the distances of all lanes; `crossings` returns the section crossings of lanes by index."""
    distance = np.where(cycles > 0, np.inf, np.nan)
    noise = 64 * float(np.finfo(precision).eps)
    resolved = max(DRIFT_RESOLVED * noise, 10 * tolerance)
    periodic = np.flatnonzero(cycles > 0)
    with np.errstate(all="ignore"):
        for first in range(0, len(periodic), LANES_AT_ONCE):
            lanes = periodic[first : first + LANES_AT_ONCE]
            distance[lanes] = _drift(crossings(lanes), noise, resolved)
    return distance


def section_crossings(features: Features, lanes: PerLaneInt, cycles: PerLaneInt, section: Section) -> Crossings:
    """Return the section crossings of periodic lanes, with a lag of one period."""

    def newest_first(name: str) -> Series:
        return np.take(features[name].T, lanes, axis=1)[::-1].astype(float)

    halves = [features[name][lanes] for name in half_names(section)]
    period = features["period"][lanes]
    rows = [newest_first(state_name(name)) for name in section.compared]
    scales = stored_scales(section, halves, period, [row[0] for row in rows])
    states = np.stack([row / np.asarray(scale, float) for row, scale in zip(rows, scales, strict=True)])
    sums: list[SumsAndMean] = [(newest_first(INTERVAL), None, period)]
    if "return_impacts" in features:
        impacts = newest_first("return_impacts")
        velocity = np.where(impacts > 0, impacts * newest_first("return_impact_velocity"), 0.0)
        sums.append((velocity, impacts, features["impact_velocity"][lanes]))
    if GROWTH in features:
        growth = features["rate_of_penetration"][lanes] * period
        sums.append((newest_first(GROWTH), None, growth))
    count = np.sum(np.isfinite(features[TIME][lanes]), axis=1)
    return Crossings(states, count, cycles, tuple(sums))


def _drift(crossings: Crossings, noise: float, resolved: float) -> PerLane:
    """Return the distance of periodic lanes.

    `noise`: relative rounding error of a crossing. `resolved`: smallest difference that determines multipliers.
    """
    distance, away = np.full((2, len(crossings.lag)), np.inf)
    for order, lanes in _by_order(crossings.highest):
        part = crossings.of(lanes)
        # If the limits of two orders differ, neither is reliable: the distance between them is added.
        differences = part.differences(order)
        fits = [fit_recurrence(part, differences, k, noise) for k in range(max(order - 1, 1), order + 1)]
        unknown = _is_unknown(part, fits, resolved)
        away[lanes] = np.where(unknown, np.inf, _distance_of_states(part, fits))
        distance[lanes] = np.fmax(away[lanes], _distance_of_means(part, fits))
    for shorter in range(1, crossings.lag.max(initial=0)):
        divided = np.flatnonzero((crossings.lag > shorter) & (crossings.lag % shorter == 0))
        part = crossings.of(divided)
        # At the end of a transient, only the first crossings fail the test of the shorter period.
        number = np.arange(part.lag.max(initial=0))[:, None]
        changes = np.abs(part.at(number) - part.at(number + shorter))
        apart = np.max(changes, axis=(0, 1), where=number < part.lag, initial=0.0)
        distance[divided[apart <= REPEATS_WITHIN + 2 * away[divided]]] = np.inf
        # A slow spiral towards an orbit with a shorter period seems periodic after each revolution.
        part = part._replace(lag=np.full(len(divided), shorter))
        for order, lanes in _by_order(np.where(part.are_resolved(resolved), part.highest, 0)):
            subset = part.of(lanes)
            fit = fit_recurrence(subset, subset.differences(order), order, noise)
            close = np.flatnonzero(fit.residual() < FITS_CLOSELY)
            if len(close):
                distance[divided[lanes[close[fit.of(close).radius() < DECAYS]]]] = np.inf
    return distance


def _by_order(highest: PerLaneInt) -> list[tuple[int, Index]]:
    """Return each order above 0 with the lanes of which it is the highest."""
    lanes = [(order, np.flatnonzero(highest == order)) for order in range(1, RECURRENCE_MAX_ORDER + 1)]
    return [pair for pair in lanes if len(pair[1])]


def _distance_of_states(crossings: Crossings, fits: list[Recurrence]) -> PerLane:
    """Return the distance of the last states from the limit of their recurrence, given fits of one or two orders."""
    numbers = crossings.lag * np.arange(len(fits[-1].coefficients) + 1)[:, None]
    distances = []
    for state in crossings.at(numbers):
        changes = [future_sum(state, fit) for fit in fits]
        distances.append(np.abs(changes[-1]) + np.abs(changes[-1] - changes[0]))
    return reduce(np.fmax, distances)


def _distance_of_means(crossings: Crossings, fits: list[Recurrence]) -> PerLane:
    """Return the relative distance of the means over the observation from their limits."""
    numbers = crossings.lag * np.arange(len(fits[-1].coefficients) + 1)[:, None]
    distances = []
    for total, count, mean in crossings.sums:
        values = _means(total, count, crossings.lag, numbers)
        limits = [values[0] + future_sum(values, fit) for fit in fits]
        distances.append((np.abs(limits[-1] - mean) + np.abs(limits[-1] - limits[0])) / np.abs(mean))
    return reduce(np.fmax, distances)


def _is_unknown(crossings: Crossings, fits: list[Recurrence], resolved: float) -> PerLaneBool:
    """Return a mask of the lanes that move away from the orbit, or whose differences obey no recurrence."""
    unknown = crossings.are_resolved(resolved)
    lanes = np.flatnonzero(unknown)  # few: most lanes are as near as rounding permits
    if len(lanes):
        part, fits = crossings.of(lanes), [fit.of(lanes) for fit in fits]
        number = np.arange(crossings.states.shape[1])[:, None]
        differences = np.abs(part.at(number) - part.at(number + part.lag))
        third = np.maximum((part.known - part.lag) // 3, 1)
        recent, before = (
            np.max(np.where(mask, differences, 0.0), axis=(0, 1))
            for mask in (number < third, (number >= third) & (number < 2 * third))
        )
        leaves = (recent > before) & np.all([fit.radius() > GROWS for fit in fits], axis=0)
        unknown[lanes] = leaves | (fits[-1].residual() > FITS)
    return unknown


def _means(total: Series, count: Series | None, window: PerLaneInt, first: Numbers) -> Series:
    """Return averages of the sums `total` over windows of section crossings, which begin at the numbers `first`.

    A window is divided by its number of crossings or, if `count` is not None, by its number of terms, such as impacts.
    """
    sums = []
    for series in (total,) if count is None else (total, count):
        over = pick(series, first)
        for k in range(1, window.max(initial=0)):
            lanes = np.flatnonzero(window > k)
            over[:, lanes] += pick(series[:, lanes], first[:, lanes] + k)
        sums.append(over)
    return sums[0] / (window if count is None else sums[1])
