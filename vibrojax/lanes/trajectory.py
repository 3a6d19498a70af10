"""The dataset of a trajectory: sampled states and forces of one lane, and its events."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.io.variables import Variable
from vibrojax.lanes.compiler import lane_function
from vibrojax.lanes.dense_output import Record, accumulated
from vibrojax.measures.section import lowest
from vibrojax.physics.arrays import Array
from vibrojax.scenes import Driven, HasContact, HasFriction, HasImpacts, HasRock, Scene
from vibrojax.scenes.declared import Values

KINDS = ("none", "stick", "slip", "impact", "release", "section", "switch", "slide")
"""Meanings of the CF flag values of `event_kind`."""

FORCES = {
    "friction_force": "friction force of the rock on the bit, against its sliding",
    "impact_force": "contact force between striker and bit",
    "applied_force": "given force on the bit",
    "rock_force": "resistance of the rock under the bit",
}
"""Meanings of the sampled forces [N], by variable name."""


OBSERVED_SHARE = 1 / 6
"""Observed part of a motion, as a fraction of its duration: that of a sweep's defaults."""


def window(scene: Scene[Any], duration: float) -> tuple[float, float]:
    """Return the beginning and the length of the observation of a motion with this `duration` [s].

    The observation has at least the scene's usual length, or half of a short motion.
    """
    observe = max(OBSERVED_SHARE * duration, min(scene.usual_times[1], duration / 2))
    return duration - observe, observe


class SampledMotion(NamedTuple):
    """Sampled states and modes at `times` [s]."""

    times: Float[np.ndarray, " samples"]
    states: Float[Array, "states samples"]
    modes: Float[Array, "modes samples"]


Events = tuple[Float[np.ndarray, " events"], Int[np.ndarray, " events"]]
"""Events in the order of time: times [s], and kinds as indices into `KINDS`."""


def events(scene: Scene[Any], c: Any, record: Record) -> Events:
    """Return the events in the `record` of one lane. `c`: constants of the scene."""
    masks: dict[str, Bool[Array, " steps"]] = {}
    hits = dict(zip(scene.event_names, record.hits.T, strict=True))
    after = np.concatenate([record.mode[1:], record.mode[-1:]])
    masks |= scene.events_of(tuple(record.mode.T), tuple(after.T), hits)
    if isinstance(scene, HasFriction):
        place = scene.mode_place("slip")
        slip, next_slip = record.mode[:, place], after[:, place]
        masks["stick"] = hits["friction"] & (slip != 0) & (next_slip == 0)
        masks["slip"] = hits["friction"] & (next_slip != 0)
    if isinstance(scene, HasImpacts):
        modes, states = tuple(record.mode.T), tuple(record.after.T)
        masks["impact"] = np.asarray(impact_begins(scene, scalars(c), modes, states, hits))
    if isinstance(scene, HasContact):
        masks["release"] = hits["contact"] & (record.mode[:, scene.mode_place("touching")] != 0)
    if scene.section is not None:
        masks["section"] = _returns(scene, c, record)
    if not masks:
        return np.zeros(0), np.zeros(0, np.int8)
    time = record.start + record.dt
    kinds = np.concatenate([np.full(mask.sum(), KINDS.index(name)) for name, mask in masks.items()])
    times = np.concatenate([time[mask] for mask in masks.values()])
    order = np.argsort(times, kind="stable")
    return times[order], kinds[order].astype(np.int8)


def _returns(scene: Scene[Any], c: Any, record: Record) -> Bool[np.ndarray, " steps"]:
    """Return a mask of the steps that end in a section crossing.

    A crossing counts only if the velocity has passed the re-arming level since the previous crossing.
    """
    section = scene.section
    assert section is not None
    sign, marker = 1.0 if section.rising else -1.0, scene.marker_of(section.velocity)
    falling = record.falling[:, scene.marker_names.index(marker)]
    returns = record.hits[:, scene.event_names.index(marker)] & (~falling if section.rising else falling)
    armed, passed = False, np.zeros(len(returns), bool)
    # A step that only switches the mode has length zero, and its velocity does not change.
    tau = np.where(record.dt > 0, record.dt / np.where(record.h > 0, record.h, 1), 0)
    velocity = [sign * coefficient for coefficient in record.polynomials[:, scene.place(section.velocity)].T]
    low = np.asarray(lowest_velocity(velocity, tau)) < sign * float(np.ravel(section.rearm(c))[0])
    for index in np.flatnonzero(returns | low):
        armed = armed or bool(low[index])
        passed[index] = returns[index] and armed
        armed = armed and not passed[index]
    return passed


def forces(scene: Scene[Any], c: Any, motion: SampledMotion, width: float | None) -> dict[str, xr.Variable]:
    """Return the sampled forces [N] by name; `width`: that of the smoothed friction switch [m/s], None if it is sharp.

    Friction is the force of the springs on the bit minus the bit's mass times acceleration.
    """
    values = _forces(scene, width is None, scalars(c), tuple(motion.modes), tuple(motion.states), width or 0.0)
    return {name: along_time(np.asarray(force) + 0.0, "N", FORCES[name]) for name, force in values.items()}  # no -0.0


@lane_function(static=2)
def _forces(scene: Scene[Any], is_sharp: bool, c: Any, modes: Values, states: Values, width: Any) -> dict[str, Array]:
    values: dict[str, Any] = {}
    if isinstance(scene, HasFriction):
        rates = scene.field(c, modes, states) if is_sharp else scene.smoothed_field(c, modes, states, width)
        values["friction_force"] = scene.pull(c, states) - scene.bit(c).mass * rates[scene.place(scene.bit_velocity)]
    if isinstance(scene, HasContact):
        values["impact_force"] = scene.contact_force(c, modes, states)
    if isinstance(scene, Driven):
        values["applied_force"] = scene.applied_force(c, modes, states)
    if isinstance(scene, HasRock):
        values["rock_force"] = scene.rock_force(c, modes, states)
    return {name: force + jnp.zeros_like(states[0]) for name, force in values.items()}


@lane_function(static=1)
def impact_begins(scene: HasImpacts[Any], c: Any, modes: Values, states: Values, hits: dict[str, Array]) -> Array:
    """Return a mask of steps (`modes`, end `states`, guards `hits`) that end as an impact begins."""
    return scene.impact_begins(c, modes, states, hits)


@lane_function(static=0)
def lowest_velocity(velocity: list[Array], tau: Array) -> Array:
    """Return the minimum of each step's polynomial between 0 and `tau`."""
    return lowest(velocity, tau)


def scalars(c: Any) -> Any:
    """Return the constants of one lane as scalars, which apply to all samples."""
    return jax.tree.map(lambda x: np.asarray(x).reshape(()), c)


def states_shown(
    scene: Scene[Any], motion: SampledMotion, record: Record | None, step_of: Int[Array, " samples"] | None
) -> dict[str, xr.Variable]:
    """Return the sampled states by name; with rock, x3 (bit) and x4 (hole) instead of `compression` and `growth`.

    `growth` is reset to zero at each impact or pulse. x4 is its sum since the start, and x3 is x4 plus `compression`.
    `record` holds all steps and `step_of` the step of each sample; without them, x3 and x4 are left out.
    """
    variables: dict[str, xr.Variable] = {}
    x3 = x4 = None
    if isinstance(scene, HasRock) and record is not None and step_of is not None:
        growth = scene.place("growth")
        x4 = motion.states[growth] + accumulated(record, growth)[step_of]
        x3 = x4 + motion.states[scene.place("compression")]
    for state, values in zip(scene.states, motion.states, strict=True):
        if state.shown:
            variables[state.name] = along_time(values + state.offset, state.unit, state.long_name)
        elif state.name == "compression" and x3 is not None:
            variables["x3"] = along_time(x3, "m", "normal position of the bit")
        elif state.name == "growth" and x4 is not None:
            variables["x4"] = along_time(x4, "m", "depth of the hole")
    return variables


def along_time(values: Any, unit: str, long_name: str, flags: tuple[str, ...] = ()) -> xr.Variable:
    """Return values at the sampled times as a variable of a trajectory's dataset."""
    return xr.Variable("time", np.asarray(values), Variable(unit, long_name, flags=flags).attributes())
