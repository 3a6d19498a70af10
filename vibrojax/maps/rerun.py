"""Periodic orbits of a sweep's lanes, and sweeps of datasets that are run again."""

import json
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import replace
from math import inf
from os import PathLike

import xarray as xr

from vibrojax.errors import InputError
from vibrojax.io.attributes import table_of, title_of
from vibrojax.io.kinds import kind_of
from vibrojax.io.manifest import IDENTITY, changes, identity_text
from vibrojax.maps.cost import estimated_steps
from vibrojax.maps.edited import POINTS, at_coordinates, check_dimensions, points_at, with_numbered_starts
from vibrojax.maps.read import read_sweep
from vibrojax.maps.run import run_sweep
from vibrojax.maps.sweep import Sweep
from vibrojax.settings.code_identity import is_code
from vibrojax.settings.values import UnusualValue

RERUN_LANE_MAX_STEPS = 2e6
"""Estimated steps of a lane above which a dataset's sweep is not run again; a dataset may come from any source. The
hardest bundled lanes take 1e6 steps."""

RERUN_MAX_STEPS = 3e9
"""Estimated steps of all lanes above which a dataset's sweep is not run again, about five minutes of one core. Analyses
do not apply the limit if the dataset contains a value for each lane; pages, which run sweeps unasked, always do."""


def orbits(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep, progress: bool = True
) -> xr.Dataset:
    """Find the periodic orbits of a sweep's lanes, their multipliers and their stability.

        orb = vj.orbits(ds)

    The return map takes the state at one section crossing to the state at the next. An orbit with `cycles` crossings
    per period is a fixed point of the `cycles`-th iterate of this map. Newton's method computes the orbit from a lane's
    last crossings. The map's derivative includes all events, so the multipliers are those of the exact motion. An orbit
    is stable if all its multipliers have moduli below 1.

    In the scene `penetration` the beginning of a pulse replaces the section crossing. A lane is periodic if the map,
    iterated from its last pulse, comes back to the same state after 1 to 8 pulses.

    **Arguments:**

    - `source`: the dataset of a sweep, or a sweep as in `run_sweep`. A dataset does not contain the initial states for
      Newton's method, so its sweep is run again, at the coordinates of the dataset. A dataset with orbits is returned
      unchanged, unless its coordinates are not those of its sweep.
    - `progress`: True to report progress on stderr.

    **Returns:** the sweep's dataset, with these additional variables over its dimensions. For a lane with a found
    orbit, `period` and the other measures are those of the orbit.

    - `multiplier_abs` [1], `multiplier_arg` [rad] along `multiplier`, in order of decreasing modulus: eigenvalues of
      the map's derivative over `cycles` crossings. `stable`: 1 or 0, or -1 without multipliers.
    - `orbit_reason`: *found*, or the reason why there is no orbit. *not-repeating*: the lane is not periodic.
      *refused*: the lane cannot be run. *not-converged*: Newton's method has not converged. *near-grazing*: the orbit
      is so close to grazing that multipliers have no meaning. *another-orbit*: the orbit is too far from the lane, has
      another number of impacts, is unstable, or is not confirmed by a simulation.
    - `error_estimate`: infinite for a lane near an unstable orbit. An unstable orbit is *found* only if the lane stays
      on it although a single rounding error would drive it away, for example because of an exact symmetry.
    - `orbit_residual`: the largest difference between an image under the map and the next state, in units of the
      states' scales; `grazing_margin`: the distance from a change in the order of events, defined in the attribute
      `orbits`.
    - `orbit_cycles`: the minimal number of crossings per period. It is less than the lane's `cycles` if the lane is
      still settling on an orbit with a shorter period.
    - `nearby_cycles`: crossings per period of a stable orbit near an irregular or undecided lane, which the lane has
      not reached; 0 if none was found; not computed in `penetration`. `nearby_impacts`: impacts per period of that
      orbit; `nearby_distance`: the largest distance of the lane's last crossings from that orbit, in units of half the
      peak-to-peak ranges of the states.

    **Raises:** `InputError` if the source is not a sweep or the dataset of one, if the sweep cannot be run, or if the
    scene has neither a section nor pulses.

    **Example:**

    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005}
    >>> orb = vj.orbits({"scene": "vibro-impact", "parameters": point, "starts": ["stuck"]}, progress=False)
    >>> int(orb.stable.item()), orb.multiplier_abs.values.ravel().round(3).tolist()  # the bit sticks: one is 0
    (1, [0.697, 0.697, 0.0])
    """
    if isinstance(source, xr.Dataset) and holds_orbits(source):
        return source
    return run_sweep(sweep_with_orbits(source), progress=progress)


def sweep_with_orbits(source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep) -> Sweep:
    """Return the sweep of `source` with `orbits = true`; raise `InputError` if `source` has no sweep."""
    if isinstance(source, xr.Dataset):
        return sweep_of_dataset(source)
    if isinstance(source, Sweep):
        return replace(source, run=replace(source.run, orbits=True))
    return read_sweep(source, ["run.orbits=true"])


def holds_orbits(dataset: xr.Dataset) -> bool:
    """Return whether a dataset holds the orbits of its lanes: those of an edited dataset may be of other lanes."""
    return "orbit_reason" in dataset and ("sweep" not in dataset.attrs or not _lanes_of_dataset(dataset, True)[1])


def sweep_of_dataset(dataset: xr.Dataset, orbits: bool = True) -> Sweep:
    """Return the sweep of the lanes at a dataset's coordinates, with the settings in its attribute `sweep`.

    **Arguments:** `orbits`: True to set `orbits = true`.

    **Raises:** `InputError` if the dataset has no sweep, if its coordinates do not define lanes, if the sweep that it
    names has changed since, or if the sweep is too expensive to run again.
    """
    sweep, _ = _lanes_of_dataset(dataset, orbits)
    if problem := rerun_problem(sweep, inf if has_lanes_of(dataset, sweep) else RERUN_MAX_STEPS):
        raise InputError(f"orbits: the sweep that the dataset names has {problem}; give the sweep itself")
    return replace(sweep, title=sweep.title or title_of(dataset))


def _lanes_of_dataset(dataset: xr.Dataset, orbits: bool) -> tuple[Sweep, bool]:
    """Return the sweep of a dataset's lanes, and whether they differ from the computed ones."""
    try:
        tables = tomllib.loads(str(dataset.attrs["sweep"]))
    except (KeyError, ValueError, RecursionError):
        kind = kind_of(dataset)
        why = f"its kind is {kind}" if kind and kind != "sweep" else "it has no attribute sweep"
        raise InputError(f"not the dataset of a sweep ({why}); give one, or a sweep") from None
    before = dict(table_of(dataset, IDENTITY))
    for name in ("attractors", "borders", "sensitivity"):  # these entries belong to derived results, not to the sweep
        before.pop(name, None)
    points = {name: x for name, x in before.items() if name.startswith(POINTS)}
    if "points" in tables:
        tables |= points_at(tables, [name.removeprefix(POINTS) for name in points], dataset.coords)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnusualValue)  # reported when the sweep was run
        stored = with_numbered_starts(read_sweep(tables, ["run.orbits=true"] if orbits else ()), dataset.coords)
    now = json.loads(identity_text(stored.identity()))
    # Version 0.1.0 did not state the code of the user's own scenes and laws.
    known = {name: x for name, x in now.items() if is_code(name) and not any(map(is_code, before))}
    # Points are in the coordinates alone; whether orbits were found does not change lanes.
    free = {*points, "run.orbits", *(name for name in now if name.startswith(POINTS))}
    if stored.points is not None:
        free |= {"starts", *(f"parameters.{name}" for name in stored.points)}
    same, other = ({name: x for name, x in values.items() if name not in free} for values in (before | known, now))
    if before and (differing := changes(same, other)):
        raise InputError(f"orbits: the sweep that the dataset names has changed: {differing}; give the sweep itself")
    edited = bool(before) and any(before.get(name) != now.get(name) for name in free - {"run.orbits"})
    sweep = stored
    if kind_of(dataset) != "borders":  # their coordinates are not those of lanes
        sweep = at_coordinates(stored, dataset.coords)
    check_dimensions(dataset, sweep)
    return sweep, edited or sweep is not stored


def rerun_problem(sweep: Sweep, most_steps: float = RERUN_MAX_STEPS) -> str:
    """Return why a sweep is not run for a dataset, or an empty string.

    **Arguments:** `most_steps`: limit on the estimated steps of all lanes.
    """
    steps = estimated_steps(sweep)
    if steps.slowest <= RERUN_LANE_MAX_STEPS and steps.total <= most_steps:
        return ""
    return f"{sweep.lanes} lanes of up to {steps.slowest:.3g} steps, more than is run for a dataset"


def has_lanes_of(dataset: xr.Dataset, sweep: Sweep) -> bool:
    """Return whether a dataset has a value for each lane of a sweep."""
    return all(dataset.sizes.get(name, 1) == size for name, size in zip(sweep.dims, sweep.shape, strict=True))
