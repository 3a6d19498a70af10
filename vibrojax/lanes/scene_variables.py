"""The variables of a scene's sweeps, from its gauges by tracing, without a simulation."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp

from vibrojax.compile.xla import precision
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.lanes.labels import measured_besides, of_orbits, scales_of_orbits
from vibrojax.measures import recorder_for
from vibrojax.measures.derived import derived_names
from vibrojax.measures.recorder import Effort, run_block
from vibrojax.scenes import Scene
from vibrojax.stepping import AccuracyRequest, stepper_named

_OF_ALL = {"status", "reason", "error_estimate"}
_WITH_SECTION = {"regime", "check_regime", "drift_estimate", "sensitive", "hidden_motion"}
_WITH_ORBITS = {"multiplier_abs", "multiplier_arg", "stable", "orbit_residual", "grazing_margin", "orbit_cycles"}
_WITH_ORBITS |= {"orbit_reason"}
_WITH_ORBITS_AND_SECTION = {"nearby_cycles", "nearby_impacts", "nearby_distance"}


def sweep_variables(scene: Scene[Any]) -> dict[str, Variable]:
    """Return the variables that datasets of the scene's sweeps may have, by name."""
    orbit_states = of_orbits(scene) | scales_of_orbits(scene)
    held = {*_OF_ALL, *feature_names(scene), *derived_names(scene)}
    held |= {*_WITH_ORBITS, *orbit_states} if orbit_states else set()
    held |= _WITH_SECTION | _WITH_ORBITS_AND_SECTION if scene.section is not None else set()
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
