"""The periodic orbits of a sweep's lanes: `orbits`, from a sweep or from the dataset of one."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike

import xarray as xr

from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import InputError
from vibrojax.io.attributes import table_of, title_of
from vibrojax.io.finished import IDENTITY, identity_text
from vibrojax.io.manifest import changes
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.points import VECTOR
from vibrojax.sweep.input.read import read_sweep

RERUN_MAX_SECONDS = 10_000.0
"""Simulated seconds per lane above which the sweep of a dataset is not run again: a dataset may come from anywhere."""

RERUN_MAX_TOTAL_SECONDS = 1e8
"""Simulated seconds of all lanes above which it is not, unless the dataset itself holds a value for each lane."""


def orbits(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep, progress: bool = True
) -> xr.Dataset:
    """Find the periodic orbits of a sweep's lanes, their multipliers and their stability.

        orb = vj.orbits(ds)

    An orbit is a fixed point of the return map, from one return to the section to the next, or of its `cycles`-th
    iterate. Newton's method finds it from a lane's last returns. The map's derivative includes all events, so
    multipliers are those of the exact motion. An orbit whose multipliers all have moduli below 1 is stable.

    In penetration a return is the beginning of a pulse. A lane repeats if the map, iterated from its last pulse, comes
    back after 1 to 8 pulses.

    **Arguments:**

    - `source`: the dataset of a sweep, or a sweep as `run_sweep` takes it. A dataset lacks the states with which
      Newton's method begins, so its sweep is run again; a dataset with orbits is returned unchanged.
    - `progress`: whether to report progress on stderr.

    **Returns:** the sweep's dataset, with these variables over its dimensions. For a lane with a found orbit, `period`
    and the other measures are the orbit's.

    - `multiplier_abs` [1], `multiplier_arg` [rad] along `multiplier`, by falling modulus: eigenvalues of the map's
      derivative over the whole repeat; and `stable`: 1, 0, or -1 without multipliers.
    - `orbit_reason`: *found*, or why there is no orbit. The lane is *not-repeating* or was *refused*, or Newton's
      method is *not-converged*. Near a graze (*near-grazing*) multipliers have no meaning. *another-orbit* is too far
      from the lane, has other impacts, is unstable, or is not confirmed by a simulation. The `error_estimate` of a lane
      near an unstable orbit is infinite. An unstable orbit is *found* only if the lane stays on it although one
      rounding would drive it away, as an exact symmetry makes it.
    - `orbit_residual`: the largest difference of return and state, over the scales of labels; `grazing_margin`: the
      distance from a change in the order of events (defined in the attribute `orbits`).
    - `orbit_cycles`: returns after which the orbit repeats. It is less than the lane's `cycles` if the lane is still
      settling on a shorter repeat than it shows. Multipliers are those over `cycles` returns.
    - `nearby_cycles`: returns of a stable orbit near an irregular or undecided lane, which it has not reached; 0 if
      none was found; not in penetration. `nearby_impacts`: impacts in its repeat; `nearby_distance`: the largest
      distance of the last returns from it, over half the swings.

    **Raises:** `InputError` if the source is not a sweep or the dataset of one, if the sweep cannot be run, or if the
    scene has neither a section nor pulses.

    **Example:**

    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005}
    >>> orb = vj.orbits({"scene": "vibro-impact", "parameters": point, "starts": ["stuck"]}, progress=False)
    >>> int(orb.stable.item()), orb.multiplier_abs.values.ravel().round(3).tolist()  # the bit sticks: one is 0
    (1, [0.697, 0.697, 0.0])
    """
    if isinstance(source, xr.Dataset) and "orbit_reason" in source:
        return source
    return run_sweep(sweep_with_orbits(source), progress=progress)


def sweep_with_orbits(source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep) -> Sweep:
    """Return the sweep, or that of a dataset, with `orbits = true`; raise `InputError` if there is none."""
    if isinstance(source, xr.Dataset):
        return sweep_of_dataset(source)
    if isinstance(source, Sweep):
        return replace(source, run=replace(source.run, orbits=True))
    return read_sweep(source, ["run.orbits=true"])


def sweep_of_dataset(dataset: xr.Dataset, orbits: bool = True) -> Sweep:
    """Return the sweep of a dataset, from its attribute, and from its coordinates if it is over points.

    **Arguments:** `orbits`: whether to set `orbits = true`.

    **Raises:** `InputError` if there is no sweep, if its file has changed since, or if it costs too much to run again.
    """
    try:
        tables = tomllib.loads(str(dataset.attrs["sweep"]))
    except (KeyError, ValueError, RecursionError):
        raise InputError(
            "orbits: not the dataset of a sweep (it has no attribute sweep); give one, or a sweep"
        ) from None
    if "points" in tables:
        columns = {str(name): x.values.tolist() for name, x in dataset.coords.items() if x.dims == ("point",)}
        vectors = any(name.startswith(VECTOR) for name in columns)
        tables["points"] = {n: x for n, x in columns.items() if n != "point" and not (vectors and n == "start")}
    sweep = read_sweep(tables, ["run.orbits=true"] if orbits else ())
    before = dict(table_of(dataset, IDENTITY))
    for name in ("attractors", "borders"):  # not of the sweep, but of what was derived from it
        before.pop(name, None)
    expected = {**before, "run.orbits": True} if orbits else before
    differing = changes(expected, json.loads(identity_text(sweep.identity())))
    if before and differing:
        raise InputError(
            f"orbits: the sweep that the dataset names is another one now: {differing}; give the sweep itself"
        )
    seconds, lanes = sweep.run.settle + sweep.run.observe, 1 if has_lanes_of(dataset, sweep) else sweep.lanes
    if seconds > RERUN_MAX_SECONDS or lanes * seconds > RERUN_MAX_TOTAL_SECONDS:
        raise InputError(
            f"orbits: the sweep that the dataset names has {sweep.lanes} lanes of {seconds:g} s, more than is run for "
            "a dataset; give the sweep itself"
        )
    return replace(sweep, title=sweep.title or title_of(dataset))


def has_lanes_of(dataset: xr.Dataset, sweep: Sweep) -> bool:
    """Return whether a dataset has a value for each lane of a sweep."""
    return all(dataset.sizes.get(name) == size for name, size in zip(sweep.dims, sweep.shape, strict=True))
