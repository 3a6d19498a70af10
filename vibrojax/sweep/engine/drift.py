"""Distance of a lane that repeats from its limit, estimated from its last returns to the section.

Near an orbit, a return's distance from it is a linear map of that of the return before. So the differences between
returns d_k obey a linear recurrence d_k = sum_j c_j d_{k-jp}, p being the returns of a repeat: of order 1 for one
multiplier, 2 for a pair, 3 for all that a section state of three has. Its coefficients follow from the differences by
least squares. They give the sum of all future differences, of the states and of any function of them (reduced rank
extrapolation: Sidi, *Vector Extrapolation Methods*, 2017, chapter 2).
"""

from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.measures.kept_returns import INTERVAL, TIME, state_name
from vibrojax.measures.repeats import scales
from vibrojax.models.scenes import Section

RECURRENCE_MAX_ORDER = 3
"""A section state of three has three multipliers."""

RECURRENCE_MAX_EQUATIONS = 12
"""Only the newest differences: before, a lane may have been too far away for a linear map."""

DRIFT_RESOLVED = 1e4
"""Differences this many roundings long, and ten times the steps' tolerance, determine multipliers."""

FITS, FITS_CLOSELY = 0.3, 0.02
"""Relative residuals below which differences obey a recurrence at all, and below which no other recurrence explains
them."""

GROWS, DECAYS = 1.0005, 0.999
"""Greatest multipliers above which a lane leaves, and below which it approaches."""

PerLane = Float[np.ndarray, " lanes"]
Index = Int[np.ndarray, " lanes"]
Series = Float[np.ndarray, "lanes _"]
States = Float[np.ndarray, "lanes _ states"]
Features = dict[str, np.ndarray]


class Returns(NamedTuple):
    """Consecutive returns of lanes with the same repeat, the newest first.

    - `states`: at the section, over their scales.
    - `interval` [s], `impacts`, `velocity` [m/s]: time, impacts and the sum of their velocities since the return
      before; the last two are None in a scene without impacts.
    """

    states: States
    interval: Series
    impacts: Series | None
    velocity: Series | None


class Noise(NamedTuple):
    """Relative sizes: the effect of `rounding` on a return, and the least `resolved` difference."""

    rounding: float
    resolved: float


class Recurrence(NamedTuple):
    """d_k = sum_j c_j d_{k-jp}, its relative `residual`, and `radius`, its greatest multiplier."""

    coefficients: Float[np.ndarray, "lanes order"]
    residual: PerLane
    radius: PerLane


def drift(features: Features, section: Section, precision: str, tolerance: float) -> PerLane:
    """Return the relative distance of period and impact velocity from their limits, the larger.

    It is NaN for a lane that does not repeat, and infinite if the returns move away, approach a shorter repeat than
    theirs, or determine neither.

    **Arguments:**

    - `features`: of [vibrojax.measures][], among them the last returns: arrays (lanes,) and (lanes, returns), the
      newest last.
    - `section`: of the scene, whose states at the returns are compared.
    - `precision`: "float64" or "float32", that of the features; `tolerance`: of the steps, relative.
    """
    cycles = np.nan_to_num(features["cycles"]).astype(int)
    count = np.sum(np.isfinite(features[TIME]), axis=1)
    distance = np.full(cycles.shape, np.nan)
    rounding = 64 * float(np.finfo(precision).eps)
    noise = Noise(rounding, max(DRIFT_RESOLVED * rounding, 10 * tolerance))
    for repeat, returns in sorted({(int(p), int(n)) for p, n in zip(cycles, count, strict=True) if p > 0}):
        lanes = np.flatnonzero((cycles == repeat) & (count == returns))
        with np.errstate(all="ignore"):
            distance[lanes] = _drift(_last_returns(features, section, lanes, returns), features, lanes, repeat, noise)
    return distance


def _last_returns(features: Features, section: Section, lanes: Index, count: int) -> Returns:
    """Return the last `count` returns of a subset of the lanes."""

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
    # If two orders differ, neither is right: the distance between them is added.
    distances = []
    for values, mean in measured:
        limits = [values[:, 0] + _future_sum(values, repeat, fit) for fit in fits]
        distances.append((np.abs(limits[-1] - mean) + np.abs(limits[-1] - limits[0])) / np.abs(mean))
    for state in np.moveaxis(returns.states, -1, 0):
        changes = [_future_sum(state, repeat, fit) for fit in fits]
        distances.append(np.abs(changes[-1]) + np.abs(changes[-1] - changes[0]))
    resolved = np.max(np.abs(differences[:, 0]), axis=-1) > noise.resolved
    third = max(differences.shape[1] // 3, 1)
    recent, before = np.abs(differences[:, :third]), np.abs(differences[:, third : 2 * third])
    grown = np.max(recent, axis=(1, 2)) > np.max(before, axis=(1, 2))
    leaves = grown & np.all(np.stack([fit.radius > GROWS for fit in fits]), axis=0)
    unknown = resolved & (leaves | (fits[-1].residual > FITS))
    unknown |= _approaches_shorter_repeat(returns.states, repeat, noise)
    return np.where(unknown, np.inf, reduce(np.fmax, distances))


def _approaches_shorter_repeat(states: States, repeat: int, noise: Noise) -> Bool[np.ndarray, " lanes"]:
    """Return the lanes that approach an orbit whose repeat divides `repeat`: a slow spiral is back after a turn."""
    approaches = np.zeros(len(states), bool)
    for shorter in (p for p in range(1, repeat) if repeat % p == 0):
        differences = _differences(states, shorter)
        resolved = np.max(np.abs(differences[:, 0]), axis=-1) > noise.resolved
        fit = _fits(differences, shorter, noise)[-1]
        approaches |= resolved & (fit.residual < FITS_CLOSELY) & (fit.radius < DECAYS)
    return approaches


def _fits(differences: States, lag: int, noise: Noise) -> list[Recurrence]:
    """Return the recurrences of the highest order that has enough differences, and of the one below."""
    highest = min(RECURRENCE_MAX_ORDER, (differences.shape[1] - 1) // lag)
    return [_recurrence(differences, lag, order, noise) for order in range(max(highest - 1, 1), highest + 1)]


def _differences(values: States, lag: int) -> States:
    return values[:, :-lag] - values[:, lag:]


def _means(total: Series, count: Series | None, repeat: int) -> Series:
    """Return means over every `repeat` consecutive returns: per return, or per `count`."""
    windows = total.shape[1] - repeat
    over = np.sum([total[:, k : k + windows] for k in range(repeat)], axis=0)
    if count is None:
        return over / repeat
    return over / np.sum([count[:, k : k + windows] for k in range(repeat)], axis=0)


def _recurrence(differences: States, lag: int, order: int, noise: Noise) -> Recurrence:
    """Fit the recurrence of an `order` to the differences by least squares, with equal weights of the equations."""
    lanes, number, _ = differences.shape
    equations = min(number - order * lag, RECURRENCE_MAX_EQUATIONS)
    before = np.stack([differences[:, lag * j : lag * j + equations] for j in range(1, order + 1)], axis=-1)
    weight = 1 / np.sqrt(np.sum(before**2, axis=(2, 3)) + noise.rounding**2)
    now = (differences[:, :equations] * weight[:, :, None]).reshape(lanes, -1)
    before = (before * weight[:, :, None, None]).reshape(lanes, -1, order)
    # The possible share of rounding in the columns: without it, large coefficients would fit noise.
    blurred = 1e-12 + noise.rounding**2 * np.sum(weight**2, axis=1)
    gram = np.einsum("lij,lik->ljk", before, before) + blurred[:, None, None] * np.eye(order)
    coefficients = np.linalg.solve(gram, np.einsum("lij,li->lj", before, now)[..., None])[..., 0]
    off = np.einsum("lij,lj->li", before, coefficients) - now
    residual = np.sqrt(np.sum(off**2, axis=1) / np.sum(now**2, axis=1))
    companion = np.zeros((lanes, order, order))
    companion[:, 0] = coefficients
    companion[:, np.arange(1, order), np.arange(order - 1)] = 1.0
    return Recurrence(coefficients, residual, np.max(np.abs(np.linalg.eigvals(companion)), axis=1))


def _future_sum(values: Series, lag: int, fit: Recurrence) -> PerLane:
    """Return the sum of all future differences of `values`: sum_j c_j (d_0 + ... + d_{j-1})/(1 - sum_j c_j)."""
    order = fit.coefficients.shape[1]
    passed = np.cumsum([values[:, lag * j] - values[:, lag * (j + 1)] for j in range(order)], axis=0)
    return np.sum(fit.coefficients * passed.T, axis=1) / (1 - np.sum(fit.coefficients, axis=1))
