"""Features of lanes with their derivatives along the parameters, in forward mode, and the checks of these."""

from collections.abc import Mapping, Sequence
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
"""Relative change of a parameter, up and down, that shows if the derivative holds nearby."""

INSENSITIVE = 1e-3
"""Elasticity below which the error of a derivative is taken relative to this elasticity instead."""

SERIES_MARGIN = 2.0
"""Factor on estimates of the remaining change: if the distance from the orbit oscillates, no series is geometric."""

DERIVATIVES_EQUAL = 1e-7
"""Relative differences between derivatives that count as none."""

TANGENT_BLOCK = 64
"""Lanes that are stepped together; each other number of lanes would need a program of its own."""

EVENTS = "events_per_repeat"
"""Feature that counts how often each guard is reached in a repeat."""

RUN_SHARES = (1 / 3, 2 / 3, 5 / 6, 1.0, 1.0, 1.0)
"""Shares of the settling time after which the runs of a derivative are observed; the last two move the parameter."""

HERE, UP, DOWN = 3, 4, 5
"""The run that gives the derivative, and those with the parameter moved up and down."""

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
"""Meaning of each flag of `reason`, in the order in which the rules are tried."""

Features = Mapping[str, Array]
RunFeatures = dict[str, Float[np.ndarray, "points parameters runs"]]
PerDerivative = Float[np.ndarray, "points variables parameters"]


class Times(NamedTuple):
    """Settling and observation times of lanes [s]: numbers, or arrays (lanes,) in a program."""

    settle: Any
    observe: Any


@dataclass(frozen=True)
class _EventCount(Gauge[Scene[Any]]):
    """One number for the events of all guards in a repeat: it changes wherever the order of events does."""

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
) -> tuple[RunFeatures, RunFeatures]:
    """Return the features of every run of every derivative, and their derivatives, by name.

    Each derivative has lanes of its own, with the tangent of one parameter, so that one compiled program serves all
    parameters.

    **Arguments:**

    - `points`: of one scene, with one start; `wrt`: the parameters' names.
    - `move`: the change of each parameter, up and down.
    - `shown`: True for progress on stderr.
    """
    shape = (len(points), len(wrt), len(RUN_SHARES))
    own = np.broadcast_to(np.eye(len(wrt))[None, :, :, None], (*shape[:2], len(wrt), len(RUN_SHARES)))
    moved = np.zeros(own.shape)
    moved[..., UP:] = own[..., UP:] * move[:, :, None, None] * [1.0, -1.0]
    values = {name: np.empty(shape) for name in points[0].parameters}
    for name, x in values.items():
        x[:] = np.array([point.parameters[name] for point in points])[:, None, None]
        if name in wrt:
            x += moved[:, :, wrt.index(name)]
    directions = {name: np.zeros(shape) for name in values}
    directions |= {name: own[:, :, place].copy() for place, name in enumerate(wrt)}
    settle = np.broadcast_to(times.settle * np.array(RUN_SHARES), shape)
    parts = []
    progress = Progress(len(points) * len(wrt), "derivatives", shown, pace=False)
    with precision("float64"), progress:
        for first in range(0, settle.size, TANGENT_BLOCK):
            # The last block is filled up with the last lane.
            lanes = np.minimum(np.arange(first, first + TANGENT_BLOCK), settle.size - 1)
            block, along = (
                {name: jnp.asarray(x.ravel()[lanes]) for name, x in table.items()} for table in (values, directions)
            )
            spans = Times(jnp.asarray(settle.ravel()[lanes]), jnp.full(TANGENT_BLOCK, times.observe))
            parts.append(jax.device_get(_differentiated(points[0].system, points[0].start, block, along, spans)))
            progress.reach((int(lanes[-1]) + 1) // len(RUN_SHARES))

    def joined(side: int) -> RunFeatures:
        names = parts[0][side]
        return {n: np.concatenate([part[side][n] for part in parts])[: settle.size].reshape(shape) for n in names}

    return joined(0), joined(1)


def measured_of(scene: Scene[Any]) -> set[str]:
    """Return the names of the scene's features, without computing any."""
    start = scene.starts[0] if scene.starts else None
    with precision("float64"):
        ones = jnp.ones(1)
        parameters = dict.fromkeys(scene.parameters(), ones)
        return set(jax.eval_shape(lambda p: _features(scene, start, p, Times(ones, ones)), parameters))


@lane_function(static=2, derives=True)
def _differentiated(
    scene: Scene[Any], start: Start | None, values: Features, along: Features, times: Times
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return features of lanes, and their derivatives along a direction in the parameters, each (lanes,)."""
    return jax.jvp(lambda p: _features(scene, start, p, times), (values,), (along,))


def _features(scene: Scene[Any], start: Start | None, p: Features, times: Times) -> dict[str, Array]:
    """Return the features of lanes, (lanes,), as floats."""
    recorder = recorder_for(scene)
    if isinstance(recorder, Recorder):
        gauges = (gauge for gauge in recorder.gauges if not isinstance(gauge, KeptReturns))
        recorder = replace(recorder, gauges=(*gauges, _EventCount()))
    c = scene.constants(p)
    state = scene.start(c, start, times.settle.shape)
    effort = Effort(Accuracy(tolerance=1e-12, stride=1.0, step=jnp.inf), 1e7)
    features = run_block(scene, Located(), recorder, c, state, effort, *times)
    return {name: jnp.asarray(x).astype(times.settle.dtype) for name, x in features.items()}


def judged(
    features: RunFeatures,
    tangents: RunFeatures,
    variables: Sequence[str],
    value: Float[np.ndarray, "points parameters"],
    move: Float[np.ndarray, "points parameters"],
    error: float,
) -> dict[str, Any]:
    """Return the arrays of the dataset: the variables, their derivatives, and the reasons why these may not hold.

    **Arguments:**

    - `features`, `tangents`: from `run_and_derive`; `variables`: the features that are differentiated.
    - `value`, `move`: of each parameter, and its change.
    - `error`: accepted relative error of a derivative.
    """
    y, slopes = (np.stack([table[name] for name in variables], axis=1) for table in (features, tangents))
    with np.errstate(all="ignore"):
        derivative, measured = slopes[..., HERE], y[..., HERE]
        relative = np.abs(measured) / np.where(value != 0, np.abs(value), move / NEARBY)[:, None]
        scale = np.maximum(np.abs(derivative), INSENSITIVE * relative)
        central = (y[..., UP] - y[..., DOWN]) / (2 * move[:, None])
        settling = np.s_[..., : HERE + 1]
        drift = np.fmax(_remaining(slopes[settling], scale), _remaining(y[settling], np.abs(measured)))
        elasticity = derivative * value[:, None] / measured
        off_slope = ~(np.abs(central - derivative) <= error * scale)
    finished = (features["finite"] > 0) & (features["finished"] > 0)
    counted = [name for name in (EVENTS, "cycles", "impacts", "yields", "pulses") if name in features]
    same: np.ndarray = np.all(finished, axis=-1)
    for name in counted:
        counts = features[name][..., HERE:]
        same &= np.all(counts == counts[..., :1], axis=-1)
    if EVENTS in features:
        same &= features[EVENTS][..., HERE] % 1 == 0
    repeats = features["cycles"][..., HERE] > 0 if "cycles" in features else np.ones(value.shape, bool)
    rules = {
        "failed": ~finished[..., HERE][:, None],
        "not-repeating": ~repeats[:, None],
        "zero-or-undefined": ~(np.abs(measured) > 0),
        "order-of-events-changes-nearby": ~same[:, None],
        "still-settling": ~(drift <= error),
        "not-the-slope-nearby": off_slope,
    }
    masks = [np.broadcast_to(mask, derivative.shape) for mask in rules.values()]
    return {
        "measured": measured[..., 0],
        "derivative": derivative,
        "elasticity": elasticity,
        "drift": drift,
        "central_difference": central,
        "reason": np.select(masks, [REASONS.index(name) for name in rules], 0),
    }


def _remaining(x: Float[np.ndarray, "points variables parameters times"], scale: PerDerivative) -> PerDerivative:
    """Return the distance of the values at the settling times of `RUN_SHARES` from their limit, over `scale`.

    It is the sum of a geometric series of the differences over a third of the way. It is no less than the last of
    these: at the first time the motion may still have been on another orbit.
    """
    before = np.abs(x[..., 1] - x[..., 0])
    recent = np.max(np.abs(x[..., 1:-1] - x[..., -1:]), axis=-1)  # of several: one may be small by chance
    ratio = np.nan_to_num(recent / before, nan=0.0)
    more = np.where(ratio < 1, ratio / (1 - ratio), np.inf)
    # Differences of a settled value are roundings, and their ratio means nothing.
    settled = recent <= DERIVATIVES_EQUAL * scale
    return np.where(settled, recent, SERIES_MARGIN * recent * np.maximum(more, 1.0)) / scale
