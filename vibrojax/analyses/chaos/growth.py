"""A tangent carried along the return map: by how much it grows from one return to the next, through all events.

The section takes the direction of the flow out, whose exponent is zero; the tangent goes with the time of every event
on the way, so that what events do to a neighbour, the saltation, is in its growth (Mueller, Chaos, Solitons and
Fractals 5 (1995) 1671). Where the bit sticks one direction is lost, and the tangent keeps what is left of it.
"""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrojax.compile.devices import precision, workers
from vibrojax.models.arrays import Array, Flags, Lanes
from vibrojax.models.scenes import Scene
from vibrojax.models.scenes.declared import Values
from vibrojax.periodic.return_map import MOST_STEPS, at_section, passed
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Goal, Lane, Located, Step, Stepper, lane_at
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.engine.parallel import in_parallel

STEPS = Accuracy(tolerance=1e-7, stride=LOCATED_STRIDE, step=np.inf)
"""Of the return map. A chaotic motion is another one at any other tolerance, its statistics are the same."""

HAND = 256
"""Lanes that one worker takes through all returns."""

ROWS = 128
"""Returns per call: a lane goes on past its own, and waits for others only in the end."""

PerLane = Float[np.ndarray, " lanes"]


class Growth(NamedTuple):
    """Lanes over many returns.

    - `rate` (returns, lanes): ln of what the tangent has grown by from return to return; `time` [s] of each.
    - `states` (returns, states, lanes): where they returned; NaN from where a lane did not return.
    - `tangent` (states, lanes): of norm 1 over the scales, with which the last return was left.
    """

    rate: Float[np.ndarray, "returns lanes"]
    time: Float[np.ndarray, "returns lanes"]
    states: Float[np.ndarray, "returns states lanes"]
    tangent: Float[np.ndarray, "states lanes"]


class _Way(NamedTuple):
    """Lanes on their way, and their tangents; `number` of returns so far, `since` [s] the last one, `rows` of all."""

    lane: Lane
    tangent: Values
    armed: Flags
    since: Lanes
    steps: Lanes
    number: Lanes
    rows: Array


@lane_function(static=3, derives=True)
def _pushed(
    scene: Scene[Any],
    stepper: Stepper,
    grows: bool,
    p: dict[str, Lanes],
    state: Array,
    tangent: Array,
    scale: Array,
    accuracy: Accuracy,
) -> tuple[Array, Array]:
    """The next `ROWS` returns of lanes that stand at the section: rows of ln growth, time [s] and states, (rows, 2 +
    states, lanes), NaN from where a lane does not return; and the tangent in the end, (states, lanes).

    **Arguments:** `grows`: whether the tangent goes along, else it stays as it is; `p`: parameters by name (lanes,);
    `state`, `tangent`, `scale` (states, lanes): of `scene.return_states`; the tangent over the scale.
    """
    section = scene.section
    assert section is not None
    begun = at_section(scene, state)
    c = scene.scaled(scene.constants(p), begun)
    zero = jnp.zeros_like(state[0])
    rows = jnp.full((ROWS, 2 + len(state), *zero.shape), jnp.nan, zero.dtype)
    none = jnp.zeros_like(zero, bool)
    way = _Way(lane_at(scene, c, begun), at_section(scene, tangent * scale), none, zero, zero, zero, rows)

    def active(way: _Way) -> Flags:
        return (way.number < ROWS) & (way.steps < MOST_STEPS) & jnp.isfinite(way.lane.state[0])

    def one(way: _Way) -> _Way:
        moving = active(way)

        def go(state: Values) -> tuple[Values, tuple[Lane, Step]]:
            lane = way.lane._replace(state=state)
            after, step = stepper.step(scene, c, lane, accuracy, Goal(jnp.inf, moving), marked=True)
            return after.state, (after, step)

        if grows:
            _, moved, (lane, step) = jax.jvp(go, (way.lane.state,), (way.tangent,), has_aux=True)
        else:
            moved, (_, (lane, step)) = way.tangent, go(way.lane.state)
        armed, returns = passed(scene, section, c, way.armed, step)
        here = returns & moving
        over = _own(scene, moved) / scale
        norm = jnp.sqrt(jnp.sum(over * over, axis=0))
        # A tangent that is lost altogether, as in a stick of all that moves, may as well be taken up anywhere.
        anew = at_section(scene, jnp.where(norm[None] > 0, over / norm[None], len(state) ** -0.5) * scale)
        since = way.since + step.dt
        row = jnp.stack([jnp.log(norm), since, *_own(scene, lane.state)])
        place = jnp.where(here, way.number, ROWS).astype(jnp.int32)
        put = jax.vmap(lambda rows, place, row: rows.at[place].set(row, mode="drop"), in_axes=-1, out_axes=-1)
        return _Way(
            lane,
            tuple(jnp.where(here, new, old) for new, old in zip(anew, moved, strict=True)),
            jnp.where(moving, armed & ~here, way.armed),
            jnp.where(here, 0.0, since),
            jnp.where(here, 0.0, way.steps + moving.astype(zero.dtype)),
            way.number + here.astype(zero.dtype),
            put(way.rows, place, row),
        )

    way = jax.lax.while_loop(lambda way: jnp.any(active(way)), one, way)
    return way.rows, _own(scene, way.tangent) / scale


def _own(scene: Scene[Any], state: Values) -> Array:
    """The return map's states among all of them, (states, lanes)."""
    return jnp.stack([state[scene.place(name)] for name in scene.return_states])


def grow(
    scene: Scene[Any],
    parameters: Mapping[str, PerLane],
    state: Float[np.ndarray, "states lanes"],
    tangent: Float[np.ndarray, "states lanes"],
    scale: Float[np.ndarray, "states lanes"],
    returns: int,
    steps: Accuracy = STEPS,
) -> Growth:
    """What becomes of lanes and their tangents over so many `returns`, a multiple of `ROWS`, by all workers.

    **Arguments:** `state`, `tangent`: at the section, the tangent of norm 1 over the `scale` of each state.
    """
    return _by_all(_grown, scene, parameters, state, tangent, scale, returns, steps)


def go_on(
    scene: Scene[Any],
    parameters: Mapping[str, PerLane],
    state: Float[np.ndarray, "states lanes"],
    scale: Float[np.ndarray, "states lanes"],
    returns: int,
    kept: int,
) -> Float[np.ndarray, "kept states lanes"]:
    """The last `kept` of the next `returns` of lanes, both multiples of `ROWS`, without tangents: in two thirds of the
    time."""
    (states,) = _by_all(_gone_on, scene, parameters, state, scale, scale, returns, STEPS, kept)
    return np.asarray(states)


def _by_all(
    along: Callable[..., tuple[Any, ...]],
    scene: Scene[Any],
    parameters: Mapping[str, PerLane],
    state: np.ndarray,
    tangent: np.ndarray,
    scale: np.ndarray,
    *how: Any,
) -> Any:
    """What `along` gives of lanes, by all workers."""
    count = state.shape[1]
    hands = np.array_split(np.arange(count), max(-(-count // HAND), min(len(workers()), count)))

    def work(_: jax.Device, lanes: np.ndarray) -> tuple[Any, ...]:
        p = {name: x[lanes] for name, x in parameters.items()}
        with precision("float64"):
            return along(scene, p, state[:, lanes], tangent[:, lanes], scale[:, lanes], *how)

    parts: list[Any] = [None] * len(hands)
    for index, part in in_parallel(work, hands, workers()):
        parts[index] = part
    joined = [np.concatenate(some, axis=-1) for some in zip(*parts, strict=True)]
    return type(parts[0])(*joined) if isinstance(parts[0], Growth) else joined


def _grown(scene: Any, p: Any, state: Any, tangent: Any, scale: Any, returns: int, steps: Accuracy) -> Growth:
    """The lanes of one worker, with their tangents."""
    accuracy = Accuracy(*map(np.float64, steps))
    parts: list[Any] = []
    for _ in range(returns // ROWS):
        rows, tangent = map(np.asarray, _pushed(scene, Located(), True, p, state, tangent, scale, accuracy))
        state = rows[-1, 2:]
        parts.append(rows)
    rows = np.concatenate(parts)
    return Growth(rows[:, 0], rows[:, 1], rows[:, 2:], tangent)


def _gone_on(
    scene: Any, p: Any, state: Any, tangent: Any, scale: Any, returns: int, steps: Accuracy, kept: int
) -> tuple[np.ndarray]:
    """The lanes of one worker, without tangents."""
    accuracy = Accuracy(*map(np.float64, steps))
    last: deque[np.ndarray] = deque(maxlen=kept // ROWS)
    for _ in range(returns // ROWS):
        rows = np.asarray(_pushed(scene, Located(), False, p, state, tangent, scale, accuracy)[0])
        state = rows[-1, 2:]
        last.append(rows[:, 2:])
    return (np.concatenate(last),)
