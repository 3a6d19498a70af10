"""The periodic orbits of a sweep's lanes: of a sweep, or of the dataset of one."""

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

LONGEST_RERUN = 10_000.0
"""Seconds of each lane of a sweep that a dataset names, above which it is not run."""

MOST_RERUN_SECONDS = 1e8
"""Simulated seconds of all its lanes together, if the dataset does not itself hold a value for each."""

_OF_WHAT_WAS_FOUND = ("attractors", "borders")
"""What a dataset's identity says beside the sweep's, where it is of what was found in it."""


def orbits(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep, progress: bool = True
) -> xr.Dataset:
    """The dataset of a sweep with the periodic orbits of its lanes, their multipliers and stability.

        orb = vj.orbits(ds)

    An orbit is a fixed point of the return map, from one return to the section to the next, or of its `cycles`-th
    iterate. It is found by Newton's method from a lane's last returns; the map's derivative goes through all events, so
    that multipliers are those of the exact motion. A lane whose multipliers all have moduli under 1 is stable.

    **Arguments:**

    - `source`: the dataset of a sweep, or a sweep as `run_sweep` takes it. A dataset does not hold the states that
      Newton's method begins with, so that its sweep is run again; one with orbits is returned as it is.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** the sweep's dataset, and over its dimensions

    - `multiplier_abs` [1], `multiplier_arg` [rad] along `multiplier`, by falling modulus: the eigenvalues of the map's
      derivative over the whole repeat; and `stable`: 1, 0, or -1 where there are none.
    - `orbit_reason`: *found*, or why there is none: the lane is *not-repeating* or was *refused*; Newton's method is
      *not-converged*; the orbit is *near-grazing*, so that multipliers would mean nothing; or it is *another-orbit*
      than the lane's own: too far from it, with other impacts, unstable, or not borne out by a simulation. The
      `error_estimate` of a lane near an unstable orbit is infinite. An unstable orbit counts as *found* only where the
      lane has stayed on it although one rounding would have driven it away (as an exact symmetry makes it).
    - `orbit_residual`: the greatest return - state, over the scales of labels; `grazing_margin`: how far the order of
      events is from changing (the attribute `orbits` says how).
    - `orbit_cycles`: returns after which the orbit repeats; fewer than the lane's `cycles` where a lane is still on its
      way to a shorter repeat than it shows. The multipliers are those over `cycles` returns.

    - `nearby_cycles`: returns of a stable orbit near a lane that is irregular or undecided, which it has not reached; 0
      where none was found, and not in penetration; `nearby_impacts` in its repeat, and `nearby_distance`: the greatest
      of the last returns from it, over half the swings.

    Of a lane with a found orbit, `period` and what is measured over the repeat are the orbit's.

    In penetration a return is the beginning of a pulse, and a lane repeats where the map itself, followed from its last
    pulse, comes back after 1 to 8 of them.

    **Raises:** `InputError` where it is no sweep's dataset, or the sweep cannot be run, or the scene has neither a
    section nor pulses.

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
    """The sweep, or that of a dataset, with `orbits = true`; raises `InputError` where there is none."""
    if isinstance(source, xr.Dataset):
        return sweep_of_dataset(source)
    if isinstance(source, Sweep):
        return replace(source, run=replace(source.run, orbits=True))
    return read_sweep(source, ["run.orbits=true"])


def sweep_of_dataset(dataset: xr.Dataset, orbits: bool = True) -> Sweep:
    """The sweep that a dataset is of, with its `orbits` if wanted: by its text, and of points by its coordinates.

    Raises `InputError` where there is none, or its file says something else by now.
    """
    try:
        tables = tomllib.loads(str(dataset.attrs["sweep"]))
    except (KeyError, ValueError, RecursionError):
        raise InputError(
            "orbits: not the dataset of a sweep (it has no attribute sweep); give one, or a sweep"
        ) from None
    if "points" in tables:
        columns = {str(name): one.values.tolist() for name, one in dataset.coords.items() if one.dims == ("point",)}
        vectors = any(name.startswith(VECTOR) for name in columns)
        tables["points"] = {n: x for n, x in columns.items() if n != "point" and not (vectors and n == "start")}
    sweep = read_sweep(tables, ["run.orbits=true"] if orbits else ())
    identity = sweep.identity()
    before = {name: x for name, x in table_of(dataset, IDENTITY).items() if name not in _OF_WHAT_WAS_FOUND}
    wanted = {**before, "run.orbits": True} if orbits else before
    differing = changes(wanted, json.loads(identity_text(identity)))
    if before and differing:
        raise InputError(
            f"orbits: the sweep that the dataset names is another one now: {differing}; give the sweep itself"
        )
    _check_cost(dataset, sweep)
    return replace(sweep, title=sweep.title or title_of(dataset))


def has_lanes_of(dataset: xr.Dataset, sweep: Sweep) -> bool:
    """Return whether a dataset has a value for each lane of a sweep."""
    return all(dataset.sizes.get(name) == size for name, size in zip(sweep.dims, sweep.shape, strict=True))


def _check_cost(dataset: xr.Dataset, sweep: Sweep) -> None:
    """Raise `InputError` if a dataset, which may come from anywhere, names a sweep that hardly ends."""
    seconds, lanes = sweep.run.settle + sweep.run.observe, 1 if has_lanes_of(dataset, sweep) else sweep.lanes
    if seconds > LONGEST_RERUN or lanes * seconds > MOST_RERUN_SECONDS:
        raise InputError(
            f"orbits: the sweep that the dataset names has {sweep.lanes} lanes of {seconds:g} s, more than is run for "
            "a dataset; give the sweep itself"
        )
