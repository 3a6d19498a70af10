"""Attractors that a sweep's initial conditions lead to, over the sweep's grid: `attractors`."""

import json
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.errors import InputError
from vibrojax.io.attributes import parameters_of
from vibrojax.io.kinds import OF_ATTRACTORS
from vibrojax.io.variables import VARIABLES, described
from vibrojax.lanes.labels import measured_besides, of_orbits
from vibrojax.maps.dataset import shared_attributes
from vibrojax.maps.rerun import orbits as with_orbits
from vibrojax.maps.rerun import sweep_with_orbits
from vibrojax.maps.run import run_sweep
from vibrojax.maps.starts import DEFAULT_STARTS, list_of
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import IRREGULAR, SINGLE_IMPACT, blow_frequency
from vibrojax.periodic.orbits import SAME_ORBIT
from vibrojax.studies.attractor_grouping import (
    EXPONENT_STDERRS,
    IRREGULAR_MIN_LANES,
    IRREGULAR_WITHIN,
    PREDICTION_WITHIN,
    RESOLUTION_STDERRS,
    SIMILAR_FACTOR,
    PointMotions,
    classify_motions,
    find_links,
    irregular_groups,
    is_ambiguous,
    number_attractors,
)
from vibrojax.studies.attractor_long_run import (
    CONVERGED_STDERR,
    FEWEST_WINDOWS,
    MOST_WINDOWS,
    SPLIT_MIN_WINDOWS,
    with_long_statistics,
)

NAMED = "named_start"
"""Dimension of the scene's named initial conditions, in addition to a sample or a plane of initial conditions."""

MEASURED = ("period", "impacts", "impact_velocity", "impact_power", "stick_slip_index", "specific_energy")
"""Variables whose medians over an attractor's lanes are stored."""

METHOD = (
    "lanes of a point are one motion if their orbits are within same_within over the scales of labels; irregular ones "
    "if chains of lanes join them, each within irregular_within and standard_errors of the next in period, "
    "impact velocity and amplitudes, or, where exponents are known, within exponent_within standard errors. Irregular "
    "lanes are observed for more windows of the sweep's observe, from the first to the second of the numbers in "
    "windows, until the relative standard errors of these statistics are below least_precision; lanes that reach an "
    "orbit or do not converge are unassigned, and lanes that differ are observed for at least windows_at_a_split. A "
    "motion that nowhere has fewest lanes does not count beside another of more, nor, without exponents, one of fewer "
    "within irregular_factor of it. Motions of neighbouring points are one attractor if the orbit of one, continued as "
    "a stable one and never farther than aside over the scales from its prediction, becomes that of the other; "
    "irregular ones if they are nearest, and within irregular_factor. Numbers from 0 by falling share over the grid"
)


def attractors(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep, progress: bool = True
) -> xr.Dataset:
    """Find the attractors that a sweep's initial conditions lead to, and the fraction of each, over the grid.

        att = vj.attractors(ds)

    Lanes of a grid point have the same motion if their orbits are equal, or, for irregular lanes, their statistics.
    Irregular lanes are observed for 8 to 128 times as long as in the sweep, until their statistics have converged to
    the resolution that distinguishes motions (see the dataset's attribute `attractors`).

    Motions of neighbouring points are the same attractor if the orbit of one, continued to the other's parameters,
    becomes the orbit of the other. An attractor keeps its number through grazes, changes of the regime label and period
    doublings. An irregular motion has a number of its own. Numbers do not depend on the order of values on an axis; 0
    is the attractor with the greatest fraction over the grid.

    **Arguments:**

    - `source`: dataset of a sweep over `start`, or a sweep as `run_sweep` accepts it. A sweep is run again if its
      dataset lacks orbits. With `lyapunov = true`, irregular lanes that had not settled are left out.
    - `progress`: whether to report progress on stderr.

    **Returns:** a dataset.

    - Over the grid and `attractor`: `share`, the fraction of initial conditions (basin stability), and its binomial
      standard error `share_stderr`, an upper bound for Sobol samples. `regime` is the most frequent regime of the
      attractor's lanes, `cycles` the period of its orbit in returns (0 without an orbit). `period`, `impacts` and
      `impact_velocity` are medians over the lanes, from the longer observation if they are irregular. So are
      `impact_power`, `stick_slip_index` and `specific_energy`, but from the sweep's observation; `blow_frequency`
      follows from `impacts` and `period`. `orbit_x1` and so on are one point of the orbit on the section.
    - Over the grid, `unassigned`: number of initial conditions without an attractor. Their lanes failed, were
      undecided, had not settled, did not converge, or their orbit was not found.
    - Over the sweep's dimensions, `lane_attractor`: number of the lane's attractor, -1 if unassigned.
    - Over the grid and `named_start`, if the initial conditions are a sample or a plane: `named_attractor` and
      `named_regime`, to which the scene's named initial conditions `drive` and `stuck` lead. They do not count in
      `share`.

    **Raises:** `InputError` unless `source` is a sweep over a grid and `start`, of a scene with a section.

    **Example:**

    >>> starts = {"scene": "vibro-impact", "parameters": {"beta": 0.4, "delta": 0.0}, "grid": {"gamma": [0.6]}}
    >>> att = vj.attractors(starts | {"starts": ["drive", "stuck", "touching"]}, progress=False)
    >>> att.share.round(2).values.tolist()
    [[0.67, 0.33]]
    >>> att.impact_velocity.round(1).values.tolist()  # m/s: both are single impacts
    [[0.7, 3.0]]
    """
    sweep = sweep_of(source)
    return attractors_of(sweep, with_orbits(source if isinstance(source, xr.Dataset) else sweep, progress), progress)


def sweep_of(source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep) -> Sweep:
    """Return the sweep to analyse; raise `InputError` if `attractors` does not apply to it."""
    if isinstance(source, xr.Dataset) and "lane_attractor" in source:
        raise InputError("attractors: the dataset holds attractors already; give the sweep, or its dataset")
    sweep = sweep_with_orbits(source)
    if sweep.run.carry is not None:
        raise InputError("attractors: lanes of this sweep are carried, so they have no starts; leave carry out")
    if sweep.points is not None or sweep.point_starts is not None or sweep.point_vectors is not None:
        raise InputError("attractors: points of a list have no neighbours to number along; give a [grid] instead")
    if not sweep.crosses_starts or sweep.system.driving_part().section is None:
        raise InputError(f'attractors: scene "{sweep.scene}" takes no starts; give a sweep of a scene with a drill')
    return sweep


def attractors_of(sweep: Sweep, dataset: xr.Dataset, progress: bool = True) -> xr.Dataset:
    """Return the attractors of a sweep, from its dataset with orbits; see `attractors`."""
    dataset = dataset.transpose(*sweep.dims, ...)
    shape, starts = sweep.shape[:-1], sweep.shape[-1]
    runs = [(sweep, dataset)]
    named = [name for name in DEFAULT_STARTS if name in sweep.system.starts]
    if sweep.starts is not None and not sweep.starts.listed and named:
        own = replace(sweep, starts=list_of(named, sweep.starts.states), run=replace(sweep.run, orbits=True))
        runs.append((own, run_sweep(own, progress=progress).transpose(*sweep.dims, ...)))
    lanes = _observe_irregular(runs, progress)
    scene = sweep.system.driving_part()
    values, _ = sweep.lane_values(0, sweep.lanes)
    points = {name: values[name][::starts] for name in scene.parameters()}
    per_point = lanes.sizes["start"]
    motions = classify_motions(scene, lanes, {name: np.repeat(x, per_point) for name, x in points.items()}, per_point)
    of_start = motions.of_lane.reshape(-1, per_point)[:, :starts]  # without the scene's named initial conditions
    count = np.bincount(of_start[of_start >= 0], minlength=len(motions.items))
    links = find_links(scene, points, shape, motions)
    cells = [motion.cell for motion in motions.items]
    number = number_attractors(cells, count.tolist(), links, _sort_keys(sweep, cells, count))
    ambiguous = is_ambiguous(motions, number)
    motions.remove(ambiguous)
    number = np.unique(number[~ambiguous], return_inverse=True)[1]
    of_lane = np.where(motions.of_lane >= 0, np.append(number, -1)[motions.of_lane], -1).reshape(*shape, per_point)
    result = _dataset(sweep, dataset, _columns(sweep, lanes, motions, number), of_lane[..., :starts])
    if len(runs) == 1:
        return result
    dims, own_dataset = (*sweep.dims[:-1], NAMED), runs[1][1]
    variables: dict[str, Any] = {
        NAMED: (NAMED, own_dataset["start"].values, {"units": "1", "long_name": "start of the scene, by name"}),
        "named_attractor": (dims, of_lane[..., starts:]),
        "named_regime": (dims, own_dataset["regime"].values),
    }
    return result.assign(described(variables, OF_ATTRACTORS))


def _observe_irregular(runs: list[tuple[Sweep, xr.Dataset]], progress: bool) -> xr.Dataset:
    """Return the lanes of all runs, joined along `start`; irregular lanes have statistics of a longer observation.

    If the irregular lanes of a point differ, they are observed even longer.
    """
    shape = runs[0][0].shape[:-1]
    mask = np.ones(shape, bool)
    datasets = [dataset for _, dataset in runs]
    for fewest in (FEWEST_WINDOWS, SPLIT_MIN_WINDOWS):
        for k, (sweep, dataset) in enumerate(runs):
            lanes = np.flatnonzero((dataset["regime"].values == IRREGULAR) & mask[..., None])
            datasets[k] = with_long_statistics(sweep, datasets[k], lanes, fewest, progress)
        names = [name for name in datasets[0].data_vars if all(name in dataset for dataset in datasets)]
        plain = [dataset[names].reset_coords(drop=True).drop_vars("start", errors="ignore") for dataset in datasets]
        joined = xr.concat(plain, "start", data_vars="minimal")
        starts = joined.sizes["start"]
        split = [int(groups[0][0]) // starts for groups in irregular_groups(joined, starts) if len(groups) > 1]
        mask = np.isin(np.arange(mask.size), split).reshape(shape)
    return joined


def _sort_keys(sweep: Sweep, cells: list[int], count: Int[np.ndarray, " motions"]) -> list[tuple[float, ...]]:
    """Return the sort key of each motion: increasing axis values of its point, then decreasing number of lanes."""
    ranks = [np.argsort(np.argsort(axis)) for axis in sweep.axes.values()]
    places = [np.unravel_index(cell, sweep.shape[:-1]) if ranks else () for cell in cells]
    return [
        (*(float(rank[k]) for rank, k in zip(ranks, place, strict=True)), -float(count[motion]), float(motion))
        for motion, place in enumerate(places)
    ]


def _columns(
    sweep: Sweep, dataset: xr.Dataset, motions: PointMotions, number: Int[np.ndarray, " motions"]
) -> dict[str, Float[np.ndarray, "points attractors"]]:
    """Return the properties of each attractor at each point by name, 0 or NaN where the attractor is absent.

    They are regime, cycles, medians of `MEASURED` over the lanes, and one point of the orbit on the section.
    """
    shape = dataset["regime"].size // dataset.sizes["start"], int(number.max(initial=-1)) + 1
    lanes = pd.DataFrame({name: dataset[name].values.ravel().astype(float) for name in MEASURED if name in dataset})
    cells = np.array([motion.cell for motion in motions.items], int), number
    repeats = np.array([motion.cycles for motion in motions.items] + [0])[motions.of_lane]
    if "impacts" in lanes:  # a lane may show a longer period than its orbit has
        of_orbit = lanes["impacts"] * repeats / dataset["cycles"].values.ravel()
        lanes["impacts"] = lanes["impacts"].where(repeats == 0, of_orbit)
    medians = lanes.where(np.isfinite(lanes)).groupby(motions.of_lane).median().reindex(range(len(number)))
    columns = {name: np.zeros(shape) for name in ("regime", "cycles")}
    columns |= {name: np.full(shape, np.nan) for name in (*lanes, *of_orbits(sweep.system))}
    for name in lanes:
        columns[name][cells] = medians[name]
    for motion, *cell in zip(motions.items, *cells, strict=True):
        columns["regime"][*cell], columns["cycles"][*cell] = motion.regime, motion.cycles
        if motion.orbit is not None:
            for name, state in zip(of_orbits(sweep.system), motion.orbit.states[0, 0], strict=True):
                columns[name][*cell] = state
    if "blow_frequency" in dataset:
        columns["blow_frequency"] = blow_frequency(columns["impacts"], columns["cycles"], columns["period"])
    return columns


def _dataset(
    sweep: Sweep,
    dataset: xr.Dataset,
    columns: Mapping[str, Float[np.ndarray, "points attractors"]],
    of_lane: Int[np.ndarray, "*lanes"],
) -> xr.Dataset:
    shape, starts = sweep.shape[:-1], sweep.shape[-1]
    points, count = columns["regime"].shape
    share = np.zeros((points, count))
    assigned = np.flatnonzero(of_lane >= 0)
    np.add.at(share, (assigned // starts, of_lane.ravel()[assigned]), 1 / starts)
    columns = {"share": share, "share_stderr": np.sqrt(share * (1 - share).clip(0) / starts), **columns}
    about = VARIABLES | measured_besides(sweep.system) | of_orbits(sweep.system) | OF_ATTRACTORS
    grid = sweep.dims[:-1]
    data: dict[str, Any] = {name: ((*grid, "attractor"), x.reshape(*shape, -1)) for name, x in columns.items()}
    data |= {"unassigned": (grid, (of_lane < 0).sum(axis=-1)), "lane_attractor": (sweep.dims, of_lane)}
    numbers = ("attractor", np.arange(count), {"units": "1", "long_name": "number of the attractor"})
    coordinates = {name: x for name, x in dataset.coords.items() if set(x.dims) <= set(sweep.dims)}
    settings = {
        "method": METHOD,
        "same_within": SAME_ORBIT,
        "irregular_within": IRREGULAR_WITHIN,
        "standard_errors": RESOLUTION_STDERRS,
        "windows": [FEWEST_WINDOWS, MOST_WINDOWS],
        "windows_at_a_split": SPLIT_MIN_WINDOWS,
        "least_precision": CONVERGED_STDERR,
        "exponent_within": EXPONENT_STDERRS,
        "irregular_factor": SIMILAR_FACTOR,
        "fewest": IRREGULAR_MIN_LANES,
        "aside": PREDICTION_WITHIN,
    }
    title = (sweep.title or sweep.name).removesuffix(f": {sweep.name}")  # not two colons
    attributes = {
        **shared_attributes(sweep, "attractors", f"Attractors: {title}", "attractors"),
        "sweep": sweep.text,
        "attractors": json.dumps(settings),
        "lanes": sweep.lanes,
    }
    return xr.Dataset(described(data, about), {**coordinates, "attractor": numbers}, attributes)


def strong_share(ds: xr.Dataset) -> xr.DataArray:
    """Return the percentage of initial conditions that end in a stable single impact faster than the drive.

    In scenes without a drive, all single impacts count.
    """
    strong = ds["regime"] == SINGLE_IMPACT
    speed = drive_speed(ds)
    if speed is not None:
        strong = strong & (ds["impact_velocity"] > speed)
    return (100.0 * ds["share"]).where(strong, 0.0).sum("attractor").assign_attrs(units="%")


def drive_speed(ds: xr.Dataset) -> xr.DataArray | float | None:
    """Return the drive's speed [m/s]; None if there are no impacts or no drive."""
    if "impact_velocity" not in ds:
        return None
    return ds["v"] if "v" in ds.coords else parameters_of(ds).get("v")
