"""Distance of a periodic lane from its limit, and lanes whose attractor is determined by rounding error.

Near a periodic orbit, the distance of a section crossing from the orbit is a linear map of that of the previous
crossing. If the motion is periodic with p crossings per period, let d_k be the differences between crossings that are
p apart. They obey a linear recurrence d_k = sum_j c_j d_{k-jp}. Its order is 1 for one dominant multiplier, 2 for a
pair, and 3 for all three multipliers of a section with three states. The coefficients are fitted to the differences by
least squares. They determine the sum of all future differences of the states and of any function of the states (reduced
rank extrapolation: Sidi, *Vector Extrapolation Methods*, 2017, chapter 2).
"""

from dataclasses import replace
from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.measures.repeats import INTERVAL, TIME, state_name
from vibrojax.measures.section import Settling
from vibrojax.models.scenes import Section
from vibrojax.sweep.engine.batch import Batch, Engine
from vibrojax.sweep.engine.underway import repeats_lately

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

PerLane = Float[np.ndarray, " lanes"]
Series = Float[np.ndarray, "lanes _"]
States = Float[np.ndarray, "lanes _ states"]
Features = dict[str, np.ndarray]
SumsAndMean = tuple[Series, Series | None, PerLane]
"""Sums of which period or impact velocity is the mean: the sum since the previous crossing (of time [s] or of
velocities [m/s]), the number of its terms (None for one term), and the lane's mean."""


class Recurrence(NamedTuple):
    """Fitted recurrence of differences with coefficients c_j, and its relative `residual`.

    `radius`: largest modulus of the roots of its characteristic polynomial, which estimate multipliers.
    """

    coefficients: Float[np.ndarray, "lanes order"]
    residual: PerLane
    radius: PerLane


def drift(features: Features, section: Section, precision: str, tolerance: float) -> PerLane:
    """Return the relative distance of period and impact velocity from their limits, whichever is larger.

    It is NaN for a lane that is not periodic. It is infinite if the section crossings move away from the orbit,
    approach an orbit with a shorter period, or determine neither.

    **Arguments:** `features`: (lanes,), and (lanes, returns) for the last section crossings, the newest last;
    `precision`: that of the features, "float64" or "float32"; `tolerance`: relative error tolerance of the steps.
    """
    cycles = np.nan_to_num(features["cycles"]).astype(int)
    count = np.sum(np.isfinite(features[TIME]), axis=1)
    distance = np.full(cycles.shape, np.nan)
    noise = 64 * float(np.finfo(precision).eps)
    resolved = max(DRIFT_RESOLVED * noise, 10 * tolerance)
    for repeat, returns in sorted({(int(p), int(n)) for p, n in zip(cycles, count, strict=True) if p > 0}):
        lanes = np.flatnonzero((cycles == repeat) & (count == returns))
        with np.errstate(all="ignore"):
            states, measured = _last_returns({name: x[lanes] for name, x in features.items()}, section, returns)
            distance[lanes] = _drift(states, measured, repeat, noise, resolved)
    return distance


def _last_returns(features: Features, section: Section, count: int) -> tuple[States, list[SumsAndMean]]:
    """Return the scaled states at consecutive section crossings, newest first, and the sums between them."""

    def newest_first(name: str) -> Series:
        return features[name][:, ::-1][:, :count].astype(float)

    swings = tuple(features[swing.amplitude] for swing in section.swings)
    scale = np.stack([np.asarray(x, float) for x in section.scales(swings, features["period"])], axis=-1)
    states = np.stack([newest_first(state_name(name)) for name in section.compared], axis=-1)
    measured: list[SumsAndMean] = [(newest_first(INTERVAL), None, features["period"])]
    if "return_impacts" in features:
        impacts = newest_first("return_impacts")
        velocity = np.where(impacts > 0, impacts * newest_first("return_impact_velocity"), 0.0)
        measured.append((velocity, impacts, features["impact_velocity"]))
    return states / scale[:, None], measured


def _drift(states: States, measured: list[SumsAndMean], repeat: int, noise: float, resolved: float) -> PerLane:
    """Return the distance of lanes with the same number `repeat` of section crossings per period.

    `noise`: relative rounding error of a crossing. `resolved`: smallest difference that determines multipliers.
    """
    differences = states[:, :-repeat] - states[:, repeat:]
    fits = _fits(differences, repeat, noise)
    if not fits:
        return np.full(len(differences), np.inf)
    # If the limits of two orders differ, neither is reliable: the distance between them is added.
    distances = []
    for total, count, mean in measured:
        values = _means(total, count, repeat)
        limits = [values[:, 0] + _future_sum(values, repeat, fit) for fit in fits]
        distances.append((np.abs(limits[-1] - mean) + np.abs(limits[-1] - limits[0])) / np.abs(mean))
    for state in np.moveaxis(states, -1, 0):
        changes = [_future_sum(state, repeat, fit) for fit in fits]
        distances.append(np.abs(changes[-1]) + np.abs(changes[-1] - changes[0]))
    third = max(differences.shape[1] // 3, 1)
    recent, before = np.abs(differences[:, :third]), np.abs(differences[:, third : 2 * third])
    grown = np.max(recent, axis=(1, 2)) > np.max(before, axis=(1, 2))
    leaves = grown & np.all([fit.radius > GROWS for fit in fits], axis=0)
    unknown = _is_resolved(differences, resolved) & (leaves | (fits[-1].residual > FITS))
    # A slow spiral towards an orbit with a shorter period seems periodic after each revolution.
    for shorter in (p for p in range(1, repeat) if repeat % p == 0):
        differences = states[:, :-shorter] - states[:, shorter:]
        fit = _fits(differences, shorter, noise)[-1]
        unknown |= _is_resolved(differences, resolved) & (fit.residual < FITS_CLOSELY) & (fit.radius < DECAYS)
    return np.where(unknown, np.inf, reduce(np.fmax, distances))


def _is_resolved(differences: States, resolved: float) -> Bool[np.ndarray, " lanes"]:
    return np.max(np.abs(differences[:, 0]), axis=-1) > resolved


def _fits(differences: States, lag: int, noise: float) -> list[Recurrence]:
    """Return two fitted recurrences: of the highest order that has enough differences, and of the order below."""
    highest = min(RECURRENCE_MAX_ORDER, (differences.shape[1] - 1) // lag)
    return [_recurrence(differences, lag, order, noise) for order in range(max(highest - 1, 1), highest + 1)]


def _means(total: Series, count: Series | None, repeat: int) -> Series:
    """Return moving averages of the sums `total` over `repeat` consecutive section crossings.

    A window is divided by its number of crossings or, if `count` is not None, by its number of terms, such as impacts.
    """
    windows = total.shape[1] - repeat
    over = np.sum([total[:, k : k + windows] for k in range(repeat)], axis=0)
    if count is None:
        return over / repeat
    return over / np.sum([count[:, k : k + windows] for k in range(repeat)], axis=0)


def _recurrence(differences: States, lag: int, order: int, noise: float) -> Recurrence:
    """Fit a recurrence of this `order` to the differences by least squares with equally weighted equations."""
    lanes, number, _ = differences.shape
    equations = min(number - order * lag, RECURRENCE_MAX_EQUATIONS)
    before = np.stack([differences[:, lag * j : lag * j + equations] for j in range(1, order + 1)], axis=-1)
    weight = 1 / np.sqrt(np.sum(before**2, axis=(2, 3)) + noise**2)
    now = (differences[:, :equations] * weight[:, :, None]).reshape(lanes, -1)
    before = (before * weight[:, :, None, None]).reshape(lanes, -1, order)
    # Regularization by the rounding noise in the columns: without it, large coefficients would fit noise.
    blurred = 1e-12 + noise**2 * np.sum(weight**2, axis=1)
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


GROWTH_RETURNS = 40
"""Number of section crossings in the shortest transient in which a step error can grow to the size of the motion. If a
perturbation of 1e-9 m at t = 0 leads to another attractor on the default map, the transient has at least 50."""

CHANGE, ROUNDINGS = 1e-9, 4
"""Relative perturbation of all parameters in the second run, and its minimum in units of machine epsilon. The errors of
the default steps have the same size."""

SECOND_RUNS, LANE_SECONDS = 8, 25e3
"""Number of second runs of an aperiodic lane, and size of the largest sweep in which they are made [lanes times
simulated seconds]. In such a sweep they take a second. In a large sweep of irregular lanes, they would take five times
as long as everything else."""


def sensitive(engine: Engine, start: Batch, features: Features) -> Int[np.ndarray, " lanes"]:
    """Return 1 for each lane whose attractor is determined by rounding error, else 0.

    `start`: the lanes at t = 0; `features`: features of the lanes and of their check run.
    """
    period, cycles, settled = (np.asarray(features[name], float) for name in ("period", "cycles", "settling_time"))
    flags = ((cycles == 0) & (features["check_cycles"] > 0)).astype(int)
    with np.errstate(invalid="ignore"):
        slow = np.flatnonzero((cycles > 0) & (settled > GROWTH_RETURNS * period))
    if len(slow):
        # Two periods after the lane has settled, compare the time since which the second run has been settled.
        returns = _returns(engine, _changed(engine, start.of(slow), 1), (settled + 2 * cycles * period)[slow])
        times = np.asarray(returns.seen.settled)[cycles[slow].astype(int) - 1, np.arange(len(slow))]
        flags[slow] = ~(np.abs(times - settled[slow]) < period[slow] / 2)
    run, irregular = engine.sweep.run, np.flatnonzero(cycles == 0)
    end = run.settle + run.observe
    if engine.sweep.lanes * end <= LANE_SECONDS and len(irregular):
        # Exclude lanes that have become periodic by the end of their observation.
        irregular = irregular[~_repeat(engine, start.of(irregular), end)]
        for changes in range(1, SECOND_RUNS + 1):
            if len(irregular):
                flags[irregular[_repeat(engine, _changed(engine, start.of(irregular), changes), end)]] = 1
                irregular = irregular[flags[irregular] == 0]
    return flags


def _changed(engine: Engine, start: Batch, changes: int) -> Batch:
    """Return the lanes at t = 0 with all parameters perturbed by `changes` times the relative perturbation."""
    change = max(CHANGE, ROUNDINGS * float(np.finfo(engine.sweep.run.precision).eps))
    parameters = {name: (x * (1 + changes * change)).astype(x.dtype) for name, x in start.given.parameters.items()}
    return engine.begun(replace(start, given=start.given._replace(parameters=parameters)))


def _repeat(engine: Engine, batch: Batch, end: float) -> Bool[np.ndarray, " lanes"]:
    """Step lanes from t = 0 and return a mask: True for lanes that are periodic at the time `end` [s]."""
    return repeats_lately(_returns(engine, batch, np.full_like(batch.begin, end)), end)


def _returns(engine: Engine, batch: Batch, until: PerLane) -> Settling:
    """Step lanes to the times `until` [s] and return their last section crossings."""
    [batch] = engine.settle([replace(batch, begin=until.astype(batch.begin.dtype))])
    assert batch.underway is not None
    returns: Settling = batch.underway.carry
    return returns
