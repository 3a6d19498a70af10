"""The attractors that a sweep's starts lead to, over its grid: `attractors`."""

import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.analyses.attractors.grouping import (
    ERRORS,
    EXPONENT_WITHIN,
    FEWEST,
    IRREGULAR_FACTOR,
    IRREGULAR_WITHIN,
    SAME,
    Motions,
    doubtful,
    irregular_groups,
    told_apart,
)
from vibrojax.analyses.attractors.long_run import (
    FEWEST_WINDOWS,
    LEAST_PRECISION,
    MOST_WINDOWS,
    WINDOWS_AT_A_SPLIT,
    with_long_statistics,
)
from vibrojax.analyses.attractors.neighbours import ASIDE, links
from vibrojax.analyses.attractors.numbers import numbered
from vibrojax.analyses.orbits.rerun import orbits as with_orbits
from vibrojax.analyses.orbits.rerun import sweep_with_orbits
from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import InputError
from vibrojax.io.derived import OF_ATTRACTORS
from vibrojax.io.provenance import provenance
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.measures.labels import IRREGULAR
from vibrojax.models.physics.parameters import differing
from vibrojax.sweep.engine.labelled import of_orbits
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.names import DEFAULT_STARTS
from vibrojax.sweep.input.starts import list_of

NAMED = "named_start"
"""Dimension of the scene's own starts, beside a sample or a plane of them."""

MEASURED = ("period", "impacts", "impact_velocity")
"""What is said of attractors besides their regime and cycles: the median of their lanes."""

METHOD = (
    "lanes of a point are one motion if their orbits are within same_within over the scales of labels; irregular ones "
    "if chains of lanes join them, each within irregular_within and standard_errors of the next in period, "
    "impact velocity and amplitudes, or, where exponents are known, within exponent_within standard errors. Irregular "
    "lanes are observed for more windows of the sweep's observe, from the first to the second of the numbers in "
    "windows, until the relative standard errors of these statistics are below least_precision; lanes that come to an "
    "orbit or do not converge are unassigned, and lanes that differ are observed for windows_at_a_split at least. A "
    "motion that nowhere has fewest lanes is not told beside another of more, nor, without exponents, one of fewer "
    "within irregular_factor of it. Motions of neighbouring points are one attractor if the orbit of one, followed as "
    "a stable one and never farther than aside over the scales from where it is expected, leads to that of the other; "
    "irregular ones if they are nearest, and within irregular_factor. Numbers from 0 by falling share over the grid"
)


def attractors(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep, progress: bool = True
) -> xr.Dataset:
    """The attractors that a sweep's starts lead to, and the share of starts of each, over the grid.

        att = vj.attractors(ds)

    Lanes of a point end in one motion where their orbits are the same; irregular ones, where their statistics are.
    These are observed for longer than by the sweep, 8 to 128 times as long, until the statistics have converged to the
    resolution that separates motions (see the attribute `attractors`). A motion is the same attractor as one of the
    next point of the grid where its orbit, followed there, becomes that of the other: through grazes and changes of
    label, and through a period doubling, whose orbit keeps the number of the one that it doubled from. An irregular
    motion has a number of its own. Numbers do not depend on the order of an axis; 0 is the attractor with the greatest
    share over the grid.

    **Arguments:**

    - `source`: the dataset of a sweep with starts, or a sweep as `run_sweep` takes it. One without orbits is run again.
      With `lyapunov = true`, irregular lanes that had not settled are left out.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** a dataset. Over the grid and `attractor`: `share` and its binomial `share_stderr`, which is an upper
    bound for Sobol starts; `regime`, that of most of its lanes, `period`, `cycles`, `impacts` and `impact_velocity`,
    where a lane ends in it, and of orbits the state at the section (`orbit_x1` and so on), at one of their returns.
    Period and impact velocity of irregular attractors are those of the longer observation.
    Over the grid `unassigned`: starts of which none could be told, because they failed, were undecided, had not
    settled, did not converge, or their orbit was not found. Over the sweep's dimensions `lane_attractor`: -1 there.
    Where the starts are a sample or a plane, the scene's own, `drive` and `stuck`, are run beside them and are no part
    of the shares: over the grid and `named_start`, `named_attractor` and `named_regime`, where each of these leads.

    **Raises:** `InputError` where it is no sweep over a grid, or of starts, of a scene that returns to a section.

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


def attractors_of(sweep: Sweep, dataset: xr.Dataset, progress: bool = True) -> xr.Dataset:
    """The attractors of a sweep, from its dataset with orbits; see `attractors`."""
    dataset = dataset.transpose(*sweep.dims, ...)
    shape, starts = sweep.shape[:-1], sweep.shape[-1]
    runs = [(sweep, dataset), *_from_named(sweep, progress)]
    lanes = _observed_longer(runs, progress)
    named = runs[1][1] if len(runs) > 1 else None
    scene = sweep.system.driving_part()
    values, _ = sweep.lane_values(0, sweep.lanes)
    points = {name: values[name][::starts] for name in scene.parameters()}
    each = lanes.sizes["start"]
    motions = told_apart(scene, lanes, {name: np.repeat(x, each) for name, x in points.items()}, each)
    drawn = np.arange(each) < starts  # what the scene's own starts lead to is no part of the shares
    count = np.bincount(
        motions.of_lane[(motions.of_lane >= 0) & np.tile(drawn, len(motions.of_lane) // each)],
        minlength=len(motions.cell),
    )
    number = numbered(motions.cell, count.tolist(), links(scene, points, shape, motions), _order(sweep, motions, count))
    out = doubtful(motions, number)
    motions.leave_out(out)
    number = np.unique(number[~out], return_inverse=True)[1]
    of_lane = np.where(motions.of_lane >= 0, np.append(number, -1)[motions.of_lane], -1).reshape(*shape, each)
    measured = {name: (VARIABLES[name], x) for name, x in _measured(lanes, motions, number).items()}
    measured |= _at_section(sweep, motions, number, *measured["regime"][1].shape)
    found = _described(sweep, dataset, measured, of_lane[..., :starts])
    return found if named is None else found.assign(_of_named(sweep, named, of_lane[..., starts:]))


def _from_named(sweep: Sweep, progress: bool) -> list[tuple[Sweep, xr.Dataset]]:
    """Return the sweep from the scene's own starts and its lanes, if `sweep` draws its starts from a box or a plane."""
    names = [name for name in DEFAULT_STARTS if name in sweep.system.starts]
    if sweep.starts is None or sweep.starts.listed or not names:
        return []
    own = replace(sweep, starts=list_of(names, sweep.starts.states), run=replace(sweep.run, orbits=True))
    return [(own, run_sweep(own, progress=progress).transpose(*sweep.dims, ...))]


def _observed_longer(runs: list[tuple[Sweep, xr.Dataset]], progress: bool) -> xr.Dataset:
    """Return the lanes of all runs along `start`, irregular ones with statistics over a longer observation.

    Where the irregular lanes of a point differ, they are observed for longer still.
    """
    shape = runs[0][0].shape[:-1]
    which = np.ones(shape, bool)
    datasets = [dataset for _, dataset in runs]
    for fewest in (FEWEST_WINDOWS, WINDOWS_AT_A_SPLIT):
        for k, (sweep, dataset) in enumerate(runs):
            irregular = (dataset["regime"].values == IRREGULAR) & which[..., None]
            lanes = np.flatnonzero(irregular)
            datasets[k] = with_long_statistics(sweep, datasets[k], lanes, fewest, progress)
        joined = _beside(datasets)
        starts = joined.sizes["start"]
        split = [int(groups[0][0]) // starts for groups in irregular_groups(joined, starts) if len(groups) > 1]
        which = np.isin(np.arange(which.size), split).reshape(shape)
    return joined


def _beside(datasets: list[xr.Dataset]) -> xr.Dataset:
    """Return the lanes of all datasets along `start`."""
    names = [name for name in datasets[0].data_vars if all(name in dataset for dataset in datasets)]
    alike = [one[names].reset_coords(drop=True).drop_vars("start", errors="ignore") for one in datasets]
    return xr.concat(alike, "start", data_vars="minimal")


def _of_named(sweep: Sweep, named: xr.Dataset, number: Int[np.ndarray, "*shape"]) -> dict[str, Any]:
    """What the scene's own starts lead to, over the grid."""
    dims = (*sweep.dims[:-1], NAMED)
    about = {"units": "1", "long_name": "start of the scene, by name"}
    return {
        NAMED: (NAMED, named["start"].values, about),
        "named_attractor": (dims, number.astype(np.int32), OF_ATTRACTORS["named_attractor"].attributes()),
        "named_regime": (dims, named["regime"].values, OF_ATTRACTORS["named_regime"].attributes()),
    }


def sweep_of(source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep) -> Sweep:
    """The sweep whose attractors are asked for; raises `InputError` where there are none to be told."""
    if isinstance(source, xr.Dataset) and "lane_attractor" in source:
        raise InputError("attractors: the dataset holds attractors already; give the sweep, or its dataset")
    sweep = sweep_with_orbits(source)
    if sweep.run.carry is not None:
        raise InputError("attractors: lanes of this sweep are carried, so they have no starts; leave carry out")
    if sweep.points is not None or sweep.point_starts is not None or sweep.point_vectors is not None:
        raise InputError("attractors: points of a list have no neighbours to number along; give a [grid] instead")
    if not sweep.crosses_starts or sweep.system.driving_part().section is None:
        raise InputError(
            f'attractors: scene "{sweep.scene}" starts from nothing of the user\'s; give a sweep of one with a drill'
        )
    return sweep


def _order(sweep: Sweep, motions: Motions, count: Int[np.ndarray, " motions"]) -> list[tuple[float, ...]]:
    """By what motions are ordered: their point, by rising values of the axes, then how many lanes they have."""
    ranks = [np.argsort(np.argsort(axis)) for axis in sweep.axes.values()]
    places = [np.unravel_index(cell, sweep.shape[:-1]) if ranks else () for cell in motions.cell]
    return [
        (*(float(rank[k]) for rank, k in zip(ranks, place, strict=True)), -float(count[motion]), float(motion))
        for motion, place in enumerate(places)
    ]


def _described(
    sweep: Sweep,
    dataset: xr.Dataset,
    measured: Mapping[str, tuple[Variable, Float[np.ndarray, "points many"]]],
    of_lane: Int[np.ndarray, "*lanes"],
) -> xr.Dataset:
    """The dataset of attractors."""
    shape, starts = sweep.shape[:-1], sweep.shape[-1]
    points, many = measured["regime"][1].shape
    of_lane = of_lane.ravel()
    told = np.flatnonzero(of_lane >= 0)
    share = np.zeros((points, many))
    np.add.at(share, (told // starts, of_lane[told]), 1 / starts)
    found = {
        "share": (OF_ATTRACTORS["share"], share),
        "share_stderr": (OF_ATTRACTORS["share_stderr"], np.sqrt(share * (1 - share).clip(0) / starts)),
        **measured,
    }
    dims = (*sweep.dims[:-1], "attractor")
    variables: dict[str, Any] = {
        name: (dims, x.reshape(*shape, many).astype(about.dtype), about.attributes())
        for name, (about, x) in found.items()
    }
    unassigned = (of_lane < 0).reshape(points, starts).sum(axis=1).reshape(shape)
    counted = (
        ("unassigned", sweep.dims[:-1], unassigned),
        ("lane_attractor", sweep.dims, of_lane.reshape(sweep.shape)),
    )
    for name, along, x in counted:
        one = OF_ATTRACTORS[name]
        variables[name] = (along, x.astype(one.dtype), one.attributes())
    about = {"units": "1", "long_name": "number of the attractor"}
    kept = {name: x for name, x in dataset.coords.items() if set(x.dims) <= set(sweep.dims)}
    described = {
        "method": METHOD,
        "same_within": SAME,
        "irregular_within": IRREGULAR_WITHIN,
        "standard_errors": ERRORS,
        "windows": [FEWEST_WINDOWS, MOST_WINDOWS],
        "windows_at_a_split": WINDOWS_AT_A_SPLIT,
        "least_precision": LEAST_PRECISION,
        "exponent_within": EXPONENT_WITHIN,
        "irregular_factor": IRREGULAR_FACTOR,
        "fewest": FEWEST,
        "aside": ASIDE,
    }
    attributes = {
        "title": f"Attractors: {sweep.title or sweep.name}",
        "scene": sweep.scene,
        **provenance(),
        "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} attractors",
        "sweep": sweep.text,
        **sweep.options,
        "attractors": json.dumps(described),
        "parameters": json.dumps(sweep.parameters),
        "differing": json.dumps(differing(sweep.system.parameters(), sweep.parameters)),
        "lanes": sweep.lanes,
        "Conventions": "CF-1.11",
    }
    return xr.Dataset(variables, {**kept, "attractor": ("attractor", np.arange(many), about)}, attributes)


def _measured(
    dataset: xr.Dataset, motions: Motions, number: Int[np.ndarray, " motions"]
) -> dict[str, Float[np.ndarray, "points many"]]:
    """Regime, cycles and the medians of what is measured, of each attractor at each point; 0 or NaN where it is not."""
    points, many = dataset["regime"].size // dataset.sizes["start"], int(number.max(initial=-1)) + 1
    names = [name for name in MEASURED if name in dataset]
    found = {
        name: np.full((points, many), 0.0 if name in ("regime", "cycles") else np.nan)
        for name in ("regime", "cycles", *names)
    }
    columns = {name: dataset[name].values.ravel().astype(float) for name in names}
    cycles = dataset["cycles"].values.ravel()
    order = np.argsort(motions.of_lane, kind="stable")
    ends = np.searchsorted(motions.of_lane[order], np.arange(len(number) + 1))
    for motion, (first, end) in enumerate(pairwise(ends.tolist())):
        lanes, at = order[first:end], (motions.cell[motion], number[motion])
        found["regime"][at], found["cycles"][at] = motions.regime[motion], motions.cycles[motion]
        for name, column in columns.items():
            x = column[lanes]
            if name == "impacts" and motions.cycles[motion]:  # a lane may show a longer repeat than its orbit has
                x = x * motions.cycles[motion] / cycles[lanes]
            x = x[np.isfinite(x)]
            if len(x):
                found[name][at] = np.median(x)
    return found


def _at_section(
    sweep: Sweep, motions: Motions, number: Int[np.ndarray, " motions"], points: int, many: int
) -> dict[str, tuple[Variable, Float[np.ndarray, "points many"]]]:
    """Where the orbit of each attractor passes the section, at one of its returns; NaN where it has none."""
    found = {}
    for k, (name, about) in enumerate(of_orbits(sweep.system).items()):
        column = np.full((points, many), np.nan)
        for motion, states in enumerate(motions.states):
            if states is not None:
                column[motions.cell[motion], number[motion]] = states[0, k]
        found[name] = (about, column)
    return found
