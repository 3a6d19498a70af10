"""Estimates from series of returns to the section: Lyapunov exponents, periods, and the 0-1 test for chaos."""

import numpy as np
from jaxtyping import Float, Int

from vibrojax.measures.repeats import REPEATS_WITHIN

LATE_SHARE = 0.75
"""Fraction of the returns, at the end of the series, that an exponent uses. Before, the tangent aligns and transients
end."""

EXPONENT_BLOCKS = 16
"""Number of blocks of returns; the scatter of their exponents gives the standard error."""

LONGEST_REPEAT = 64
"""Longest period, in returns, that is recognised."""

TEST_FREQUENCIES = 24
"""Number of frequencies of the 0-1 test's translation; the median over the frequencies is the result."""

TEST_LAG_SHARE, TEST_LAGS = 0.1, 24
"""Largest lag of the 0-1 test as a fraction of the length of the series, and number of lags."""

PerLane = Float[np.ndarray, " lanes"]
PerReturn = Float[np.ndarray, "returns lanes"]
States = Float[np.ndarray, "returns states lanes"]
Scale = Float[np.ndarray, "states lanes"]


def exponents(rate: PerReturn, time: PerReturn) -> tuple[PerLane, PerLane]:
    """Return each lane's exponential growth rate [1/s] over the later returns, and the standard error of the rate.

    The mean is weighted by a bump function, which is flat at both ends. For regular motion, the weighted mean converges
    faster than any power of the length (Das, Saiki, Sander and Yorke, Nonlinearity 30 (2017) 4111). For chaotic motion,
    any weights are equally good. The error follows from blocks that are weighted in the same way. Without weights,
    growth that depends on where a block ends, and that the next block reverses, would count as scatter.
    """
    late = int(LATE_SHARE * len(rate)) // EXPONENT_BLOCKS * EXPONENT_BLOCKS
    growth, seconds = rate[-late:], time[-late:]
    weight = _bump(late)
    exponent = weight @ growth / (weight @ seconds)
    each = _bump(late // EXPONENT_BLOCKS)
    blocks = [np.einsum("r,brl->bl", each, x.reshape(EXPONENT_BLOCKS, -1, x.shape[1])) for x in (growth, seconds)]
    return exponent, np.std(blocks[0] / blocks[1], axis=0, ddof=1) / EXPONENT_BLOCKS**0.5


def _bump(count: int) -> Float[np.ndarray, " count"]:
    """Return bump-function weights, which vanish at both ends together with all derivatives."""
    share = (np.arange(count) + 0.5) / count
    return np.exp(-1 / (share * (1 - share)))


def find_repeats(states: States, scale: Scale) -> Int[np.ndarray, " lanes"]:
    """Return the period of each lane in returns, judged by its last three periods; 0 if a lane is not periodic."""
    repeat = np.zeros(states.shape[2], int)
    for length in range(LONGEST_REPEAT, 0, -1):
        late = states[-3 * length - 1 :]
        repeat[np.all(np.abs(late[length:] - late[:-length]) < REPEATS_WITHIN * scale, axis=(0, 1))] = length
    return repeat


def exponents_of_repeats(
    rate: PerReturn, time: PerReturn, states: States, scale: Scale, exponent: PerLane, error: PerLane
) -> Int[np.ndarray, " lanes"]:
    """Return each lane's period in returns, 0 if none; restrict `exponent` and `error`, in place, to periodic parts."""
    repeat = find_repeats(states, scale)
    for lane in np.flatnonzero(repeat):
        length, own = int(repeat[lane]), states[:, :, lane]
        repeats = np.all(np.abs(own[length:] - own[:-length]) < REPEATS_WITHIN * scale[:, lane], axis=1)
        returns = int(np.cumprod(repeats[::-1]).sum()) + length
        blocks = min(EXPONENT_BLOCKS, returns // length)
        whole = returns // (length * blocks) * length * blocks
        growth, seconds = (x[-whole:, lane].reshape(blocks, -1).sum(axis=1) for x in (rate, time))
        # A motion that only lingers near an orbit still departs from it, so the tangent does not shrink.
        if growth.sum() < 0:
            exponent[lane] = float(growth.sum()) / float(seconds.sum())
            error[lane] = float(np.std(growth / seconds, ddof=1)) / blocks**0.5
        else:
            repeat[lane] = 0
    return repeat


def zero_one(series: Float[np.ndarray, "samples lanes"]) -> PerLane:
    """Return K of the 0-1 test for chaos: near 1 for chaotic series, near 0 for regular ones.

    The series drives a translation in the plane. The translation spreads like a random walk if the series is chaotic,
    and stays bounded if the series is regular. This is the correlation method with the modified mean square
    displacement (Gottwald and Melbourne, SIAM Journal on Applied Dynamical Systems 8 (2009) 129, section 3). The
    frequencies are fixed random draws from (pi/5, 4 pi/5), an interval that excludes resonances with 0 and pi.

    **Returns:** the median over the frequencies; NaN for a series that is constant or not finite.
    """
    samples = len(series)
    longest = max(int(TEST_LAG_SHARE * samples), 2)
    lags = np.unique(np.linspace(1, longest, TEST_LAGS).round().astype(int))
    # Single precision suffices for a thousand numbers of order one, and takes half the time.
    series = ((series - series.mean(axis=0)) / series.std(axis=0)).astype(np.float32)
    x = lags.astype(float) - lags.astype(float).mean()
    result = np.empty((TEST_FREQUENCIES, series.shape[1]))
    frequencies = np.random.default_rng(0).uniform(np.pi / 5, 4 * np.pi / 5, TEST_FREQUENCIES)
    for k, frequency in enumerate(frequencies):
        turn = np.exp(1j * frequency * np.arange(1, samples + 1)).astype(np.complex64)
        place = np.cumsum(turn[:, None] * series, axis=0)
        moved = (place[lag : lag + samples - longest] - place[: samples - longest] for lag in lags)
        spread = np.array([np.mean(z.real**2 + z.imag**2, axis=0) for z in moved])
        y = spread - spread.mean(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            result[k] = (x @ y) / np.sqrt((x @ x) * np.sum(y * y, axis=0))
    return np.median(result, axis=0)
