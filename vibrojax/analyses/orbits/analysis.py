"""Analyses of the lanes of a sweep and their periodic orbits."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike

import xarray as xr

from vibrojax.analyses.analysis import Analysis, Source
from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import InputError
from vibrojax.io.attributes import table_of, title_of
from vibrojax.io.kinds import kind_of
from vibrojax.io.manifest import IDENTITY, changes, identity_text
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.own_code import is_code
from vibrojax.sweep.input.points import VECTOR
from vibrojax.sweep.input.read import read_sweep


class SweepAnalysis(Analysis):
    """An analysis of the lanes of a sweep and their periodic orbits.

    A subclass provides `kind` and `of_lanes`. It overrides `sweep` to restrict the accepted sweeps, and `identity` if
    the result depends on settings. If the analysis is run as a command, the finished chunks of the sweep are kept until
    the result is written.

    **Example:** the fraction of lanes that settle on a stable orbit

    >>> class StableShare(vj.SweepAnalysis):
    ...     kind = "stable-share"
    ...     def of_lanes(self, sweep, lanes, progress=True):
    ...         return self.dataset({"share": ((), float((lanes.stable == 1).mean()))}, {}, title=sweep.title)
    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005}
    >>> sweep = {"scene": "vibro-impact", "parameters": point, "starts": ["stuck"]}
    >>> vj.analyse(sweep, StableShare(), progress=False).share.item()
    1.0
    """

    def sweep(self, source: Source) -> Sweep:
        """Return the sweep of `source` with `orbits = true`; raise `InputError` if it cannot be analysed."""
        return sweep_with_orbits(source)

    def identity(self, sweep: Sweep) -> dict[str, object]:
        """Return the settings on which the result depends in addition to the sweep, as flat JSON values."""
        return {self.kind: True}

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        """Return the result; `lanes`: dataset of the sweep with orbits."""
        raise NotImplementedError(f"{type(self).__name__}.of_lanes")

    def run(self, source: Source, progress: bool = True) -> xr.Dataset:
        """Return the dataset of the analysis; unless `source` is a dataset with orbits, its sweep is run first."""
        sweep = self.sweep(source)
        return self.of_lanes(sweep, orbits(source if isinstance(source, xr.Dataset) else sweep, progress), progress)


RERUN_MAX_SECONDS = 10_000.0
"""Simulated seconds per lane above which a dataset's sweep is not run again; a dataset may come from any source."""

RERUN_MAX_TOTAL_SECONDS = 1e8
"""Simulated seconds, summed over all lanes, above which a dataset's sweep is not run again. The limit does not apply if
the dataset contains a value for each lane."""


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
      Newton's method, so its sweep is run again. A dataset with orbits is returned unchanged.
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
    if isinstance(source, xr.Dataset) and "orbit_reason" in source:
        return source
    return run_sweep(sweep_with_orbits(source), progress=progress)


def sweep_with_orbits(source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep) -> Sweep:
    """Return the sweep of `source` with `orbits = true`; raise `InputError` if `source` has no sweep."""
    if isinstance(source, xr.Dataset):
        return sweep_of_dataset(source)
    if isinstance(source, Sweep):
        return replace(source, run=replace(source.run, orbits=True))
    return read_sweep(source, ["run.orbits=true"])


def sweep_of_dataset(dataset: xr.Dataset, orbits: bool = True) -> Sweep:
    """Return the sweep of a dataset, from the attribute `sweep`, and from the coordinates if it is a list of points.

    **Arguments:** `orbits`: True to set `orbits = true`.

    **Raises:** `InputError` if the dataset has no sweep, if the sweep that it names has changed since, or if the sweep
    is too expensive to run again.
    """
    try:
        tables = tomllib.loads(str(dataset.attrs["sweep"]))
    except (KeyError, ValueError, RecursionError):
        kind = kind_of(dataset)
        why = f"its kind is {kind}" if kind and kind != "sweep" else "it has no attribute sweep"
        raise InputError(f"not the dataset of a sweep ({why}); give one, or a sweep") from None
    if "points" in tables:
        columns = {str(name): x.values.tolist() for name, x in dataset.coords.items() if x.dims == ("point",)}
        vectors = any(name.startswith(VECTOR) for name in columns)
        tables["points"] = {n: x for n, x in columns.items() if n != "point" and not (vectors and n == "start")}
    sweep = read_sweep(tables, ["run.orbits=true"] if orbits else ())
    before = dict(table_of(dataset, IDENTITY))
    for name in ("attractors", "borders"):  # these entries belong to derived results, not to the sweep
        before.pop(name, None)
    now = json.loads(identity_text(sweep.identity()))
    # Version 0.1.0 did not state the code of the user's own scenes and laws.
    codes = {} if any(map(is_code, before)) else {name: x for name, x in now.items() if is_code(name)}
    differing = changes(before | codes | ({"run.orbits": True} if orbits else {}), now)
    if before and differing:
        raise InputError(f"orbits: the sweep that the dataset names has changed: {differing}; give the sweep itself")
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
