"""Variables of lanes with labels (regimes), from their features.

Lanes that are too stiff or too slow for the steps or the precision to give a meaningful regime are rejected.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int8, Shaped

from vibrojax.compile.xla import precision
from vibrojax.io.variables import ORBIT_REASONS, OWN_REGIMES, REASONS, STATUSES, VARIABLES, Variable, orbit_name
from vibrojax.lanes.compiler import lane_function
from vibrojax.lanes.inputs import Features, LaneInputs
from vibrojax.lazy import jax, jnp
from vibrojax.measures import gauge_named, recorder_for
from vibrojax.measures.labels import LABELLED_BY, REGIMES, derived, derived_names, label
from vibrojax.measures.recorder import Effort, run_block
from vibrojax.measures.repeats import state_name
from vibrojax.measures.since_start import scale_names
from vibrojax.physics.arrays import Array
from vibrojax.scenes import HasContact, HasFriction, HasImpacts, HasRock, Scene
from vibrojax.settings.run_settings import RunSettings
from vibrojax.stepping import AccuracyRequest, stepper_named

ERROR_UNDER_PULSES = "estimated relative error of the settled rate of penetration (NaN if the motion does not repeat)"
ERROR_OF_DRILL = "largest of the estimated relative errors of settled period, impact velocity and rate of penetration"
"""Meanings of `error_estimate` of scenes without a section, and of scenes with a section and rock."""

_OF_ALL = {"status", "reason", "error_estimate"}
_WITH_ORBITS = {name for name in VARIABLES if name.startswith(("multiplier_", "orbit_"))} | {"stable", "grazing_margin"}
_WITH_SECTION = {"regime", "check_regime", "drift_estimate", "sensitive", "hidden_motion"}
_WITH_SECTION |= {name for name in VARIABLES if name.startswith("nearby_")}


def labelled(inputs: LaneInputs, features: Features) -> Features:
    """Return the stored variables of lanes, in dataset order.

    `features`: (lanes,), or (lanes, rows) for stored section crossings; the variables have the same shapes.
    """
    features = _finished(inputs, features)
    variables = {}
    for name, variable in variables_of(inputs.scene).items():
        if name in features:
            x = features[name]
            integer = np.issubdtype(variable.dtype, np.integer)
            variables[name] = np.nan_to_num(x).astype(variable.dtype) if integer else x
    return variables


def variables_of(scene: Scene[Any]) -> dict[str, Variable]:
    """Return all variables that lanes of a scene may have, by name and in dataset order."""
    return VARIABLES | regime_variables(scene) | measured_besides(scene) | of_orbits(scene) | scales_of_orbits(scene)


def sweep_variables(scene: Scene[Any]) -> dict[str, Variable]:
    """Return the variables that datasets of the scene's sweeps may have, by name."""
    orbit_states = of_orbits(scene) | scales_of_orbits(scene)
    held = {*_OF_ALL, *feature_names(scene), *derived_names(scene)}
    held |= {*_WITH_ORBITS, *orbit_states} if orbit_states else set()
    held |= _WITH_SECTION if scene.section is not None else set()
    known = VARIABLES | measured_besides(scene) | orbit_states
    return {name: about for name, about in known.items() if name in held}


@cache
def feature_names(scene: Scene[Any]) -> frozenset[str]:
    """Return the names of the features that a scene's recorder measures."""

    def run() -> Any:
        values = {name: jnp.full(1, parameter.default) for name, parameter in scene.parameters().items()}
        constants = scene.constants(values)
        state = scene.start(constants, scene.starts[0] if scene.starts else None, (1,))
        stepper = stepper_named("located")
        effort = Effort(stepper.accuracy(AccuracyRequest(error=1e-4), scene), 1.0)
        return run_block(scene, stepper, recorder_for(scene), constants, state, effort, 1.0, 1.0)

    with precision("float64"):
        return frozenset(jax.eval_shape(run))


def with_radius(bit_radius: float) -> dict[str, Variable]:
    """Return the variable `specific_energy` with the radius of the hole [m] that it is computed with."""
    energy = VARIABLES["specific_energy"]
    return {"specific_energy": replace(energy, notes={**energy.notes, "bit_radius": bit_radius})}


def regime_variables(scene: Scene[Any]) -> dict[str, Variable]:
    """Return the variables with regimes, in which some regimes have the scene's own names."""
    names = tuple(scene.regime_names.get(name, name) for name in REGIMES)
    if names == REGIMES and isinstance(scene, HasFriction | HasContact):
        return {}
    regime = replace(VARIABLES["regime"], long_name=OWN_REGIMES, flags=names)
    return {"regime": regime, "check_regime": replace(VARIABLES["check_regime"], flags=names)}


def measured_besides(scene: Scene[Any]) -> dict[str, Variable]:
    """Return the variables that the scene's section and the scene's own gauges declare, or that mean something else."""
    if scene.section is None:
        return {"error_estimate": replace(VARIABLES["error_estimate"], long_name=ERROR_UNDER_PULSES)}
    variables = {}
    if isinstance(scene, HasRock):
        variables["error_estimate"] = replace(VARIABLES["error_estimate"], long_name=ERROR_OF_DRILL)
    for swing in scene.section.swings:
        state = scene.states[scene.place(swing.position)]
        if swing.amplitude not in VARIABLES:
            variables[swing.amplitude] = Variable(state.unit, f"half the peak-to-peak range of: {state.long_name}")
    for state in scene.states:
        name = state_name(state.name)
        if state.name in scene.return_states and name not in VARIABLES:
            variables[name] = Variable(state.unit, f"{state.long_name} at the return", along="return_index")
    if isinstance(scene, HasImpacts) and scene.impact_unit != "m s-1":
        velocities = ("impact_velocity", "impact_velocity_min", "impact_velocity_max", "return_impact_velocity")
        variables |= {name: replace(VARIABLES[name], units=scene.impact_unit) for name in velocities}
    gauges = map(gauge_named, scene.measures)
    return variables | {name: Variable(*about) for gauge in gauges for name, about in gauge.variables.items()}


def of_orbits(scene: Scene[Any]) -> dict[str, Variable]:
    """Return the variables that hold the states of periodic orbits at the section."""
    return {
        orbit_name(state.name): Variable(state.unit, f"{state.long_name}, on the orbit at the section")
        for state in scene.states
        if state.name in scene.driving_part().return_states
    }


def scales_of_orbits(scene: Scene[Any]) -> dict[str, Variable]:
    """Return the variables that hold the scales of repeats, if these are not amplitudes."""
    section = scene.driving_part().section
    states = [scene.states[scene.place(swing.position)] for swing in section.swings] if section is not None else []
    return {
        orbit_name(name): Variable(state.unit, f"scale of {state.long_name} in the test of repeats")
        for name, state in zip(scale_names(section), states, strict=False)
    }


def _finished(inputs: LaneInputs, features: Features) -> Features:
    """Return the features with regime, status and reason, and with NaN in lanes that failed or were rejected."""
    scene, values = inputs.scene, inputs.parameters
    why, unfit = scene.refused(values) or ("none", np.zeros(len(inputs), bool))
    stiff, slow = too_stiff_or_slow(scene, inputs.run, values)
    refused = unfit | stiff | slow
    flags = [REASONS.index(name) for name in (why, "too-stiff", "too-slow", "not-finite", "out-of-steps")]
    reason = np.select([unfit, stiff, slow, ~features["finite"], ~features["finished"]], flags, 0)
    if not features["finite"].all():
        reason = np.where(reason == REASONS.index("not-finite"), _reasons_of_starts(inputs), reason)
    for number, name in enumerate(scene.fault_reasons[1:] if "fault" in features else (), start=1):
        ends = (reason == REASONS.index("not-finite")) & (features["fault"] == number)
        reason = np.where(ends, REASONS.index(name), reason)
    failed = reason != 0
    labels = {}
    if "cycles" in features:
        sound = {name: features[name] & ~refused for name in ("finite", "check_finite") if name in features}
        check = {name: (features | sound)[f"check_{name}"] for name in LABELLED_BY if f"check_{name}" in features}
        labels["regime"] = regimes(scene, values, features | sound)
        labels["check_regime"] = regimes(scene, values, check)
    if "orbit_reason" in features:
        features = features | {
            "orbit_reason": np.where(failed, ORBIT_REASONS.index("refused"), features["orbit_reason"]),
            "stable": np.where(failed, -1, features["stable"]),
        }
    if failed.any():
        kept = {"finite", "finished", "steps", "orbit_reason", "stable"}
        features = {
            name: x if name in kept else np.where(failed.reshape(-1, *[1] * (x.ndim - 1)), np.nan, x)
            for name, x in features.items()
        }
    features = features | derived(scene, features, inputs.hole_radius)
    flags = [STATUSES.index(name) for name in ("refused", "failed")]
    status = np.select([refused, failed], flags, STATUSES.index("done"))
    return features | labels | {"status": status, "reason": reason}


def _reasons_of_starts(inputs: LaneInputs) -> Int8[np.ndarray, " lanes"]:
    """Return why lanes that do not stay finite cannot begin: flags of `reason`, *not-finite* without another reason."""
    reason = np.full(len(inputs), REASONS.index("not-finite"), np.int8)
    columns = inputs.states or tuple(np.zeros((len(inputs.scene.start_states), len(inputs))))
    if not inputs.row:  # a lane of a row begins elsewhere
        named = inputs.start < len(inputs.start_names)
        with precision("float64"):
            state = tuple(np.where(named, 0.0, column) for column in columns)
            faults = inputs.scene.start_faults(inputs.parameters, state)
            for name, _, mask in reversed(faults):  # the first one counts
                reason[np.broadcast_to(mask, reason.shape)] = REASONS.index(name)
    return reason


def regimes(
    scene: Scene[Any], values: Mapping[str, Shaped[np.ndarray, " lanes"]], features: Mapping[str, np.ndarray]
) -> Int8[np.ndarray, " lanes"]:
    """Return the regime of each lane of a scene.

    `values`: all parameters of the scene by name; `features`: those that determine the regime; each (lanes,).
    """
    lanes = len(features["cycles"])
    # With these values, lanes without friction are never at equilibrium.
    rest, m1, g, k1 = np.zeros((4, lanes)) + [[0.0], [0.0], [0.0], [1.0]]
    if isinstance(scene, HasFriction):
        with precision("float64"):
            rest = np.asarray(_friction_at_rest(scene, dict(values)))
        m1, g, k1 = (values[name] for name in ("m1", "g", "k1"))
    return label(features, rest, m1, g, k1)


@lane_function(static=1)
def _friction_at_rest(scene: HasFriction[Any], values: dict[str, Array]) -> Array:
    """Return the friction coefficient at rest mu(0+), an array (lanes,)."""
    return scene.friction.on_weight(0.0, values) + jnp.zeros_like(values["m1"])


FLIGHT_MAX_STEPS = 1e7
"""Limit on the length of a run in units of the shortest time scale of the flight. It is several times the number of
steps after which a lane is abandoned."""

RESOLVED_ROUNDINGS = 512
"""Smallest relative change that is resolved, in units of machine epsilon."""

LanesBool = Bool[np.ndarray, "*lanes"]
Parameters = Mapping[str, Any]


def too_stiff_or_slow(scene: Scene[Any], run: RunSettings, p: Parameters) -> tuple[LanesBool, LanesBool]:
    """Return two masks of lanes; `p`: parameters by name, each (lanes,).

    The first mask holds the lanes that are `unresolved` or whose flight takes too many steps. The second mask holds the
    lanes whose drive is so slow that it cannot be distinguished from rest. Its speed is then below a multiple of the
    rounding error of a typical speed, to which friction and main spring contribute.
    """
    if not isinstance(scene, HasFriction) or not run.stepper.rests:
        none = np.zeros(_shape(p), bool)
        return none, none
    rates = fastest_rates(scene, p)
    with np.errstate(all="ignore"):
        known = np.isfinite(rates.flight + rates.contact)
        many = ~(rates.flight * (run.settle + run.observe) < FLIGHT_MAX_STEPS)
        slow = (p["v"] > 0) & (p["v"] < RESOLVED_ROUNDINGS * np.finfo(run.precision).eps * rates.speed)
    return known & (unresolved(scene, p, run.precision) | many), slow


def unresolved(scene: HasFriction[Any], p: Parameters, numbers: str) -> LanesBool:
    """Return a mask of the lanes in which a step changes nothing in the precision `numbers` ("float64" or "float32").

    During a step of length 1/rate, the bit's motion on its main spring is less than the rounding error.
    """
    rates = fastest_rates(scene, p)
    with np.errstate(all="ignore"):
        return np.asarray(~(RESOLVED_ROUNDINGS * np.finfo(numbers).eps * (rates.flight + rates.contact) < rates.spring))


class FastestRates(NamedTuple):
    """Bounds on the fastest rates [1/s], and a typical `speed` [m/s].

    `flight` determines the step size; `contact` is added in contact; `spring` is that of the bit on its main spring.
    """

    flight: Any
    contact: Any
    spring: Any
    speed: Any


def fastest_rates(scene: HasFriction[Any], p: Parameters) -> FastestRates:
    """Return the fastest rates of lanes."""
    with precision("float64"):
        lanes = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, np.float64)) for x in p.values()))
        rates = _compiled_rates(scene, dict(zip(p, lanes, strict=True)))
        return FastestRates(*(np.asarray(x).reshape(_shape(p)) for x in rates))


def _shape(p: Parameters) -> tuple[int, ...]:
    return np.broadcast_shapes(*(np.shape(x) for x in p.values()))


@lane_function(static=1)
def _compiled_rates(scene: HasFriction[Any], p: Parameters) -> FastestRates:
    c = scene.constants(p)
    flight = scene.flight_rate(c)
    contact = scene.contact_rate(c) if isinstance(scene, HasContact) else jnp.zeros_like(flight)
    return FastestRates(*jnp.broadcast_arrays(flight, contact, scene.spring_rate(c), scene.typical_speed(c)))
