"""Features of one period of an orbit, among them the grazing margin: a distance, zero at grazing.

Guards are functions that are positive within a mode. The margin is the smallest of these quantities over the orbit:

- where a guard reaches zero: its slope, relative to a typical slope;
- where a guard has a positive minimum within a step: that minimum, relative to a typical value;
- at a switch: the guard values with which the new mode begins, relative to typical values. These values vanish where a
  stick phase appears or vanishes.

The section's velocity also counts as a guard while its next zero is a section crossing.

Of slower and slower bounces that end in rest on a stop (complete chatter), only the first counts. The map through all
of them is smooth, although the last bounces graze: the rest erases the differences (Nordmark and Piiroinen,
*Nonlinear Dynamics* 58 (2009), 85).
"""

from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from vibrojax.compile.xla import workers
from vibrojax.lanes.engine import Batch, Engine
from vibrojax.lanes.inputs import Features, Index, LaneInputs, PerLane
from vibrojax.lanes.programs import LaneArguments
from vibrojax.measures import recorder_for
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.physics.arrays import Array, Flags, Lanes
from vibrojax.scenes.declared import Section
from vibrojax.scenes.scene import ROUNDINGS, Scene
from vibrojax.settings.run_settings import RunSettings
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Lane, Located, Step
from vibrojax.stepping.polynomial import Coefficients, slope, value
from vibrojax.stepping.series import known

HOW = (
    "the least over the orbit of: |rate of a guard| where it is reached, over (its typical value times the rate of the "
    "free motion); a guard's least value within a mode where it is not, over its typical value; what a switch begins a "
    "mode with, over its typical value; the same of the section's velocity"
)
"""Definition of the margin, for dataset attributes."""

GRAZING = 1e-5
"""Margin below which no multipliers are reported. Near grazing the map has a square-root singularity, so its derivative
is valid over a distance of about the squared margin. At this limit that distance is 1e-10, the accepted residual."""

DEPARTED = 1e-9
"""Value of a guard at the start of a step, relative to its typical value, up to which the step departs from it."""

FLAT = 1e-9
"""Slope at the end of a step that counts as zero, relative to the slope at its start."""


@dataclass(frozen=True)
class Margin:
    """Grazing margin of a motion of `scene` with the constants `c`, accumulated step by step.

    The margin has three rows (3, lanes), see `total`. The first is that of switches of friction, which vanishes where a
    stick phase appears or vanishes. The second is that of all other guards. The third limits the validity of
    derivatives: it is the least of both, with the square root of a near miss. Short of a graze, the map is smooth over
    a distance of the margin itself, not of its square. `derives`: True if the margin is differentiated.
    """

    scene: Scene[Any]
    section: Section | None
    c: Any
    derives: bool = False

    def begin(self, zero: Lanes) -> Array:
        """Return the rows (5, lanes) before the first step; see `after`."""
        far = jnp.full_like(zero, jnp.inf)
        return jnp.stack([far, far, far, zero, far])

    def after(self, rows: Array, armed: Flags, lane: Lane, step: Step) -> Array:
        """Return the minimum of `rows` (5, lanes) and of the margins within `step`, which leads to `lane`.

        The last two rows are for bounces that may end in rest: the margin of the last bounce, and the least margin of
        the bounces since the first of the series. `armed`: mask of lanes whose next zero of the section's velocity is
        a crossing.
        """
        if not self.derives:
            lane, step = lax.stop_gradient((lane, step))
        states = tuple(known(polynomial) for polynomial in step.polynomials)
        functions = self.scene.guard_values(self.c, step.mode, states)
        scales = typical_values(self.scene.resolutions(self.c, step.mode, step.before, marked=False))
        # The fastest rate of the free motion [1/s].
        pace = self.scene.rate(self.c, tuple(jnp.full_like(step.dt, mode.calmest) for mode in self.scene.modes))
        turned = reduce(jnp.logical_or, [step.hits[name] for name in self._turns()], jnp.zeros_like(armed))
        at_switches, of_section = self._at_switches(lane, step), self._of_section(armed, step, pace)
        switches, others, reach = (
            [rows[0], *at_switches],
            [rows[1], *of_section],
            [rows[2], *at_switches, *of_section],
        )
        last, series = rows[3], rows[4]
        before, after = self.scene.at_rest(step.mode), self.scene.at_rest(lane.mode)
        for guard, function, scale in zip(self.scene.guards(), functions, scales, strict=True):
            f = function.arrays(len(step.polynomials[0]) - 1, step.dt)
            margins = switches if guard.is_switch else others
            hit = self.considered(guard.name, "hit", _at_hit(f, step, step.hits[guard.name], scale * pace))
            miss = self.considered(guard.name, "miss", _near_miss(f, step, scale, turned))
            if guard.name in before:
                bounces, rests = step.hits[guard.name] & ~before[guard.name], after[guard.name] & ~before[guard.name]
                slower = bounces & (hit < last)
                hit, series, last = (
                    jnp.where(slower, jnp.inf, jnp.where(bounces, jnp.minimum(hit, series), hit)),
                    jnp.where(
                        rests | (bounces & ~slower), jnp.inf, jnp.where(slower, jnp.minimum(hit, series), series)
                    ),
                    jnp.where(rests, 0.0, jnp.where(bounces, hit, last)),
                )
            margins += [hit, miss]
            reach += [hit, jnp.sqrt(lax.stop_gradient(miss))]
        return jnp.stack([*(reduce(jnp.minimum, margins) for margins in (switches, others, reach)), last, series])

    def total(self, rows: Array) -> Array:
        """Return the margins (3, lanes) after the last step."""
        return jnp.stack([rows[0], *jnp.minimum(rows[1:3], rows[4:])])

    def considered(self, guard: str, what: str, margin: Array) -> Array:
        """Return a margin of a guard, infinite where it does not count; `what`: hit, miss or switch."""
        return margin

    def _turns(self) -> list[str]:
        """Return the names of the markers of the section's oscillating positions, such as those of bit and striker."""
        swings = self.section.swings if self.section is not None else ()
        markers = {marker.velocity: marker.name for marker in self.scene.markers}
        return [markers[swing.velocity] for swing in swings if swing.velocity in markers]

    def _of_section(self, armed: Flags, step: Step, pace: Lanes) -> list[Array]:
        section = self.section
        if section is None:
            return []
        velocity = step.polynomials[self.scene.place(section.velocity)]
        speed = self.scene.speed_scale(self.c)
        hit = step.hits[self.scene.marker_of(section.velocity)]
        away = [-coefficient for coefficient in velocity] if section.rising else velocity
        near = jnp.where(armed, _near_miss(away, step, speed, jnp.zeros_like(armed)), jnp.inf)
        return [_at_hit(velocity, step, hit & armed, speed * pace), near]

    def _at_switches(self, lane: Lane, step: Step) -> list[Array]:
        """Return the non-zero guard values with which a mode begins after a switch, relative to typical values."""
        values = self.scene.guard_values(self.c, lane.mode, lane.state)
        small = self.scene.resolutions(self.c, lane.mode, lane.state, marked=False)
        places, margins = self.scene.switch_places, []
        for guard, g, zero, scale in zip(self.scene.guards(), values, small, typical_values(small), strict=True):
            if guard.is_switch:
                begins = step.hits[guard.name] & (lane.mode[places[guard.name]] == 0) & (g > zero)
                margins.append(self.considered(guard.name, "switch", jnp.where(begins, g / scale, jnp.inf)))
        return margins


def typical_values(resolutions: tuple[Any, ...]) -> list[Array]:
    """Return typical values of functions; `resolutions`: values below which the functions count as zero."""
    return [resolution / (ROUNDINGS * jnp.finfo(resolution.dtype).eps) for resolution in resolutions]


def _at_hit(f: Coefficients, step: Step, hit: Flags, rate: Array) -> jax.Array:
    """Return the slope at the end of a step that ends on the guard, relative to a typical `rate`; else infinity."""
    return jnp.where(hit, jnp.abs(slope(f, step.tau)) / (step.h * rate), jnp.inf)


def _near_miss(f: Coefficients, step: Step, scale: Array, turned: Flags) -> jax.Array:
    """Return the positive minimum of a function within the step, divided by `scale`; infinity without a minimum.

    `turned`: mask of steps that end where a velocity is zero, and hence at a minimum within rounding errors.
    """
    rate = [k * coefficient for k, coefficient in enumerate(f)][1:]
    start, end = rate[0], value(rate, step.tau)
    turns = (start < 0) & (end > jnp.where(turned, FLAT * start, 0.0))
    place = jnp.where(turns, step.tau * start / jnp.where(turns, start - end, 1), 0)
    for _ in range(2):
        better = place - value(rate, place) / slope(rate, place)
        place = jnp.where(turns & (better > 0) & (better < step.tau), better, place)
    least = value(f, place)
    # A motion that has just left a surface along a tangent begins next to it, with a rate that is a rounding error.
    departed = f[0] <= DEPARTED * scale
    return jnp.where(turns & (least > 0) & ~departed, least / scale, jnp.inf)


ORBIT_ACCURACY = Accuracy(tolerance=1e-10, stride=LOCATED_STRIDE, step=np.inf)
"""Accuracy of the steps with which orbits are measured."""

DRIVEN_RETURNS = 4
"""Section crossings after which a driven part has settled on the motion that the orbit imposes."""


class OrbitStart(NamedTuple):
    """Initial conditions of lanes on their orbits, at the section; the last axis of all arrays is the lane.

    - `lanes`: indices in their chunk; `state`: state of the return map; `cycles`: section crossings per period.
    - `past`, `when` [s]: states and times of the last crossings, newest first: `state` at time 0.
    - `steps`, `length` [s]: approximate number of steps, and duration, of one period.
    - `first`, `second`, `last`: durations between crossings [s], for the first, second and last segment from `state`.
    """

    lanes: Index
    state: Float[np.ndarray, "states lanes"]
    past: Float[np.ndarray, "8 states lanes"]
    when: Float[np.ndarray, "8 lanes"]
    cycles: Int[np.ndarray, " lanes"]
    steps: PerLane
    length: PerLane
    first: PerLane
    second: PerLane
    last: PerLane


def begun(
    lanes: Index,
    states: Float[np.ndarray, "lanes cycles states"],
    times: Float[np.ndarray, "lanes cycles"],
    steps: PerLane,
) -> OrbitStart:
    """Return initial conditions at the first of the `states` of each orbit; `times`: time to the next state [s]."""
    cycles, length = states.shape[1], times.sum(axis=1)
    ago = np.concatenate([np.zeros((len(lanes), 1)), np.cumsum(times[:, ::-1], axis=1)], axis=1)
    when = [-(ago[:, k % cycles] + (k // cycles) * length) for k in range(MOST_CYCLES)]
    past = np.moveaxis(states[:, -np.arange(MOST_CYCLES) % cycles], 0, -1)
    between = times[:, 0], times[:, 1 % cycles], times[:, -1]
    return OrbitStart(lanes, states[:, 0].T, past, np.stack(when), np.full(len(lanes), cycles), steps, length, *between)


def joined(parts: list[OrbitStart]) -> OrbitStart:
    """Concatenate the lanes of all `parts`."""
    return OrbitStart(*(np.concatenate(fields, axis=-1) for fields in zip(*parts, strict=True)))


def observation(scene: Scene[Any], begun: OrbitStart) -> tuple[PerLane, PerLane, str]:
    """Return settling time [s], duration [s], and the name of the feature that counts section crossings (or pulses).

    The observation covers one period of the orbit. It ends between two section crossings, so that rounding errors do
    not affect their number.
    """
    driving = scene.driving_part()
    settle, duration, counted = np.zeros(len(begun.lanes)), begun.length + begun.first + begun.second / 2, "returns"
    if driving.section is None:  # the pulse that begins at t = 0 counts
        duration, counted = begun.length + begun.first / 2, "pulses"
    if scene is not driving:
        settle = -(-DRIVEN_RETURNS // begun.cycles) * begun.length - begun.last / 2
        duration = begun.length + (begun.last + begun.first) / 2
    return settle, duration, counted


class Measuring:
    """Measurement of lanes on their orbits, with the compiled programs of their run, whose settings are `run`."""

    def __init__(self, scene: Scene[Any], run: RunSettings, start_names: tuple[str, ...]) -> None:
        self._scene, self._driving = scene, scene.driving_part()
        exact = replace(run, precision="float64", method="located")
        recorder = recorder_for(scene, run.keep_returns)
        self._engine = Engine(scene, exact, start_names, Located(), recorder, workers())

    def __call__(self, inputs: LaneInputs, begun: OrbitStart) -> tuple[Features, Bool[np.ndarray, " lanes"]]:
        """Measure some of the lanes, see `of`."""
        return self.of(self._engine.given(inputs), begun)

    def of(
        self, given: LaneArguments, begun: OrbitStart, steps: Accuracy = ORBIT_ACCURACY
    ) -> tuple[Features, Bool[np.ndarray, " lanes"]]:
        """Return the features over one period, and a mask of lanes with the expected number of section crossings.

        `given`: parameters and initial conditions of the chunk, of which `begun` holds some lanes.
        """
        lanes, scene = begun.lanes, self._scene
        known = dict(zip(self._driving.return_states, begun.state, strict=True))
        zero = np.zeros(len(lanes))
        state = tuple(np.ascontiguousarray(known.get(name, zero)) for name in scene.state_names)
        settle, duration, counted = observation(scene, begun)
        given = jax.tree.map(lambda x: np.take(x, lanes).astype(float if x.dtype.kind == "f" else x.dtype), given)
        batch = Batch(steps, lanes, given, settle, duration, None, begun.steps.astype(np.int32))
        batch = self._engine.on_orbit(batch, state, begun.past, begun.when, begun.length / begun.cycles)
        [features] = self._engine.observe(self._engine.settle([batch]) if np.any(settle) else [batch])
        # The observation is too short to detect a period, so `impacts` is per section crossing, and means are taken
        # over the complete observation.
        number = features[counted] == begun.cycles + (counted == "returns")
        return features, features["finished"] & features["finite"] & number
