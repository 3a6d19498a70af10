"""Estimates from series of returns: Lyapunov exponents, repeats, and the 0-1 test for chaos."""

import numpy as np
from jaxtyping import Float, Int

from vibrojax.measures.repeats import REPEATS_WITHIN

LATE_SHARE = 0.75
"""Share of the returns, the last, that an exponent uses: before, the tangent aligns and transients end."""

EXPONENT_BLOCKS = 16
"""Blocks of returns whose exponents' scatter gives the standard error."""

LONGEST_REPEAT = 64
"""Returns of the longest repeat that is recognised."""

TEST_FREQUENCIES = 24
"""Frequencies of the 0-1 test's translation; the median over them is the result."""

TEST_LAG_SHARE, TEST_LAGS = 0.1, 24
"""Largest lag of the 0-1 test over the length of the series, and number of lags."""

PerLane = Float[np.ndarray, " lanes"]
PerReturn = Float[np.ndarray, "returns lanes"]
States = Float[np.ndarray, "returns states lanes"]
Scale = Float[np.ndarray, "states lanes"]


def exponents(rate: PerReturn, time: PerReturn) -> tuple[PerLane, PerLane]:
    """Return the growth per second of each lane over the later returns, and its standard error.

    The mean is weighted by a bump that is flat at both ends. For regular motion it converges faster than any power of
    the length (Das, Saiki, Sander and Yorke, Nonlinearity 30 (2017) 4111); for chaotic motion any weight is as good.
    The error follows from blocks, each weighted in the same way: otherwise, growth that depends on where a block ends,
    and that the next block loses, would count as scatter.
    """
    late = int(LATE_SHARE * len(rate)) // EXPONENT_BLOCKS * EXPONENT_BLOCKS
    growth, seconds = rate[-late:], time[-late:]
    weight = _bump(late)
    exponent = weight @ growth / (weight @ seconds)
    each = _bump(late // EXPONENT_BLOCKS)
    blocks = [np.einsum("r,brl->bl", each, x.reshape(EXPONENT_BLOCKS, -1, x.shape[1])) for x in (growth, seconds)]
    return exponent, np.std(blocks[0] / blocks[1], axis=0, ddof=1) / EXPONENT_BLOCKS**0.5


def _bump(count: int) -> Float[np.ndarray, " count"]:
    """Return weights that vanish at both ends with all derivatives."""
    share = (np.arange(count) + 0.5) / count
    return np.exp(-1 / (share * (1 - share)))


def find_repeats(states: States, scale: Scale) -> Int[np.ndarray, " lanes"]:
    """Return the least number of returns after which each lane has come to repeat; 0 if it has not."""
    repeat = np.zeros(states.shape[2], int)
    for length in range(LONGEST_REPEAT, 0, -1):
        late = states[-3 * length - 1 :]
        repeat[np.all(np.abs(late[length:] - late[:-length]) < REPEATS_WITHIN * scale, axis=(0, 1))] = length
    return repeat


def exponents_of_repeats(
    rate: PerReturn, time: PerReturn, states: States, scale: Scale, exponent: PerLane, error: PerLane
) -> Int[np.ndarray, " lanes"]:
    """Return the repeat of each lane, 0 if none; replace its exponent and error by those over the repeats alone."""
    repeat = find_repeats(states, scale)
    for lane in np.flatnonzero(repeat):
        length, own = int(repeat[lane]), states[:, :, lane]
        repeats = np.all(np.abs(own[length:] - own[:-length]) < REPEATS_WITHIN * scale[:, lane], axis=1)
        returns = int(np.cumprod(repeats[::-1]).sum()) + length
        blocks = min(EXPONENT_BLOCKS, returns // length)
        whole = returns // (length * blocks) * length * blocks
        growth, seconds = (x[-whole:, lane].reshape(blocks, -1).sum(axis=1) for x in (rate, time))
        # A motion that only lingers near a repeating one still departs from it.
        if growth.sum() < 0:
            exponent[lane] = float(growth.sum()) / float(seconds.sum())
            error[lane] = float(np.std(growth / seconds, ddof=1)) / blocks**0.5
        else:
            repeat[lane] = 0
    return repeat


def zero_one(series: Float[np.ndarray, "samples lanes"]) -> PerLane:
    """Return K of the 0-1 test for chaos: near 1 for chaotic series, near 0 for regular ones.

    The series drives a translation in the plane. It spreads like a random walk if the series is chaotic, and stays
    bounded if it is regular. This is the correlation method with the modified mean square displacement (Gottwald and
    Melbourne, SIAM Journal on Applied Dynamical Systems 8 (2009) 129, section 3). The frequencies are fixed draws from
    (pi/5, 4 pi/5), which excludes resonances with 0 and pi.

    **Returns:** the median over the frequencies; NaN for a series that is constant or not finite.
    """
    samples = len(series)
    longest = max(int(TEST_LAG_SHARE * samples), 2)
    lags = np.unique(np.linspace(1, longest, TEST_LAGS).round().astype(int))
    # A thousand numbers of order one: single precision suffices, in half the time.
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
