"""Growth of tangent vectors along the return map, through all events, and estimates from it: exponents, periods, chaos.

The section removes the direction of the flow, whose exponent is zero. The tangent includes the derivative of every
event time, so its growth contains the saltation (Mueller, Chaos, Solitons and Fractals 5 (1995) 1671). Sticking of the
bit removes one direction from the tangent, which keeps the others.
"""

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.compile.xla import precision, workers
from vibrojax.lanes.compiler import lane_function
from vibrojax.lanes.inputs import PerLane
from vibrojax.lazy import jax, jnp
from vibrojax.measures.repeats import REPEATS_WITHIN
from vibrojax.periodic.return_map import MOST_STEPS, at_section, passed
from vibrojax.physics.arrays import Array, Flags, Lanes
from vibrojax.scenes import Scene
from vibrojax.scenes.declared import Values
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Goal, Lane, Located, Step, Stepper, Varied, lane_at
from vibrojax.threads import in_parallel

ALIGNING_SHARE = 1 / 16
"""Fraction of the returns, at the beginning of the series, in which the tangent aligns."""

CHAOTIC_STDERRS = 6.0
"""Distance of an exponent from zero, in standard errors, above which a motion is averaged like a chaotic one."""

EXPONENT_BLOCKS = 16
"""Number of batches of returns; the scatter of their means gives the standard error."""

WIDER = 2.131 / 1.960
"""Factor of the standard error of so few batches, so that 1.96 of it cover 95 %: quantiles of Student's t distribution
with 15 degrees of freedom, and of the normal distribution."""

LONGEST_REPEAT = 64
"""Longest period, in returns, that is recognised."""

TEST_FREQUENCIES = 24
"""Number of frequencies of the 0-1 test's translation; the median over the frequencies is the result."""

TEST_LAG_SHARE, TEST_LAGS = 0.1, 24
"""Largest lag of the 0-1 test as a fraction of the length of the series, and number of lags."""

TANGENT_ACCURACY = Accuracy(tolerance=1e-7, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the return map. Another tolerance changes a chaotic trajectory, but not its statistics."""

TANGENT_LANES_PER_CALL = 256
"""Greatest number of lanes that one worker steps through all returns."""

RETURNS_PER_CALL = 128
"""Number of returns per compiled call; lanes wait for each other only at the end of a call."""

PerReturn = Float[np.ndarray, "returns lanes"]
States = Float[np.ndarray, "returns states lanes"]
PerState = Float[np.ndarray, "states lanes"]


def exponents(rate: PerReturn, time: PerReturn) -> tuple[PerLane, PerLane]:
    """Return each lane's exponential growth rate [1/s] over the returns, and the standard error of the rate.

    The growth of chaotic motions is averaged over all returns but the first, in which the tangent aligns. The error
    follows from the means of batches (Asmussen and Glynn, *Stochastic Simulation*, 2007, section 4.3), each relative to
    its duration.

    Other motions are weighted by a bump function, which is flat at both ends: their mean converges faster than any
    power of the length (Das, Saiki, Sander and Yorke, Nonlinearity 30 (2017) 4111). Without weights, growth that
    depends on where a batch ends, and that the next one reverses, would count as scatter.
    """
    size = int((1 - ALIGNING_SHARE) * len(rate)) // EXPONENT_BLOCKS
    each = np.ones(size), _bump(size)
    late = size * EXPONENT_BLOCKS
    results = []
    for weight, whole in zip(each, (np.ones(late), _bump(late)), strict=True):
        exponent = along_rows(whole[:, None] * rate[-late:]) / along_rows(whole[:, None] * time[-late:])
        growth, seconds = (
            along_rows(weight[:, None, None] * x[-late:].reshape(EXPONENT_BLOCKS, size, -1).swapaxes(0, 1))
            for x in (rate, time)
        )
        off = (growth - exponent * seconds) / (along_rows(seconds) / EXPONENT_BLOCKS)
        error = np.sqrt(along_rows(off**2) / (EXPONENT_BLOCKS - 1) / EXPONENT_BLOCKS)
        results.append((exponent, WIDER * error))
    chaotic = results[0][0] > CHAOTIC_STDERRS * results[0][1]
    exponent, error = (np.where(chaotic, *pair) for pair in zip(*results, strict=True))
    return exponent, error


def along_rows(x: np.ndarray) -> np.ndarray:
    """Return the sums over the rows of an array (rows, ..., lanes), added one after another.

    Thus no bit of a lane depends on the other lanes: numpy adds the rows of a single lane in pairs, and BLAS in blocks
    that depend on the number of lanes.
    """
    if x.shape[-1] == 1:
        return along_rows(np.repeat(x, 2, axis=-1))[..., :1]
    return np.asarray(np.add.reduce(np.ascontiguousarray(x), axis=0))


def _bump(count: int) -> Float[np.ndarray, " count"]:
    """Return bump-function weights, which vanish at both ends together with all derivatives."""
    share = (np.arange(count) + 0.5) / count
    return np.exp(-1 / (share * (1 - share)))


def find_repeats(states: States, scale: PerState) -> Int[np.ndarray, " lanes"]:
    """Return the period of each lane in returns, judged by its last three periods; 0 if a lane is not periodic."""
    repeat = np.zeros(states.shape[2], int)
    for length in range(LONGEST_REPEAT, 0, -1):
        late = states[-3 * length - 1 :]
        repeat[np.all(np.abs(late[length:] - late[:-length]) < REPEATS_WITHIN * scale, axis=(0, 1))] = length
    return repeat


def exponents_of_repeats(
    rate: PerReturn, time: PerReturn, states: States, scale: PerState, exponent: PerLane, error: PerLane
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
    series = series - along_rows(series) / samples
    series = (series / np.sqrt(along_rows(series**2) / samples)).astype(np.float32)
    x = lags.astype(float) - lags.astype(float).mean()
    result = np.empty((TEST_FREQUENCIES, series.shape[1]))
    frequencies = np.random.default_rng(0).uniform(np.pi / 5, 4 * np.pi / 5, TEST_FREQUENCIES)
    for k, frequency in enumerate(frequencies):
        turn = np.exp(1j * frequency * np.arange(1, samples + 1)).astype(np.complex64)
        place = np.cumsum(turn[:, None] * series, axis=0)
        moved = (place[lag : lag + samples - longest] - place[: samples - longest] for lag in lags)
        spread = np.array([along_rows(z.real**2 + z.imag**2) for z in moved]) / (samples - longest)
        y = spread - along_rows(spread) / len(lags)
        with np.errstate(invalid="ignore", divide="ignore"):
            result[k] = along_rows(x[:, None] * y) / np.sqrt((x @ x) * along_rows(y * y))
    return np.median(result, axis=0)


class Growth(NamedTuple):
    """Growth of tangents and states of lanes over many returns to the section.

    - `rate` (returns, lanes): logarithm of the tangent's growth since the return before; `time` [s] since then.
    - `states` (returns, states, lanes): states at the returns; NaN from the first missing return on.
    - `tangent` (states, lanes): tangent after the last return, divided by the scales and of norm 1.
    """

    rate: Float[np.ndarray, "returns lanes"]
    time: Float[np.ndarray, "returns lanes"]
    states: Float[np.ndarray, "returns states lanes"]
    tangent: PerState


class _Carry(NamedTuple):
    """Loop state: `since` [s] and `steps` count from the last return; `rows` hold all returns."""

    lane: Lane
    tangent: Values
    armed: Flags
    since: Lanes
    steps: Lanes
    number: Lanes
    rows: Array


@lane_function(static=3)
def _returns(
    scene: Scene[Any],
    stepper: Stepper,
    grows: bool,
    p: dict[str, Lanes],
    state: Array,
    tangent: Array,
    scale: Array,
    accuracy: Accuracy,
) -> tuple[Array, Array]:
    """Step lanes at the section through their next `RETURNS_PER_CALL` returns.

    **Arguments:**

    - `grows`: if False, the tangent is left unchanged.
    - `p`: parameters (lanes,) by name; `state`, `tangent`, `scale` (states, lanes): values of `scene.return_states`;
      the tangent is divided by the scale.

    **Returns:** rows of logarithmic growth, time [s] and states (returns, 2 + states, lanes), which are NaN from a
    missing return on; and the final tangent (states, lanes).
    """
    section = scene.section
    assert section is not None
    begin = at_section(scene, state)
    c = scene.scaled(scene.constants(p), begin)
    zero = jnp.zeros_like(state[0])
    rows = jnp.full((RETURNS_PER_CALL, 2 + len(state), *zero.shape), jnp.nan, zero.dtype)
    unarmed = jnp.zeros_like(zero, bool)

    def along_section(state: Array, tangent: Array) -> Values:
        moved: Values = jax.jvp(lambda x: scene.onto_section(c, at_section(scene, x)), (state,), (tangent,))[1]
        return moved

    lane = lane_at(scene, c, scene.onto_section(c, begin))
    carry = _Carry(lane, along_section(state, tangent * scale), unarmed, zero, zero, zero, rows)

    def return_states(state: Values) -> Array:
        return jnp.stack([state[scene.place(name)] for name in scene.return_states])

    def active(carry: _Carry) -> Flags:
        return (carry.number < RETURNS_PER_CALL) & (carry.steps < MOST_STEPS) & jnp.isfinite(carry.lane.state[0])

    def advance(carry: _Carry) -> _Carry:
        moving = active(carry)

        def step_from(state: Values) -> tuple[Values, tuple[Lane, Step]]:
            lane = carry.lane._replace(state=state)
            after, step = stepper.step(scene, c, lane, accuracy, Goal(jnp.inf, moving), marked=True)
            return after.state, (after, step)

        if grows:
            _, moved, (lane, step) = jax.jvp(step_from, (carry.lane.state,), (carry.tangent,), has_aux=True)
        else:
            moved, (_, (lane, step)) = carry.tangent, step_from(carry.lane.state)
        armed, returns = passed(scene, section, c, carry.armed, step)
        here = returns & moving
        after, scaled = return_states(lane.state), return_states(moved) / scale
        norm = jnp.sqrt(jnp.sum(scaled * scaled, axis=0))
        # If everything sticks, the tangent may vanish. It then starts again in an arbitrary direction.
        unit = along_section(after, jnp.where(norm[None] > 0, scaled / norm[None], len(state) ** -0.5) * scale)
        since = carry.since + step.dt
        row = jnp.stack([jnp.log(norm), since, *after])
        place = jnp.where(here, carry.number, RETURNS_PER_CALL).astype(jnp.int32)
        put = jax.vmap(lambda rows, place, row: rows.at[place].set(row, mode="drop"), in_axes=-1, out_axes=-1)
        return _Carry(
            lane,
            tuple(jnp.where(here, new, old) for new, old in zip(unit, moved, strict=True)),
            jnp.where(moving, armed & ~here, carry.armed),
            jnp.where(here, 0.0, since),
            jnp.where(here, 0.0, carry.steps + moving.astype(zero.dtype)),
            carry.number + here.astype(zero.dtype),
            put(carry.rows, place, row),
        )

    carry = jax.lax.while_loop(lambda carry: jnp.any(active(carry)), advance, carry)
    return carry.rows, return_states(carry.tangent) / scale


def grow(
    scene: Scene[Any],
    parameters: Mapping[str, Float[np.ndarray, " lanes"]],
    state: PerState,
    tangent: PerState,
    scale: PerState,
    returns: int,
    kept: int | None = None,
    grows: bool = True,
) -> Growth:
    """Step lanes and their tangents through `returns` returns, on all workers.

    **Arguments:**

    - `state`, `tangent`: values at the section; the tangent is divided by the `scale` of each state and has norm 1.
    - `returns`, `kept`: number of returns, and number of last returns to keep (None: all); both multiples of
      `RETURNS_PER_CALL`.
    - `grows`: if False, tangents and rates are meaningless, and the call takes two thirds of the time.
    """
    count = state.shape[1]
    shares = np.array_split(np.arange(count), max(-(-count // TANGENT_LANES_PER_CALL), min(len(workers()), count)))

    def work(_: object, lanes: np.ndarray) -> Growth:
        p = {name: x[lanes] for name, x in parameters.items()}
        x, dx, size = state[:, lanes], tangent[:, lanes], scale[:, lanes]
        accuracy = Accuracy(*map(np.float64, TANGENT_ACCURACY))
        last: deque[np.ndarray] = deque(maxlen=(kept or returns) // RETURNS_PER_CALL)
        with precision("float64"):
            for _ in range(returns // RETURNS_PER_CALL):
                rows, dx = map(
                    np.asarray, _returns(scene, Varied() if grows else Located(), grows, p, x, dx, size, accuracy)
                )
                x = rows[-1, 2:]
                last.append(rows)
        rows = np.concatenate(last)
        return Growth(rows[:, 0], rows[:, 1], rows[:, 2:], dx)

    parts: dict[int, Growth] = dict(in_parallel(work, shares, workers()))
    return Growth(*(np.concatenate(part, axis=-1) for part in zip(*(parts[k] for k in sorted(parts)), strict=True)))
