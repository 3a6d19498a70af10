"""Forward-mode derivatives of features of lanes with respect to parameters, and checks of these derivatives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrojax.compile.xla import precision
from vibrojax.lanes.compiler import lane_function
from vibrojax.maps.read import Point
from vibrojax.maps.starts import Start
from vibrojax.measures import Gauge, Moment, PulseRecorder, Recorder, Whole, recorder_for
from vibrojax.measures.recorder import Effort, run_block
from vibrojax.measures.repeats import KeptReturns
from vibrojax.physics.arrays import Array
from vibrojax.progress import Progress
from vibrojax.scenes import Scene
from vibrojax.stepping import Accuracy, Located

NEARBY = 1e-4
"""Relative change of a parameter, up and down, for the finite difference that checks the derivative."""

INSENSITIVE = 1e-3
"""Smallest elasticity to which the error of a derivative is relative."""

SERIES_MARGIN = 2.0
"""Safety factor on the estimated remaining change. The estimate assumes a geometric series, which does not hold if the
distance from the orbit oscillates."""

DERIVATIVES_EQUAL = 1e-7
"""Relative difference up to which two derivatives count as equal."""

TANGENT_BLOCK = 64
"""Number of lanes that are stepped together. It is fixed because each number would need a program of its own."""

EVENTS = "events_per_repeat"
"""Feature that encodes how often each guard is reached in one period."""

RUN_SHARES = (1 / 3, 2 / 3, 5 / 6, 1.0, 1.0, 1.0)
"""Fractions of the settling time after which the runs of a derivative are observed. In the last two runs, the parameter
is changed."""

HERE, UP, DOWN = 3, 4, 5
"""Indices of the run that gives the derivative, and of the runs with the parameter changed up and down."""

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
"""Meaning of each value of `reason`, in the order in which the rules are applied."""

Features = Mapping[str, Array]
RunFeatures = dict[str, Float[np.ndarray, "points parameters runs"]]
PerDerivative = Float[np.ndarray, "points variables parameters"]


@dataclass(frozen=True)
class _EventCount(Gauge[Scene[Any]]):
    """Gauge that encodes the numbers of events of all guards in one period as a single number."""

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
    settle: float,
    observe: float,
    shown: bool,
) -> tuple[RunFeatures, RunFeatures]:
    """Return two tables by name: the features of every run of every derivative, and the derivatives of these features.

    The derivative with respect to each parameter has its own lanes, so that one compiled program serves all parameters.
    `points` have one scene and one initial condition; `move`: change of each parameter, which is applied up and down;
    `settle`, `observe`: settling and observation times [s].
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
    settling = np.broadcast_to(settle * np.array(RUN_SHARES), shape)
    parts = []
    progress = Progress(len(points) * len(wrt), "derivatives", shown, pace=False)
    with precision("float64"), progress:
        for first in range(0, settling.size, TANGENT_BLOCK):
            # The last block is padded with copies of the last lane.
            lanes = np.minimum(np.arange(first, first + TANGENT_BLOCK), settling.size - 1)
            block, along = (
                {name: jnp.asarray(x.ravel()[lanes]) for name, x in table.items()} for table in (values, directions)
            )
            times = jnp.asarray(settling.ravel()[lanes]), jnp.full(TANGENT_BLOCK, observe)
            parts.append(jax.device_get(_differentiated(points[0].system, points[0].start, block, along, times)))
            progress.reach((int(lanes[-1]) + 1) // len(RUN_SHARES))

    return jax.tree.map(lambda *x: np.concatenate(x)[: settling.size].reshape(shape), *parts)


@lane_function(static=2, derives=True)
def _differentiated(
    scene: Scene[Any], start: Start | None, values: Features, along: Features, times: tuple[Array, Array]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return features of lanes, and their derivatives along the direction `along` in parameter space, each (lanes,)."""
    return jax.jvp(lambda p: _features(scene, start, p, times), (values,), (along,))


def _features(scene: Scene[Any], start: Start | None, p: Features, times: tuple[Array, Array]) -> dict[str, Array]:
    """Return the features of lanes as arrays (lanes,) of floats."""
    recorder = recorder_for(scene)
    if isinstance(recorder, Recorder):
        gauges = (gauge for gauge in recorder.gauges if not isinstance(gauge, KeptReturns))
        recorder = replace(recorder, gauges=(*gauges, _EventCount()))
    elif isinstance(recorder, PulseRecorder):
        recorder = replace(recorder, keep=0)
    c = scene.constants(p)
    state = scene.start(c, start, times[0].shape)
    effort = Effort(Accuracy(tolerance=1e-12, stride=1.0, step=jnp.inf), 1e7)
    features = run_block(scene, Located(), recorder, c, state, effort, *times)
    return {name: jnp.asarray(x).astype(times[0].dtype) for name, x in features.items()}


def judged(
    features: RunFeatures,
    tangents: RunFeatures,
    variables: Sequence[str],
    value: Float[np.ndarray, "points parameters"],
    move: Float[np.ndarray, "points parameters"],
    error: float,
) -> dict[str, Any]:
    """Return the arrays of the dataset: the variables, their derivatives, and reasons why a derivative may be invalid.

    `features`, `tangents`: results of `run_and_derive`. `error`: relative error tolerance of a derivative.
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
    """Return the distance of `x`, given at the settling times of `RUN_SHARES`, from its limit, divided by `scale`.

    The distance is the sum of a geometric series of the differences over successive thirds of the settling time. It is
    not less than the last difference, because at the first time the motion may still have been on another orbit.
    """
    before = np.abs(x[..., 1] - x[..., 0])
    # The maximum of several differences: a single one may be small by chance.
    recent = np.max(np.abs(x[..., 1:-1] - x[..., -1:]), axis=-1)
    ratio = np.nan_to_num(recent / before, nan=0.0)
    more = np.where(ratio < 1, ratio / (1 - ratio), np.inf)
    # Differences of a settled value are rounding errors, and their ratio is meaningless.
    settled = recent <= DERIVATIVES_EQUAL * scale
    return np.where(settled, recent, SERIES_MARGIN * recent * np.maximum(more, 1.0)) / scale
