"""From the samples of one lane to the labelled trajectory: states, forces, and what happened when."""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.io.provenance import provenance
from vibrojax.measures.section import lowest
from vibrojax.models.arrays import Array
from vibrojax.models.physics.parameters import differing
from vibrojax.models.scenes import Driven, HasContact, HasFriction, HasRock, Scene
from vibrojax.models.scenes.declared import Values
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.input.point import Point
from vibrojax.sweep.simulation.dense_output import Record, accumulated

KINDS = ("none", "stick", "slip", "impact", "release", "section")
"""Meaning of the flags of `event_kind`."""

Samples = Float[Array, " samples"]


class Variable(NamedTuple):
    """Values along time [unit], and what they are."""

    values: Any
    unit: str
    long_name: str


FORCES = {
    "friction_force": "friction force of the rock on the bit, against its sliding",
    "impact_force": "contact force between striker and bit",
    "applied_force": "given force on the bit",
    "rock_force": "resistance of the rock under the bit",
}
"""Forces [N] at the samples, by the names of their variables."""


class Motion(NamedTuple):
    """A sampled motion: `times` [s], and states and modes at them."""

    times: Float[np.ndarray, " samples"]
    states: Float[Array, "states samples"]
    modes: Float[Array, "modes samples"]


class Events(NamedTuple):
    """Times [s] and kinds, indices into `KINDS`, of what happened, in order."""

    times: Float[np.ndarray, " events"]
    kinds: Int[np.ndarray, " events"]


def events(scene: Scene[Any], c: Any, record: Record) -> Events:
    """What happened in the `record` of one lane; `c`: the scene's constants."""
    masks: dict[str, Bool[Array, " steps"]] = {}
    hits = dict(zip(scene.event_names, record.hits.T, strict=True))
    if isinstance(scene, HasFriction):
        slip = record.mode[:, scene.mode_place("slip")]
        after = np.append(slip[1:], slip[-1:])
        masks["stick"] = hits["friction"] & (slip != 0) & (after == 0)
        masks["slip"] = hits["friction"] & (after != 0)
    if isinstance(scene, HasContact):
        modes, states = tuple(record.mode.T), tuple(record.after.T)
        masks["impact"] = np.asarray(impact_begins(scene, one_for_all(c), modes, states, hits))
        masks["release"] = hits["contact"] & (record.mode[:, scene.mode_place("touching")] != 0)
    if scene.section is not None:
        masks["section"] = _returns(scene, c, record)
    if not masks:
        return Events(np.zeros(0), np.zeros(0, np.int8))
    time = record.start + record.dt
    kinds = np.concatenate([np.full(mask.sum(), KINDS.index(name)) for name, mask in masks.items()])
    times = np.concatenate([time[mask] for mask in masks.values()])
    order = np.argsort(times, kind="stable")
    return Events(times[order], kinds[order].astype(np.int8))


def _returns(scene: Scene[Any], c: Any, record: Record) -> Bool[np.ndarray, " steps"]:
    """Steps that end on the section, having been beyond the re-arming level since the last one."""
    section = scene.section
    assert section is not None
    sign, marker = 1.0 if section.rising else -1.0, scene.marker_of(section.velocity)
    falling = record.falling[:, scene.marker_names.index(marker)]
    returns = record.hits[:, scene.event_names.index(marker)] & (~falling if section.rising else falling)
    armed, passed = False, np.zeros(len(returns), bool)
    # A step taken for a mere switch has no length, and nothing falls in it.
    tau = np.where(record.dt > 0, record.dt / np.where(record.h > 0, record.h, 1), 0)
    velocity = [sign * one for one in record.polynomials[:, scene.place(section.velocity)].T]
    level = sign * float(np.ravel(section.rearm(c))[0])
    low = np.asarray(lowest_velocity(velocity, tau)) < level
    for index in np.flatnonzero(returns | low):
        armed = armed or bool(low[index])
        passed[index] = returns[index] and armed
        armed = armed and not passed[index]
    return passed


def forces(scene: Scene[Any], c: Any, motion: Motion, width: float | None) -> dict[str, Variable]:
    """Forces [N] at the samples, by name; friction is what the springs do not give to the bit (Newton).

    `width` [m/s] is that of a smoothed motion, None of a sharp one.
    """
    found = _forces(scene, width is None, one_for_all(c), tuple(motion.modes), tuple(motion.states), width or 0.0)
    return {name: Variable(np.asarray(force) + 0.0, "N", FORCES[name]) for name, force in found.items()}  # no -0.0


@lane_function(static=2)
def _forces(scene: Scene[Any], is_sharp: bool, c: Any, modes: Values, states: Values, width: Any) -> dict[str, Array]:
    found: dict[str, Any] = {}
    if isinstance(scene, HasFriction):
        rates = scene.field(c, modes, states) if is_sharp else scene.smoothed_field(c, modes, states, width)
        found["friction_force"] = scene.pull(c, states) - scene.bit(c).mass * rates[scene.place(scene.bit_velocity)]
    if isinstance(scene, HasContact):
        found["impact_force"] = scene.contact_force(c, modes, states)
    if isinstance(scene, Driven):
        found["applied_force"] = scene.applied_force(c, modes, states)
    if isinstance(scene, HasRock):
        found["rock_force"] = scene.rock_force(c, modes, states)
    return {name: force + jnp.zeros_like(states[0]) for name, force in found.items()}


@lane_function(static=1)
def impact_begins(scene: HasContact, c: Any, modes: Values, states: Values, hits: dict[str, Array]) -> Array:
    """Whether steps that end in `states` on what they hit end on the beginning of an impact."""
    return scene.impact_begins(c, modes, states, hits)


@lane_function(static=0)
def lowest_velocity(velocity: list[Array], tau: Array) -> Array:
    """The least value of steps' polynomials from 0 to `tau`."""
    return lowest(velocity, tau)


def one_for_all(c: Any) -> Any:
    """The constants of one lane, of shape (1,) or none, for all samples."""
    return jax.tree.map(lambda x: np.asarray(x).reshape(()), c)


def states_shown(
    scene: Scene[Any], motion: Motion, record: Record | None, step_of: Int[Array, " samples"] | None
) -> dict[str, Variable]:
    """The states at the samples, by name; where there is rock, x3 and x4 for compression and growth: those of all blows
    together, by the `record` and the step of it that each sample is of."""
    shown: dict[str, Variable] = {}
    x3 = x4 = None
    if isinstance(scene, HasRock) and record is not None and step_of is not None:
        growth = scene.place("growth")
        x4 = motion.states[growth] + accumulated(record, growth)[step_of]
        x3 = x4 + motion.states[scene.place("compression")]
    for state, values in zip(scene.states, motion.states, strict=True):
        if state.shown:
            shown[state.name] = Variable(values, state.unit, state.long_name)
        elif state.name == "compression" and x3 is not None:
            shown["x3"] = Variable(x3, "m", "normal position of the bit")
        elif state.name == "growth" and x4 is not None:
            shown["x4"] = Variable(x4, "m", "depth of the hole")
    return shown


def trajectory_dataset(
    point: Point,
    scene: Scene[Any],
    motion: Motion,
    along_time: Mapping[str, Variable],
    happened: Events | None,
    solver: Mapping[str, object],
) -> xr.Dataset:
    """The dataset of a trajectory: variables along time, and what `happened` along events."""
    variables: dict[str, tuple[str, Any, dict[str, Any]]] = {
        name: ("time", one.values, {"units": one.unit, "long_name": one.long_name}) for name, one in along_time.items()
    }
    if isinstance(scene, HasFriction):
        stuck = (motion.modes[scene.mode_place("slip")] == 0).astype(np.int8)
        about = {"units": "1", "long_name": "whether the bit sticks to the rock"}
        variables["stuck"] = (
            "time",
            stuck,
            about | {"flag_values": np.array([0, 1], np.int8), "flag_meanings": "slides sticks"},
        )
    if happened is not None:
        flags = {"flag_values": np.arange(len(KINDS), dtype=np.int8), "flag_meanings": " ".join(KINDS)}
        about = {"units": "s", "long_name": "time of the event"}
        variables["event_time"] = ("event", happened.times, about)
        variables["event_kind"] = ("event", happened.kinds, {"units": "1", "long_name": "what happened", **flags})
    start = {} if point.start is None else {"start": _written(point.start)}
    attributes = {
        "title": f"{point.scene}: trajectory",
        "scene": point.scene,
        **provenance(),
        "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} simulate {point.scene}",
        "parameters": json.dumps(point.parameters),
        "differing": json.dumps(differing(point.system.parameters(), point.parameters)),
        **point.options,
        **start,
        "solver": json.dumps(solver),
        "Conventions": "CF-1.11",
    }
    times = {"time": ("time", motion.times, {"units": "s", "long_name": "time"})}
    return xr.Dataset(variables, times, attributes)


def _written(start: str | tuple[float, ...]) -> str:
    return start if isinstance(start, str) else json.dumps(list(start))
