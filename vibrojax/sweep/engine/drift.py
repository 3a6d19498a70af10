"""How far a lane that repeats still is from where it settles, estimated from its last returns to the section.

Near an orbit the distance of one return from it is a linear map of that of the return before, so the differences
between returns d_k obey a linear recurrence d_k = sum_j c_j d_{k-jp}, p being the returns of a repeat: of order 1 for
one multiplier, 2 for a pair, 3 for all that a section state of three has. Its coefficients follow from the differences
by least squares, and with them the sum of all differences still to come, of the states as of whatever is a function of
them (reduced rank extrapolation: Sidi, *Vector Extrapolation Methods*, 2017, chapter 2).
"""

from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.measures.kept_returns import INTERVAL, TIME, state_name
from vibrojax.measures.repeats import scales
from vibrojax.models.scenes import Section

HIGHEST_ORDER = 3
MOST_EQUATIONS = 12
"""The last so many differences: before, a lane may have been too far away for a linear map."""

RESOLVED = 1e4
"""Differences this many roundings long, and ten times the steps' tolerance, say something of multipliers."""

FITS, FITS_CLOSELY = 0.3, 0.02
"""Relative residual up to which differences obey a recurrence at all; and so that no other explains them."""

GROWS, DECAYS = 1.0005, 0.999
"""Greatest multiplier of a lane that leaves, and of one that comes closer."""

PerLane = Float[np.ndarray, " lanes"]
Index = Int[np.ndarray, " lanes"]
Series = Float[np.ndarray, "lanes _"]
States = Float[np.ndarray, "lanes _ states"]
Features = dict[str, np.ndarray]


class Returns(NamedTuple):
    """Consecutive returns of lanes that repeat after the same number of them, the newest first.

    - `states`: at the section, over their scales.
    - `interval` [s], `impacts`, `velocity` [m/s]: time, impacts and the sum of their velocities since the return
      before; the last two None in a scene without impacts.
    """

    states: States
    interval: Series
    impacts: Series | None
    velocity: Series | None


class Noise(NamedTuple):
    """Relative sizes: of what `rounding` does to a return, and from which on a difference is `resolved`."""

    rounding: float
    resolved: float


class Recurrence(NamedTuple):
    """d_k = sum_j c_j d_{k-jp}, and how well it holds: `residual` relative, `radius` its greatest multiplier."""

    coefficients: Float[np.ndarray, "lanes order"]
    residual: PerLane
    radius: PerLane


def drift(features: Features, section: Section, precision: str, tolerance: float) -> PerLane:
    """Relative distance of period and impact velocity from where they settle, the larger; NaN where a lane does not
    repeat. Infinite where its returns leave, come closer to a shorter repeat than theirs, or do not tell.

    **Arguments:**

    - `features`: of [vibrojax.measures][], among them the last returns: arrays (lanes,) and (lanes, returns), the
      newest last.
    - `section`: of the scene, whose states at the returns are compared.
    - `precision`: "float64" or "float32", in which they were measured; `tolerance`: of the steps, relative.
    """
    cycles = np.nan_to_num(features["cycles"]).astype(int)
    count = np.sum(np.isfinite(features[TIME]), axis=1)
    found = np.full(cycles.shape, np.nan)
    rounding = 64 * float(np.finfo(precision).eps)
    noise = Noise(rounding, max(RESOLVED * rounding, 10 * tolerance))
    for repeat, returns in sorted({(int(p), int(n)) for p, n in zip(cycles, count, strict=True) if p > 0}):
        lanes = np.flatnonzero((cycles == repeat) & (count == returns))
        with np.errstate(all="ignore"):
            found[lanes] = _drift(_last_returns(features, section, lanes, returns), features, lanes, repeat, noise)
    return found


def _last_returns(features: Features, section: Section, lanes: Index, count: int) -> Returns:
    """The last `count` returns of some lanes."""

    def newest_first(name: str) -> Series:
        return features[name][lanes][:, ::-1][:, :count].astype(float)

    swings = tuple(features[swing.amplitude][lanes] for swing in section.swings)
    scale = np.stack([np.asarray(x, float) for x in scales(swings, features["period"][lanes])], axis=-1)
    states = np.stack([newest_first(state_name(name)) for name in section.compared], axis=-1)
    impacts = velocity = None
    if "return_impacts" in features:
        impacts = newest_first("return_impacts")
        velocity = np.where(impacts > 0, impacts * newest_first("return_impact_velocity"), 0.0)
    return Returns(states / scale[:, None], newest_first(INTERVAL), impacts, velocity)


def _drift(returns: Returns, features: Features, lanes: Index, repeat: int, noise: Noise) -> PerLane:
    differences = _differences(returns.states, repeat)
    fits = _fits(differences, repeat, noise)
    if not fits:
        return np.full(len(lanes), np.inf)
    measured = [(_means(returns.interval, None, repeat), features["period"][lanes])]
    if returns.velocity is not None:
        measured.append((_means(returns.velocity, returns.impacts, repeat), features["impact_velocity"][lanes]))
    # Where two orders differ neither is the truth: the distance between them is added.
    limits = [[values[:, 0] + _still_to_come(values, repeat, fit) for fit in fits] for values, _ in measured]
    distances = [
        (np.abs(limit[-1] - mean) + np.abs(limit[-1] - limit[0])) / np.abs(mean)
        for limit, (_, mean) in zip(limits, measured, strict=True)
    ]
    for state in np.moveaxis(returns.states, -1, 0):
        changes = [_still_to_come(state, repeat, fit) for fit in fits]
        distances.append(np.abs(changes[-1]) + np.abs(changes[-1] - changes[0]))
    found = reduce(np.fmax, distances)
    resolved = np.max(np.abs(differences[:, 0]), axis=-1) > noise.resolved
    third = max(differences.shape[1] // 3, 1)
    lately, before = np.abs(differences[:, :third]), np.abs(differences[:, third : 2 * third])
    grown = np.max(lately, axis=(1, 2)) > np.max(before, axis=(1, 2))
    leaves = grown & np.all(np.stack([fit.radius > GROWS for fit in fits]), axis=0)
    unknown = resolved & (leaves | (fits[-1].residual > FITS))
    return np.where(unknown | _shorter_repeat(returns.states, repeat, noise), np.inf, found)


def _shorter_repeat(states: States, repeat: int, noise: Noise) -> Bool[np.ndarray, " lanes"]:
    """Where the returns come closer to an orbit that repeats after fewer of them, which divide `repeat`: a slow spiral
    is back after a turn."""
    found = np.zeros(len(states), bool)
    for shorter in (p for p in range(1, repeat) if repeat % p == 0):
        differences = _differences(states, shorter)
        resolved = np.max(np.abs(differences[:, 0]), axis=-1) > noise.resolved
        fit = _fits(differences, shorter, noise)[-1]
        found |= resolved & (fit.residual < FITS_CLOSELY) & (fit.radius < DECAYS)
    return found


def _fits(differences: States, lag: int, noise: Noise) -> list[Recurrence]:
    """The recurrences of the highest order that there are differences for, and of the one below."""
    order = min(HIGHEST_ORDER, (differences.shape[1] - 1) // lag)
    return [_recurrence(differences, lag, one, noise) for one in range(max(order - 1, 1), order + 1)]


def _differences(values: States, lag: int) -> States:
    return values[:, :-lag] - values[:, lag:]


def _means(total: Series, count: Series | None, repeat: int) -> Series:
    """Means over every `repeat` returns that follow each other: per return, or per `count`."""
    windows = total.shape[1] - repeat
    over = np.sum([total[:, k : k + windows] for k in range(repeat)], axis=0)
    if count is None:
        return over / repeat
    return over / np.sum([count[:, k : k + windows] for k in range(repeat)], axis=0)


def _recurrence(differences: States, lag: int, order: int, noise: Noise) -> Recurrence:
    """The recurrence of an `order` that the differences obey, by least squares; each equation counts the same."""
    lanes, number, _ = differences.shape
    equations = min(number - order * lag, MOST_EQUATIONS)
    before = np.stack([differences[:, lag * j : lag * j + equations] for j in range(1, order + 1)], axis=-1)
    weight = 1 / np.sqrt(np.sum(before**2, axis=(2, 3)) + noise.rounding**2)
    now = (differences[:, :equations] * weight[:, :, None]).reshape(lanes, -1)
    before = (before * weight[:, :, None, None]).reshape(lanes, -1, order)
    # What rounding may have put into the coefficients' columns: without it, noise would be fitted by large ones.
    blurred = 1e-12 + noise.rounding**2 * np.sum(weight**2, axis=1)
    gram = np.einsum("lij,lik->ljk", before, before) + blurred[:, None, None] * np.eye(order)
    coefficients = np.linalg.solve(gram, np.einsum("lij,li->lj", before, now)[..., None])[..., 0]
    off = np.einsum("lij,lj->li", before, coefficients) - now
    residual = np.sqrt(np.sum(off**2, axis=1) / np.sum(now**2, axis=1))
    companion = np.zeros((lanes, order, order))
    companion[:, 0] = coefficients
    companion[:, np.arange(1, order), np.arange(order - 1)] = 1.0
    return Recurrence(coefficients, residual, np.max(np.abs(np.linalg.eigvals(companion)), axis=1))


def _still_to_come(values: Series, lag: int, fit: Recurrence) -> PerLane:
    """The sum of all differences of `values` after the newest: sum_j c_j (d_0 + ... + d_{j-1})/(1 - sum_j c_j)."""
    order = fit.coefficients.shape[1]
    passed = np.cumsum([values[:, lag * j] - values[:, lag * (j + 1)] for j in range(order)], axis=0)
    return np.sum(fit.coefficients * passed.T, axis=1) / (1 - np.sum(fit.coefficients, axis=1))
