"""Derivatives of the features of periodic orbits with respect to parameters, by the implicit function theorem.

Features are measured over one period, with forward-mode tangents along (ds/dp, dp), where s is the state at the
section ([vibrojax.periodic.variations][]). Nothing is differentiated through the time in which a motion settles.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.compile.xla import precision
from vibrojax.io.variables import VARIABLES
from vibrojax.lanes.compiler import lane_function
from vibrojax.lanes.labels import measured_besides
from vibrojax.lazy import jax, jnp
from vibrojax.measures import PulseRecorder, Recorder, recorder_for
from vibrojax.measures.labels import HOLE_RADIUS
from vibrojax.measures.labels import derived as derived_quantities
from vibrojax.measures.recorder import Effort, LaneState, observe_block, settle_block
from vibrojax.measures.repeats import KeptReturns
from vibrojax.measures.section import on_orbit
from vibrojax.periodic.measuring import observation, past_states, past_times
from vibrojax.periodic.newton import PerLane, chain, solve
from vibrojax.periodic.return_map import bounds_of, over_segments
from vibrojax.periodic.tangent_loop import with_derivatives
from vibrojax.periodic.variations import DERIVATIVE_ACCURACY, ZERO_MULTIPLIER, Variations, eigenvalues
from vibrojax.physics.arrays import Array, Lanes
from vibrojax.scenes import Scene
from vibrojax.stepping import Varied, lane_at

NEAR_EVENT = 1e-4
"""Grazing margin below which derivatives are not valid: they would hold over a parameter range of about its square."""

NEUTRAL = 1e-6
"""Distance of a multiplier from 1 below which an orbit counts as neutral: it has no derivative."""

MOST_STEPS_MEASURED = 1e6
"""Limit of steps while an orbit is measured."""

DERIVATIVE_REASONS = (
    "none",
    "no-orbit",
    "neutral-orbit",
    "near-grazing",
    "near-stick",
    "undefined",
    "equal-multipliers",
    "failed",
)
"""Meaning of each value of `OrbitFeatures.reason`."""

NO_ORBIT = DERIVATIVE_REASONS.index("no-orbit")

COUNTED = {"impacts", "striker_turns", "settling_time", "error_estimate", "drift_estimate"}
"""Variables that do not vary smoothly with the parameters, so they cannot be differentiated."""

STABILITY, MARGIN = "log_multiplier", "grazing_margin"
"""Features of the orbit itself: natural logarithm of the largest modulus of the multipliers, and the distance from a
change in the order of events."""

MODULUS = "multiplier_abs_"
"""Prefix of the moduli of the multipliers, which are numbered from 0 in decreasing order."""

Features = dict[str, Any]


class OrbitFeatures(NamedTuple):
    """Features of periodic orbits, and their derivatives along the families of orbits; the first axis is the orbit.

    - `values`, `derivatives`: of the features `of`, and with respect to the parameters `by`; NaN where unknown.
    - `reason`: why value or derivative do not hold, a flag of `DERIVATIVE_REASONS`; 0 where they hold.
    - `state_derivatives`, `determinant_derivatives`: derivatives of the states at the section crossings and of the
      determinant of I - A, where A is the derivative of the map over one period.
    """

    values: Float[np.ndarray, "orbits of"]
    derivatives: Float[np.ndarray, "orbits of by"]
    reason: Int[np.ndarray, "orbits of"]
    state_derivatives: Float[np.ndarray, "orbits cycles states by"]
    determinant_derivatives: Float[np.ndarray, "orbits by"]

    def along(
        self, way: Float[np.ndarray, "orbits by"]
    ) -> tuple[Float[np.ndarray, "orbits cycles states"], Float[np.ndarray, " orbits"]]:
        """Return the derivatives of states and determinants along one direction of the parameters for each orbit."""
        return np.einsum("lksj,lj->lks", self.state_derivatives, way), (self.determinant_derivatives * way).sum(axis=1)


def orbit_variables(scene: Scene[Any]) -> tuple[str, ...]:
    """Return the names of the features of a scene's orbits that can be differentiated."""
    known = VARIABLES | measured_besides(scene)
    measured = [
        name
        for name in _measured_names(scene)
        if name in known and np.issubdtype(known[name].dtype, np.floating) and name not in COUNTED
    ]
    period = [] if "period" in measured else ["period"]
    moduli = [f"{MODULUS}{k}" for k in range(len(scene.driving_part().return_states))]
    return (*period, *measured, MARGIN, STABILITY, *moduli)


def differentiated(
    scene: Scene[Any],
    of: Sequence[str],
    by: Sequence[str],
    parameters: Mapping[str, PerLane],
    states: Float[np.ndarray, "lanes cycles states"],
    scales: Float[np.ndarray, "lanes states"],
    steps: PerLane,
) -> OrbitFeatures:
    """Return the features `of` periodic orbits, and their derivatives with respect to the parameters `by`.

    **Arguments:** `of`: names in `orbit_variables(scene)`; `parameters`: all parameters of the scene; `states`,
    `scales`: of the driving part's return map; `steps`: approximate number of steps of one period.
    """
    count = len(by)
    by = by or [*parameters][:1]
    varied = Variations.of(scene.driving_part(), by, parameters, states, scales)
    moduli, by_modulus, alike, neutral = _moduli(varied, scales)
    table: Features = {}
    tangents: Features = {}
    whole = np.ones(len(states), bool)
    if any(name not in (MARGIN, STABILITY) and not name.startswith(MODULUS) for name in of):
        table, tangents, whole = _measured(scene, by, parameters, states, steps, varied)
    for k in range(moduli.shape[1]):
        table[f"{MODULUS}{k}"], tangents[f"{MODULUS}{k}"] = moduli[:, k], by_modulus[:, k]
    largest = np.maximum(moduli[:, 0], np.finfo(float).eps)
    table[STABILITY], tangents[STABILITY] = np.log(largest), by_modulus[:, 0] / largest[:, None]
    least = varied.margin.min(axis=2)
    first = least.argmin(axis=1)
    number = np.arange(len(states))
    kind = varied.margin[number, first].argmin(axis=1)
    table[MARGIN], tangents[MARGIN] = least.min(axis=1), varied.d_margin[number, first, kind]
    switching, grazing = (varied.margin.min(axis=1) < NEAR_EVENT).T
    shape, none = (len(states), len(of)), np.zeros(len(states), bool)
    multiplier = {STABILITY: 0} | {f"{MODULUS}{k}": k for k in range(moduli.shape[1])}
    values, reasons, derivatives = np.full(shape, np.nan), np.zeros(shape, int), np.full((*shape, count), np.nan)
    for place, name in enumerate(of):
        value, slope = table[name], tangents[name]
        rules = {
            "failed": ~whole,
            "neutral-orbit": neutral,
            "near-grazing": grazing,
            "near-stick": switching,
            "undefined": ~np.isfinite(value),
            "equal-multipliers": alike[:, multiplier[name]] if name in multiplier else none,
        }
        reason = np.select([*rules.values()], [*map(DERIVATIVE_REASONS.index, rules)], 0)
        broken = (reason == 0) & ~np.isfinite(slope).all(axis=1)
        reasons[:, place] = np.where(broken, DERIVATIVE_REASONS.index("failed"), reason)
        values[:, place] = np.where(whole, value, np.nan)
        known = whole & ~neutral & np.isfinite(value)
        derivatives[:, place] = np.where(known[:, None], slope, np.nan)[:, :count]
    # By Jacobi's formula, det(I - A) varies by -det(I - A) tr((I - A)⁻¹ dA).
    matrix = np.eye(moduli.shape[1]) - chain(varied.jacobian)
    sound, shape = np.isfinite(matrix).all(axis=(1, 2)), varied.d_product.shape
    shift = solve(matrix, varied.d_product.reshape(*shape[:2], -1)).reshape(shape)
    determinant = np.linalg.det(np.where(sound[:, None, None], matrix, 0.0))
    trend = -determinant[:, None] * np.einsum("lssj->lj", shift)
    return OrbitFeatures(values, derivatives, reasons, varied.d_states[..., :count], trend[:, :count])


def _moduli(varied: Variations, scales: Float[np.ndarray, "lanes states"]) -> tuple[np.ndarray, ...]:
    """Return the moduli of the multipliers, their derivatives, and masks of equal ones and of neutral orbits."""
    values, slopes, alike = eigenvalues(chain(varied.jacobian), varied.d_product, scales)
    moduli = np.abs(values)
    is_zero = moduli <= ZERO_MULTIPLIER
    by_modulus = np.real(np.conj(values)[..., None] * slopes) / np.where(is_zero, 1.0, moduli)[..., None]
    by_modulus[is_zero] = moduli[is_zero] = 0.0
    neutral = ~(np.abs(1 - values).min(axis=1) >= NEUTRAL) | ~np.isfinite(varied.d_states).all(axis=(1, 2, 3))
    return moduli, by_modulus, alike, neutral


class _OnOrbit(NamedTuple):
    """Inputs of a motion on an orbit; the last axis is the lane. See [vibrojax.periodic.measuring.past_times][]."""

    parameters: dict[str, Lanes]
    state: Array
    when: Array
    period: Lanes


@lane_function(static=1)
def _features_along(
    scene: Scene[Any], on: _OnOrbit, along: _OnOrbit, past: Array, settle: Lanes, observe: Lanes, effort: Effort
) -> tuple[Features, Features]:
    """Return the features of lanes that begin on their orbits, and their derivatives along a direction per lane."""
    return jax.jvp(lambda on: _features(scene, on, past, settle, observe, effort), (on,), (along,))


def _features(
    scene: Scene[Any], on: _OnOrbit, past: Array, settle: Lanes, observe: Lanes, effort: Effort | None
) -> Features:
    """Return the features of lanes that begin on their orbits; without an `effort`, before they are stepped."""
    rows = dict(zip(scene.driving_part().return_states, on.state, strict=True))
    zero = jnp.zeros_like(on.period)
    state = tuple(rows.get(name, zero) for name in scene.state_names)
    c = scene.scaled(scene.constants(on.parameters), jax.lax.stop_gradient(state))
    recorder = recorder_for(scene)
    if isinstance(recorder, Recorder):
        recorder = replace(recorder, gauges=tuple(g for g in recorder.gauges if not isinstance(g, KeptReturns)))
    elif isinstance(recorder, PulseRecorder):
        recorder = replace(recorder, keep=0)
    lane = lane_at(scene, c, state)
    carry = recorder.settling(scene, lane)
    if isinstance(recorder, Recorder):
        carry = on_orbit(carry, past, on.when, on.period)
    if effort is None:
        features = recorder.read(scene, c, recorder.begin(scene, c, lane, carry))
    else:
        underway = LaneState(*with_derivatives((lane, carry)), zero)
        if scene is not scene.driving_part():  # only a driven part has to settle
            underway = settle_block(scene, Varied(), recorder, c, underway, settle, effort)
        _, features = observe_block(scene, Varied(), recorder, c, underway, settle, observe, effort)
    if "impacts" in features:  # per section crossing, because the observation is too short to detect a repeat
        quantities = derived_quantities(scene, features | {"cycles": zero + 1}, HOLE_RADIUS, jnp)
        features |= {name: x for name, x in quantities.items() if name != "specific_energy"}
    return {name: jnp.asarray(x).astype(zero.dtype) for name, x in features.items()}


@cache
def _measured_names(scene: Scene[Any]) -> tuple[str, ...]:
    """Return the names of the features of a scene, without computing the features."""
    with precision("float64"):
        lane = jnp.ones(1)
        rows = len(scene.driving_part().return_states)
        on = _OnOrbit(dict.fromkeys(scene.parameters(), lane), jnp.ones((rows, 1)), jnp.ones((8, 1)), lane)
        past = jnp.ones((8, rows, 1))
        return tuple(jax.eval_shape(lambda on: _features(scene, on, past, lane, lane, None), on))


def _measured(
    scene: Scene[Any],
    by: Sequence[str],
    parameters: Mapping[str, PerLane],
    states: Float[np.ndarray, "lanes cycles states"],
    steps: PerLane,
    varied: Variations,
) -> tuple[Features, Features, Bool[np.ndarray, " lanes"]]:
    """Return features over one period, derivatives (lanes, by), and a mask of lanes with the expected crossings."""
    lanes, cycles, _ = states.shape
    length, d_length = varied.times.sum(axis=1), varied.d_times.sum(axis=1)
    past, when, d_when = past_states(states), past_times(varied.times), past_times(varied.d_times)
    settle, observe, counted = observation(scene, varied.times)

    i, j = np.repeat(np.arange(lanes), len(by)), np.tile(np.arange(len(by)), lanes)
    p: dict[str, Lanes] = {name: parameters[name][i] for name in scene.parameters()}
    unit = {name: (j == by.index(name)) + 0.0 if name in by else 0.0 * j for name in p}
    on = _OnOrbit(p, states[i, 0].T, when[:, i], length[i] / cycles)
    along = _OnOrbit(unit, varied.d_states[i, 0, :, j].T, d_when[:, i, j], d_length[i, j] / cycles)
    effort = Effort(*bounds_of(DERIVATIVE_ACCURACY, MOST_STEPS_MEASURED))
    both = over_segments(
        lambda *own: _features_along(scene, *own, effort), on, along, past[..., i], settle[i], observe[i]
    )
    table, tangents = ({name: np.asarray(x).reshape(lanes, len(by)) for name, x in t.items()} for t in both)
    values = {name: x[:, 0] for name, x in table.items()}
    whole = (values["finished"] > 0) & (values["finite"] > 0)
    whole &= values[counted] == cycles + (counted == "returns")
    values["period"], tangents["period"] = length / cycles, d_length / cycles
    return values, tangents, whole
