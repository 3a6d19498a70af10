"""The compiled program of a chunk of lanes: blocks of lanes, spread over the devices."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from vibrojax.measure.run import run_block

BLOCK = 64
"""Lanes that step together. Small enough for a step's arrays to stay in cache, and for few lanes to wait for others."""


def mesh(devices=None):
    """The devices that lanes are spread over, by default all there are."""
    devices = jax.devices() if devices is None else devices
    return jax.make_mesh((len(devices),), ("lanes",), axis_types=(AxisType.Auto,), devices=devices)


def lanes_per_round(devices: int) -> int:
    """The least number of lanes that keeps every device busy; chunks are multiples of it."""
    return BLOCK * devices


@partial(jax.jit, static_argnames=("scene", "method", "recorder", "starts", "mesh"))
def run_chunk(scene, method, recorder, starts, mesh, p, start, real, settings) -> dict:
    """Features of a chunk of lanes.

    **Arguments:**

    - `starts`: names or vectors (static); `start` says which one each lane takes, integers (lanes,).
    - `p`: parameters by name, each (lanes,); `real`: False for lanes that only fill up the chunk.
    - `settings`: see [vibrojax.measure.run.run_block][].

    **Returns:** features by name, (lanes,), or (rows, lanes) for returns that are kept.
    """

    def block(inputs):
        p, start, real = inputs
        constants = dict(scene.constants(p))
        state = _start(scene, constants, starts, start)
        return run_block(scene, method, recorder, constants, state, real, settings)

    def device(p, start, real):
        blocks = jax.tree.map(lambda x: x.reshape(-1, BLOCK), (p, start, real))
        features = jax.lax.map(block, blocks)
        return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1), features)

    lanes, rows = PartitionSpec("lanes"), PartitionSpec(None, "lanes")
    names = jax.eval_shape(device, p, start, real)
    specs = {name: rows if len(shape.shape) == 2 else lanes for name, shape in names.items()}
    spread = jax.shard_map(device, mesh=mesh, in_specs=lanes, out_specs=specs, check_vma=False)
    return spread(p, start, real)


def _start(scene, p, starts, start):
    """The state at t = 0 of each lane, from the start that it takes; the scene's own where it has no starts."""
    candidates = [scene.start(p, name, start.shape) for name in starts or (None,)]
    state = candidates[0]
    for index, other in enumerate(candidates[1:], start=1):
        state = tuple(jnp.where(start == index, new, old) for new, old in zip(other, state, strict=True))
    return state


def place(mesh, arrays, dtype):
    """Numpy arrays (lanes,) on the devices, floats as `dtype`."""
    sharding = NamedSharding(mesh, PartitionSpec("lanes"))

    def put(x):
        x = np.asarray(x)
        return jax.device_put(x.astype(dtype) if x.dtype.kind == "f" else x, sharding)

    return jax.tree.map(put, arrays)
