"""The 0-1 test for chaos: from a series alone, near 1 for chaotic and near 0 for regular motion.

Gottwald and Melbourne, SIAM Journal on Applied Dynamical Systems 8 (2009) 129: the series drives a translation in the
plane, which spreads like a random walk where the series is chaotic and stays bounded where it is regular.
"""

import numpy as np
from jaxtyping import Float

FREQUENCIES = 24
"""Frequencies of the translation, of whose results the median is taken."""

LONGEST, LAGS = 0.1, 24
"""Part of the series over which the spread is looked at, and at how many lags."""


def zero_one(series: Float[np.ndarray, "samples lanes"]) -> Float[np.ndarray, " lanes"]:
    """K of each lane's series, the median over many frequencies; NaN where a series is not finite or constant.

    The correlation method with the modified mean square displacement (their section 3); the frequencies are drawn from
    (pi/5, 4 pi/5), always the same, so that resonances with 0 and pi stay out.
    """
    samples = len(series)
    most = max(int(LONGEST * samples), 2)
    lag = np.unique(np.linspace(1, most, LAGS).round().astype(int))
    # A thousand numbers of order one: single precision is enough, and half the time.
    series = ((series - series.mean(axis=0)) / series.std(axis=0)).astype(np.float32)
    found = np.empty((FREQUENCIES, series.shape[1]))
    for at, c in enumerate(np.random.default_rng(0).uniform(np.pi / 5, 4 * np.pi / 5, FREQUENCIES)):
        turned = np.exp(1j * c * np.arange(1, samples + 1)).astype(np.complex64)[:, None] * series
        place = np.cumsum(turned, axis=0)
        spread = np.array([_mean_square(place[n : n + samples - most] - place[: samples - most]) for n in lag])
        found[at] = _correlation(lag.astype(float), spread)
    return np.median(found, axis=0)


def _mean_square(moved: np.ndarray) -> Float[np.ndarray, " lanes"]:
    return np.asarray(np.mean(moved.real**2 + moved.imag**2, axis=0))


def _correlation(
    lag: Float[np.ndarray, " lags"], spread: Float[np.ndarray, "lags lanes"]
) -> Float[np.ndarray, " lanes"]:
    """Correlation of the spread with the lag."""
    x, y = lag - lag.mean(), spread - spread.mean(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((x @ y) / np.sqrt((x @ x) * np.sum(y * y, axis=0)))
