"""From the features of lanes to the labelled variables of a sweep, any whole points of it at a time."""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int8, Shaped

from vibrojax.compile.devices import precision
from vibrojax.io.finished import IDENTITY, identity_text
from vibrojax.io.provenance import provenance
from vibrojax.io.variables import ORBIT_REASONS, REASONS, STATUSES, VARIABLES, Variable, orbit_name
from vibrojax.measures import gauge_named
from vibrojax.measures.labels import LABELLED_BY, hides_another, label
from vibrojax.models.arrays import Array
from vibrojax.models.physics.parameters import ROTATION, Parameter, differing
from vibrojax.models.scenes import HasFriction, Scene
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.engine.validity import TOO_SLOW, TOO_STIFF, too_slow, too_stiff
from vibrojax.sweep.input.definition import DIRECTIONS, Sweep
from vibrojax.sweep.input.points import VECTOR
from vibrojax.sweep.input.starts import Starts

_ROWS = {
    "return_index": "number of the return that is kept, the newest last",
    "multiplier": "number of the multiplier, by falling modulus",
}
"""What the dimensions beyond the sweep's mean."""


def labelled(sweep: Sweep, first: int, end: int, features: dict, whole: bool = True) -> dict[str, np.ndarray]:
    """The variables of the lanes from `first` to before `end`, as stored.

    **Arguments:**

    - `features`: by name, (lanes,), or (lanes, rows) for returns that are kept.
    - `whole`: whether all starts of their points are among them; `hidden_motion`, which compares these, is left out
      where not.

    **Returns:** by name, in the order of the dataset, in the same shapes.
    """
    features = _finished(sweep, first, end, features)
    if whole and sweep.crosses_starts and sweep.starts is not None and len(sweep.starts) > 1 and "regime" in features:
        features["hidden_motion"] = hides_another(features, features["regime"], len(sweep.starts))
    variables = {}
    for name, variable in variables_of(sweep).items():
        if name in features:
            x = features[name]
            integer = np.issubdtype(variable.dtype, np.integer)
            variables[name] = np.nan_to_num(x).astype(variable.dtype) if integer else x
    return variables


def variables_of(sweep: Sweep) -> dict[str, Variable]:
    """All variables that the dataset of a sweep may have, by name, in their order."""
    return VARIABLES | measured_besides(sweep.system) | of_orbits(sweep.system)


def attributes(sweep: Sweep, solver: dict, certified: Mapping[str, int], wall_time: float) -> dict[str, Any]:
    """The attributes of the dataset.

    **Arguments:**

    - `solver`: what the lanes were stepped with, as JSON values.
    - `certified`: what [vibrojax.sweep.engine.labelled.certified][] counts, of all lanes.
    - `wall_time`: seconds that it took.
    """
    return {
        "title": sweep.title or f"{sweep.scene}: {sweep.name}",
        "scene": sweep.scene,
        **provenance(),
        "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} sweep {sweep.name}",
        "sweep": sweep.text,
        "run": json.dumps(_settings(sweep)),
        "parameters": json.dumps(sweep.parameters),
        IDENTITY: identity_text(sweep.identity()),
        "differing": json.dumps(differing(sweep.system.parameters(), sweep.parameters)),
        **sweep.options,
        "solver": json.dumps(solver),
        "certified": json.dumps({"error": sweep.run.error, "lanes": sweep.lanes, **certified}),
        "wall_time_s": float(wall_time),
        "lanes": sweep.lanes,
        "Conventions": "CF-1.11",
    }


def measured_besides(scene: Scene[Any]) -> dict[str, Variable]:
    """The variables that the scene's section and its own gauges declare."""
    if scene.section is None:
        return {}
    found = {}
    for swing in scene.section.swings:
        state = scene.states[scene.place(swing.position)]
        if swing.amplitude not in VARIABLES:
            found[swing.amplitude] = Variable(state.unit, f"half the swing of: {state.long_name}")
    gauges = map(gauge_named, scene.measures)
    return found | {name: Variable(*about) for gauge in gauges for name, about in gauge.variables.items()}


def of_orbits(scene: Scene[Any]) -> dict[str, Variable]:
    """The states of orbits at the section."""
    return {
        orbit_name(state.name): Variable(state.unit, f"{state.long_name}, on the orbit at the section")
        for state in scene.states
        if state.name in scene.driving_part().return_states
    }


def _finished(sweep: Sweep, first: int, end: int, features: dict) -> dict:
    """The features with the regime, status and reason; NaN, or 0 for counts, where a lane failed or was refused."""
    bad = ~features["finite"]
    values = sweep.lane_values(first, end)[0]
    why, unfit = sweep.system.refused(values) or ("none", np.zeros(end - first, bool))
    stiff, slow = too_stiff(sweep, values), too_slow(sweep, values)
    refused = unfit | stiff | slow
    flags = [REASONS.index(name) for name in (why, TOO_STIFF, TOO_SLOW, "not-finite", "out-of-steps")]
    reason = np.select([unfit, stiff, slow, bad, ~features["finished"]], flags, 0)
    failed = reason != 0
    sound = {name: features[name] & ~refused for name in ("finite", "check_finite") if name in features}
    regimes = _regimes(sweep, values, features | sound) if "cycles" in features else {}
    if "orbit_reason" in features:
        features = features | {
            "orbit_reason": np.where(failed, ORBIT_REASONS.index("refused"), features["orbit_reason"]),
            "stable": np.where(failed, -1, features["stable"]),
        }
    known = set(features) if not failed.any() else {"finite", "finished", "steps", "orbit_reason", "stable"}
    blanked = {
        name: x if name in known else np.where(failed.reshape(-1, *[1] * (x.ndim - 1)), np.nan, x)
        for name, x in features.items()
    }
    flags = [STATUSES.index(name) for name in ("refused", "failed")]
    status = np.select([refused, failed], flags, STATUSES.index("done"))
    return blanked | regimes | {"status": status, "reason": reason}


def _regimes(sweep: Sweep, values: dict, features: dict) -> dict:
    """The regime of every lane, and that by its check run."""
    check = {name: features[f"check_{name}"] for name in LABELLED_BY if f"check_{name}" in features}
    both = {"regime": features, "check_regime": check}
    return {name: regimes(sweep.system, values, lanes) for name, lanes in both.items()}


def regimes(
    scene: Scene[Any], values: Mapping[str, Shaped[np.ndarray, " lanes"]], features: Mapping[str, np.ndarray]
) -> Int8[np.ndarray, " lanes"]:
    """The regime of lanes of a scene, from all of its parameters and the features that decide it, each (lanes,)."""
    lanes = len(features["cycles"])
    rest, m1, g, k1 = np.zeros((4, lanes)) + [[0.0], [0.0], [0.0], [1.0]]  # what does not slide is never at rest
    if isinstance(scene, HasFriction):
        with precision("float64"):
            rest = np.asarray(_friction_at_rest(scene, dict(values)))
        m1, g, k1 = (values[name] for name in ("m1", "g", "k1"))
    return label(features, rest, m1, g, k1)


@lane_function(static=1)
def _friction_at_rest(scene: HasFriction[Any], values: dict[str, Array]) -> Array:
    """mu(0+) (lanes,)."""
    return scene.friction.on_weight(0.0, values) + jnp.zeros_like(values["m1"])


def _settings(sweep: Sweep) -> dict:
    """The table [run] with what the text leaves to defaults, since labels depend on the times; not the chunk."""
    return {name: value for name, value in sweep.run.described().items() if value is not None}


def certified(sweep: Sweep, variables: Mapping[str, np.ndarray]) -> dict[str, int]:
    """Count the lanes that have an error estimate, those within the accepted error, those that still settle, those
    that are sensitive, and those whose check run has another label. Sensitive lanes are not counted as within."""
    done = variables["reason"] == 0
    estimate = variables["error_estimate"][done]
    within = estimate <= sweep.run.error
    found = {"estimated": int(np.sum(~np.isnan(estimate))), "within": int(np.sum(within))}
    if "sensitive" in variables:
        sensitive = variables["sensitive"][done] == 1
        found |= {"within": int(np.sum(within & ~sensitive)), "sensitive": int(np.sum(sensitive))}
    if "drift_estimate" in variables:
        found["still_settling"] = int(np.sum(variables["drift_estimate"][done] > sweep.run.error))
    if "regime" in variables:
        found["regime_flips"] = int(np.sum(variables["regime"] != variables["check_regime"]))
    return found


def coordinates(sweep: Sweep, rows: Mapping[str, int]) -> dict:
    """The coordinates of the dataset, each (dimensions, values, attributes).

    `rows`: the sizes of the dimensions beyond the sweep's, by name.
    """
    parameters = dict(sweep.system.parameters()) | ROTATION
    found = {name: ((name,), axis, _described(parameters, name)) for name, axis in sweep.axes.items()}
    for name, column in (sweep.points or {}).items():
        found[name] = (("point",), column, _described(parameters, name))
    for name, column in (sweep.point_vectors or {}).items():
        state = sweep.system.states[sweep.system.place(name.removeprefix(VECTOR))]
        about = {"units": state.unit, "long_name": f"{state.long_name} at t = 0"}
        found[name] = (("point",), column, about)
    if sweep.points is not None or sweep.point_starts is not None:
        found["point"] = (("point",), np.arange(sweep.shape[0]), {"units": "1", "long_name": "number of the point"})
    about = {"units": "1", "long_name": "start of the motion"}
    if sweep.point_starts is not None:
        found["start"] = (("point",), np.array(sweep.point_starts), about)
    elif sweep.run.carry is not None:
        words = f"way along {sweep.run.carry} in which lanes run, each from where the last one ended"
        found["direction"] = (("direction",), np.array(DIRECTIONS), {"units": "1", "long_name": words})
    elif sweep.starts is not None:
        found["start"] = (("start",), _numbered(sweep.starts), about)
        found |= _start_states(sweep, sweep.starts)
    for dimension, size in rows.items():
        found[dimension] = ((dimension,), np.arange(size), {"units": "1", "long_name": _ROWS[dimension]})
    return found


def _numbered(starts: Starts) -> np.ndarray:
    """What starts are called: names, vectors as text, or their numbers where they were not written one by one."""
    if not starts.listed:
        return np.arange(len(starts))
    return np.array([start if isinstance(start, str) else json.dumps(list(start)) for start in starts])


def _start_states(sweep: Sweep, starts: Starts) -> dict:
    """The coordinates start_x1 and so on of starts among which are vectors; NaN for those that have names."""
    if not starts.has_vectors:
        return {}
    about = {
        state.name: {"units": state.unit, "long_name": f"{state.long_name}, at t = 0"} for state in sweep.system.states
    }
    columns = zip(starts.states, starts.vectors.T, strict=True)
    return {f"start_{name}": (("start",), column, about.get(name, {})) for name, column in columns}


def _described(parameters: dict[str, Parameter], name: str) -> dict:
    if name == "rock":
        return {"units": "1", "long_name": "rock of Table 4.5"}
    parameter = parameters[name]
    return {"units": parameter.unit, "long_name": parameter.long_name, "symbol": parameter.symbol}
