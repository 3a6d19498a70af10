"""From the samples of one lane to the labelled trajectory."""

import json
from collections.abc import Mapping
from datetime import UTC, datetime

import jax.numpy as jnp
import numpy as np
import xarray as xr

from vibrojax.scenes import _rock
from vibrojax.simulation._events import KINDS
from vibrojax.simulation._record import Record, accumulated
from vibrojax.store.provenance import source

ABOUT = {
    "x1": ("m", "position of the bit relative to the drive"),
    "v1": ("m s-1", "velocity of the bit relative to the drive"),
    "x2": ("m", "position of the striker relative to the drive"),
    "v2": ("m s-1", "velocity of the striker relative to the drive"),
    "x3": ("m", "normal position of the bit"),
    "v3": ("m s-1", "normal velocity of the bit"),
    "x4": ("m", "depth of the hole"),
    "friction_force": ("N", "friction force of the rock on the bit, against its sliding"),
    "impact_force": ("N", "contact force between striker and bit"),
    "applied_force": ("N", "given force on the bit"),
    "rock_force": ("N", "resistance of the rock under the bit"),
}


def forces(machine, p, states, modes, width) -> dict:
    """Forces [N] at the samples, by name; friction is what the springs do not give to the bit (Newton).

    `width` [m/s] is that of a smoothed motion, None of a sharp one.
    """
    states, modes = tuple(jnp.asarray(y) for y in states), tuple(jnp.asarray(m) for m in modes)
    found = {}
    if "x1" in machine.states:
        rates = machine.field(p, modes, states) if width is None else machine.smoothed_field(p, modes, states, width)
        found["friction_force"] = machine.pull(p, states) - p["m1"] * rates[1]
    if hasattr(machine, "contact_force"):
        found["impact_force"] = machine.contact_force(p, modes, states)
    if hasattr(machine, "applied_force"):
        found["applied_force"] = machine.applied_force(p, modes, states)
    if "rock" in machine.modes:
        rock, compression = modes[machine.modes.index("rock")], states[machine.states.index("compression")]
        found["rock_force"] = _rock.resistance(p, rock, compression)
    return {name: np.asarray(force) + 0.0 for name, force in found.items()}  # no -0.0


def holes(machine, p, record: Record, states, modes, step_of) -> dict:
    """x3 and x4 [m] at the samples, where there is rock: the growths of all blows together."""
    if "growth" not in machine.states:
        return {}
    growth, compression = machine.states.index("growth"), machine.states.index("compression")
    x4 = states[growth] + accumulated(record, growth)[step_of]
    return {"x3": x4 + states[compression], "x4": x4}


def trajectory_dataset(point, times, states, modes, found: dict, happened: dict, solver: Mapping) -> xr.Dataset:
    """The dataset of a trajectory: states, what was `found` of them along time, and what `happened` along events."""
    machine = point.machine
    values = dict(zip(machine.states, states, strict=True)) | found
    variables = {
        name: ("time", values[name], {"units": unit, "long_name": text})
        for name, (unit, text) in ABOUT.items()
        if name in values
    }
    if "slip" in machine.modes:
        stuck = (modes[machine.modes.index("slip")] == 0).astype(np.int8)
        about = {"units": "1", "long_name": "whether the bit sticks to the rock"}
        flags = {"flag_values": np.array([0, 1], np.int8), "flag_meanings": "slides sticks"}
        variables["stuck"] = ("time", stuck, about | flags)
    if happened:
        flags = {"flag_values": np.arange(len(KINDS), dtype=np.int8), "flag_meanings": " ".join(KINDS)}
        about = {"units": "s", "long_name": "time of the event"}
        variables["event_time"] = ("event", happened["event_time"], about)
        about = {"units": "1", "long_name": "what happened", **flags}
        variables["event_kind"] = ("event", happened["event_kind"], about)
    start = {} if point.start is None else {"start": _written(point.start)}
    attributes = {
        "title": f"{point.scene}: trajectory",
        "scene": point.scene,
        "source": source(),
        "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} simulate {point.scene}",
        "parameters": json.dumps(point.parameters),
        **point.options,
        **start,
        "solver": json.dumps(solver),
        "Conventions": "CF-1.11",
    }
    return xr.Dataset(variables, {"time": ("time", times, {"units": "s", "long_name": "time"})}, attributes)


def _written(start) -> str:
    return start if isinstance(start, str) else json.dumps(list(start))
