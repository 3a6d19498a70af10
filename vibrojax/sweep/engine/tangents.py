"""Features of lanes and their derivatives along the parameters, in forward mode; and of lanes nearby and before."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrojax.compile.devices import precision
from vibrojax.measures import Gauge, Moment, Recorder, Whole, recorder_for
from vibrojax.measures.kept_returns import KeptReturns
from vibrojax.measures.run import Effort, run_block
from vibrojax.models.arrays import Array
from vibrojax.models.scenes import Scene
from vibrojax.progress import Progress
from vibrojax.stepping import Accuracy, Located
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.input.point import Point
from vibrojax.sweep.input.starts import Start

NEARBY = 1e-4
"""Part of its value by which a parameter is moved either way to see whether the derivative holds nearby."""

INSENSITIVE = 1e-3
"""Elasticity below which errors of a derivative count in proportion to this instead."""

MARGIN = 2.0
"""On estimates of what is still to come: where the distance from the orbit oscillates, no series is geometric."""

RESOLVED = 1e-7
"""Relative differences between derivatives that are as good as none."""

BLOCK = 64
"""Lanes that are stepped together; a program for other numbers of them would have to be compiled."""

EVENTS = "events_per_repeat"
"""The feature that says how often each guard is reached in a repeat."""

SETTLED = (1 / 3, 2 / 3, 5 / 6, 1.0, 1.0, 1.0)
"""Parts of the settling after which the runs of a derivative are observed; in the last two the parameter is moved."""

HERE, UP, DOWN = 3, 4, 5
"""Which of the runs gives the derivative, and those with the parameter moved either way."""

REASONS = (
    "none",
    "refused",
    "failed",
    "not-repeating",
    "zero-or-undefined",
    "order-of-events-changes-nearby",
    "still-settling",
    "not-the-slope-nearby",
)
"""Meaning of each flag of `reason`, in the order in which they are tried."""

Features = Mapping[str, Array]
Found = dict[str, Float[np.ndarray, "points parameters runs"]]
PerDerivative = Float[np.ndarray, "points variables parameters"]


class Times(NamedTuple):
    """How long lanes settle and are observed [s]: numbers, or arrays (lanes,) in a program."""

    settle: Any
    observe: Any


@dataclass(frozen=True)
class _Events(Gauge[Scene[Any]]):
    """One number for how often each guard was reached in a repeat: it differs wherever the order of events does."""

    summed = (EVENTS,)

    def increments(self, scene: Scene[Any], c: Any, moment: Moment) -> dict[str, Any]:
        hits = moment.step.hits
        weighed = (jnp.where(hits[name], 256.0**place, 0.0) for place, name in enumerate(scene.guard_names))
        return {EVENTS: sum(weighed, jnp.zeros_like(moment.step.dt))}

    def read(self, scene: Scene[Any], c: Any, carry: Any, whole: Whole) -> dict[str, Any]:
        return {EVENTS: whole.sums[EVENTS] * jnp.maximum(whole.cycles, 1) / whole.returns}


def run_and_derive(
    points: Sequence[Point],
    wrt: Sequence[str],
    move: Float[np.ndarray, "points parameters"],
    times: Times,
    shown: bool,
) -> tuple[Found, Found]:
    """Features of every run of every derivative, and their derivatives, by name.

    Each derivative has lanes of its own, a tangent of one parameter beside them, so that one compiled program serves
    whatever is differentiated.

    **Arguments:**

    - `points`: of one scene, with one start; `wrt`: the parameters' names.
    - `move`: by how much each parameter is moved either way.
    - `shown`: whether to say on stderr how far it is.
    """
    shape = (len(points), len(wrt), len(SETTLED))
    moved = np.zeros((*shape[:2], len(wrt), len(SETTLED)))
    of_itself = np.broadcast_to(np.eye(len(wrt))[None, :, :, None], moved.shape)
    moved[..., UP:] = of_itself[..., UP:] * move[:, :, None, None] * [1.0, -1.0]
    values = {name: np.empty(shape) for name in points[0].parameters}
    for name, x in values.items():
        x[:] = np.array([point.parameters[name] for point in points])[:, None, None]
        if name in wrt:
            x += moved[:, :, wrt.index(name)]
    along = {name: np.zeros(shape) for name in values}
    along |= {name: of_itself[:, :, place].copy() for place, name in enumerate(wrt)}
    settle = np.broadcast_to(times.settle * np.array(SETTLED), shape)
    parts = []
    progress = Progress(len(points) * len(wrt), "derivatives", shown, pace=False)
    with precision("float64"), progress:
        for lanes in _blocks(settle.size):
            at, direction = (
                {n: jnp.asarray(x.ravel()[lanes]) for n, x in all_of.items()} for all_of in (values, along)
            )
            spans = Times(jnp.asarray(settle.ravel()[lanes]), jnp.full(BLOCK, times.observe))
            done = _differentiated(points[0].system, points[0].start, at, direction, spans)
            parts.append(jax.device_get(done))
            progress.reach((int(lanes[-1]) + 1) // len(SETTLED))

    def joined(side: int) -> Found:
        names = parts[0][side]
        return {n: np.concatenate([part[side][n] for part in parts])[: settle.size].reshape(shape) for n in names}

    return joined(0), joined(1)


def measured_of(scene: Scene[Any]) -> set[str]:
    """Names of what is measured of the scene; nothing is computed for it."""
    start = scene.starts[0] if scene.starts else None
    with precision("float64"):
        one = jnp.ones(1)
        given = dict.fromkeys(scene.parameters(), one)
        return set(jax.eval_shape(lambda p: _features(scene, start, p, Times(one, one)), given))


def _blocks(lanes: int) -> Iterator[np.ndarray]:
    """Indices of lanes, a block at a time; the last is filled up with the last lane."""
    for first in range(0, lanes, BLOCK):
        yield np.minimum(np.arange(first, first + BLOCK), lanes - 1)


@lane_function(static=2, derives=True)
def _differentiated(
    scene: Scene[Any], start: Start | None, values: Features, along: Features, times: Times
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Features of lanes, and their derivatives along a direction in the parameters, each (lanes,)."""
    return jax.jvp(lambda p: _features(scene, start, p, times), (values,), (along,))


def _features(scene: Scene[Any], start: Start | None, p: Features, times: Times) -> dict[str, Array]:
    """What is measured of lanes, (lanes,), as floats."""
    recorder = recorder_for(scene)
    if isinstance(recorder, Recorder):
        gauges = (gauge for gauge in recorder.gauges if not isinstance(gauge, KeptReturns))
        recorder = replace(recorder, gauges=(*gauges, _Events()))
    c = scene.constants(p)
    state = scene.start(c, start, times.settle.shape)
    effort = Effort(Accuracy(tolerance=1e-12, stride=1.0, step=jnp.inf), 1e7)
    found = run_block(scene, Located(), recorder, c, state, effort, *times)
    return {name: jnp.asarray(x).astype(times.settle.dtype) for name, x in found.items()}


def judged(
    found: Found,
    tangents: Found,
    variables: Sequence[str],
    value: Float[np.ndarray, "points parameters"],
    move: Float[np.ndarray, "points parameters"],
    error: float,
) -> dict[str, Any]:
    """What of the runs goes to a dataset: the variables, their derivatives, and whether these hold.

    **Arguments:**

    - `found`, `tangents`: from `run_and_derive`; `variables`: the features that are differentiated.
    - `value`, `move`: of each parameter, and by how much it was moved.
    - `error`: accepted of a derivative, relative.
    """

    def stacked(all_of: Found) -> Float[np.ndarray, "points variables parameters runs"]:
        return np.stack([all_of[name] for name in variables], axis=1)

    with np.errstate(all="ignore"):
        y, slopes = stacked(found), stacked(tangents)
        derivative, measured = slopes[..., HERE], y[..., HERE]
        relative = np.abs(measured) / np.where(value != 0, np.abs(value), move / NEARBY)[:, None]
        scale = np.maximum(np.abs(derivative), INSENSITIVE * relative)
        central = (y[..., UP] - y[..., DOWN]) / (2 * move[:, None])
        way = np.s_[..., : HERE + 1]
        drift = np.fmax(_still_to_come(slopes[way], scale), _still_to_come(y[way], np.abs(measured)))
        elasticity = derivative * value[:, None] / measured
        unlike = ~(np.abs(central - derivative) <= error * scale)

    def here(x: np.ndarray) -> np.ndarray:
        return x[:, None, :]

    finished = (found["finite"] > 0) & (found["finished"] > 0)
    counts = [found[name][..., HERE:] for name in (EVENTS, "cycles", "impacts", "yields", "pulses") if name in found]
    same = np.all([x == x[..., :1] for x in counts], axis=(0, -1)) if counts else np.ones(value.shape, bool)
    whole = found[EVENTS][..., HERE] % 1 == 0 if EVENTS in found else np.ones(value.shape, bool)
    repeats = found["cycles"][..., HERE] > 0 if "cycles" in found else np.ones(value.shape, bool)
    rules = [
        ("failed", here(~finished[..., HERE])),
        ("not-repeating", here(~repeats)),
        ("zero-or-undefined", ~(np.abs(measured) > 0)),
        ("order-of-events-changes-nearby", here(~(same & whole & finished.all(axis=-1)))),
        ("still-settling", ~(drift <= error)),
        ("not-the-slope-nearby", unlike),
    ]
    rules = [(name, np.broadcast_to(rule, derivative.shape)) for name, rule in rules]
    reason = np.select([rule for _, rule in rules], [REASONS.index(name) for name, _ in rules], 0)
    return {
        "measured": measured[..., 0],
        "derivative": derivative,
        "elasticity": elasticity,
        "drift": drift,
        "central_difference": central,
        "reason": reason,
    }


def _still_to_come(x: Float[np.ndarray, "points variables parameters times"], scale: PerDerivative) -> PerDerivative:
    """How far the last of what was found at the first times of `SETTLED` is from where it settles, over `scale`.

    The sum of a geometric series of the differences over a third of the way, and no less than the last of these: at the
    first time the motion may still have been on another way.
    """
    before = np.abs(x[..., 1] - x[..., 0])
    lately = np.max(np.abs(x[..., 1:-1] - x[..., -1:]), axis=-1)  # of several: one may be small by chance
    ratio = np.nan_to_num(lately / before, nan=0.0)
    more = np.where(ratio < 1, ratio / (1 - ratio), np.inf)
    # Of what has settled the differences are roundings, and their ratio says nothing.
    settled = lately <= RESOLVED * scale
    return np.where(settled, lately, MARGIN * lately * np.maximum(more, 1.0)) / scale
