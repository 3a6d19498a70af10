"""Assembly of a sweep's dataset from its finished chunks, one block of lanes after another, to limit memory.

A block, here called region, fills a box in the dataset's arrays.
"""

import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.io.identity import IDENTITY, identity_text
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import Variable
from vibrojax.io.writers import Region, Target, chunk_shape, regions
from vibrojax.lanes.inputs import Features, LaneResult
from vibrojax.lanes.labels import variables_of, with_radius
from vibrojax.lanes.run import LaneRun, joined
from vibrojax.maps.starts import VECTOR
from vibrojax.maps.sweep import DIRECTIONS, Sweep
from vibrojax.measures.labels import hides_another, shares_transient
from vibrojax.physics.parameters import differing, substitutes
from vibrojax.progress import LOG, quiet
from vibrojax.scenes import SCENES, Scene

REGION, REGION_BYTES = 1 << 16, 32e6
"""Maximum number of lanes that are read and written together, and approximate limit on their variables [bytes]."""

COMPRESSED_BYTES = 64e6
"""Size of a dataset [bytes] up to which all variables are compressed. In a larger one, flags, counts and variables that
most lanes lack are, since they shrink to a fifth or less. Measured numbers shrink to four fifths only, which takes one
core several times as long as writing them."""

SECONDS, STEPS = "#seconds", "#steps"
"""Names of the arrays of shape () of a finished chunk: its computing time [s], and the steps of its lanes."""

Read = Callable[[int], Features]
"""Function that returns a finished chunk. Every index is read once, in order."""


def stored(result: LaneResult, seconds: float) -> Features:
    """Return the arrays of a chunk from which the dataset is made; `seconds`: computing time of the chunk."""
    return result.variables | {SECONDS: np.array(seconds), STEPS: np.array(int(result.features["steps"].sum()))}


def join(sweep: Sweep, run: LaneRun, read: Read, target: Target, began: float) -> None:
    """Write the lanes of all chunks to `target`, and finish the target; `began`: time at which the run began [s].

    The stated duration includes interrupted runs, but not the time between runs.
    """
    # With `carry`, the order of dimensions in which lanes are numbered differs from that of the dataset.
    sizes, order = dict(zip(sweep.dims, sweep.shape, strict=True)), [sweep.counted.index(name) for name in sweep.dims]
    shape = tuple(sizes[name] for name in sweep.counted)
    lane_bytes = 8 * (len(variables_of(sweep.system)) + 6 * sweep.run.keep_returns)
    chunk = chunk_shape(shape, int(min(REGION, max(1, REGION_BYTES // lane_bytes))))
    counts: Counter[str] = Counter()
    spent = {SECONDS: 0.0, STEPS: 0.0}
    begun = False
    with quiet():
        for group, variables in _lanes(sweep, read, regions(shape, chunk), spent):
            counts.update(certified(sweep, variables))
            if not begun:
                template = _template(sweep, variables)
                known = {name: np.mean(np.isfinite(x)) for name, x in variables.items() if x.dtype.kind == "f"}
                large = template.nbytes > COMPRESSED_BYTES
                plain = {name for name, share in known.items() if share > 0.5 and large}
                target.begin(template, tuple(chunk[axis] for axis in order), frozenset(plain))
                begun = True
            for region in group:
                box, lanes = tuple(region.box[axis] for axis in order), slice(*np.subtract(region[:2], group[0].first))
                for name, x in variables.items():
                    values = x[lanes].reshape(*(part.stop - part.start for part in region.box), *x.shape[1:])
                    target.put(name, box, values.transpose(*order, *range(len(order), values.ndim)))
    solver = run.described(int(spent[STEPS]))
    LOG.info("chosen: %s, %d chunks of %d lanes", json.dumps(solver), sweep.chunks, sweep.plan.chunk)
    attrs = attributes(sweep, solver, counts, max(spent[SECONDS], time.monotonic() - began))
    of_stages: dict[str, dict[str, object]] = {}
    for stage in run.stages:
        of_stages[stage.attribute] = of_stages.get(stage.attribute, {}) | dict(stage.described)
    target.finish(attrs | {name: json.dumps(about) for name, about in of_stages.items()})


def _lanes(
    sweep: Sweep, read: Read, parts: Iterable[Region], spent: dict[str, float]
) -> Iterator[tuple[list[Region], Features]]:
    """Yield consecutive regions with their lanes, with one chunk in memory at a time.

    They hold all initial conditions of their points, which are compared. `spent` adds up what the chunks took.
    """
    starts = sweep.shape[-1] if sweep.crosses_starts else 1
    names, size = variables_of(sweep.system), sweep.plan.chunk
    at, chunk, group = -1, Features(), list[Region]()
    for region in parts:
        group.append(region)
        if region.end % starts:
            continue
        first, end, pieces = group[0].first, region.end, []
        for index in range(first // size, (end - 1) // size + 1):
            if index != at:
                at, chunk = index, dict(read(index))
                spent.update({name: spent[name] + float(chunk.pop(name)) for name in spent})
            begin = index * size
            pieces.append({name: x[max(first - begin, 0) : end - begin] for name, x in chunk.items()})
        lanes = joined(pieces)
        if starts > 1 and "regime" in lanes:
            of_points = lanes, lanes["regime"], starts
            lanes = lanes | {"hidden_motion": hides_another(*of_points), "sensitive": shares_transient(*of_points)}
        yield group, {name: lanes[name] for name in names if name in lanes}
        group = []


def _template(sweep: Sweep, variables: Mapping[str, np.ndarray]) -> xr.Dataset:
    """Return the dataset with placeholder values that take no memory, given the variables of some of its lanes."""
    columns: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, Any]]] = {}
    rows: dict[str, int] = {}
    known = described_variables(sweep)
    for name, x in variables.items():
        along = (known[name].along,) if x.ndim == 2 else ()
        rows |= dict(zip(along, x.shape[1:], strict=True))
        placeholder = np.broadcast_to(np.zeros((), x.dtype), (*sweep.shape, *x.shape[1:]))
        columns[name] = ((*sweep.dims, *along), placeholder, known[name].attributes())
    return xr.Dataset(columns, dict(coordinates(sweep, rows)))


def described_variables(sweep: Sweep) -> dict[str, Variable]:
    """Return all variables that the dataset of a sweep may have, by name and in dataset order."""
    known, radius = variables_of(sweep.system), sweep.hole_radius
    return known if radius is None else known | with_radius(radius)


def certified(sweep: Sweep, variables: Mapping[str, np.ndarray]) -> dict[str, int]:
    """Count the lanes by the outcome of their error control.

    The counts are: lanes with an error estimate, within the error tolerance, still settling, sensitive, and with a
    different regime in their check run. Sensitive lanes do not count as within the tolerance.
    """
    done = variables["reason"] == 0
    estimate = variables["error_estimate"][done]
    within = estimate <= sweep.run.error
    counts = {"estimated": int(np.sum(~np.isnan(estimate))), "within": int(np.sum(within))}
    if "sensitive" in variables:
        sensitive = variables["sensitive"][done] == 1
        counts |= {"within": int(np.sum(within & ~sensitive)), "sensitive": int(np.sum(sensitive))}
    if "drift_estimate" in variables:
        counts["still_settling"] = int(np.sum(variables["drift_estimate"][done] > sweep.run.error))
    if "regime" in variables:
        counts["regime_flips"] = int(np.sum(variables["regime"] != variables["check_regime"]))
    return counts


def attributes(sweep: Sweep, solver: dict, certified: Mapping[str, int], wall_time: float) -> dict[str, Any]:
    """Return the attributes of the dataset.

    `solver`: the stepper and its settings; `certified`: counts over all lanes, see
    [vibrojax.maps.dataset.certified][]; `wall_time`: duration of the computation [s].
    """
    title = sweep.title or f"{sweep.scene}: {sweep.name}"
    return {
        **shared_attributes(sweep, "sweep", title, f"sweep {sweep.name}"),
        "sweep": sweep.text,
        # Includes defaults that the sweep file omits, because regimes depend on the times. Omits the chunk size.
        "run": json.dumps({name: value for name, value in sweep.run.described().items() if value is not None}),
        IDENTITY: identity_text(sweep.identity()),
        "solver": json.dumps(solver),
        "certified": json.dumps({"error": sweep.run.error, "lanes": sweep.lanes, **certified}),
        "wall_time_s": float(wall_time),
        "lanes": sweep.lanes,
    }


def shared_attributes(sweep: Sweep, kind: str, title: str, command: str) -> dict[str, Any]:
    """Return the attributes that the datasets of a sweep and of analyses of its lanes have in common."""
    return {
        **dataset_attributes(kind, title, command, scene=sweep.scene),
        **sweep.options,
        **attributes_of_parameters(sweep.system, sweep.parameters),
    }


def attributes_of_parameters(scene: Scene[Any], values: Mapping[str, float]) -> dict[str, str]:
    """Return the attributes that state the fixed parameters; of a scene of the user's own, also their units."""
    table = scene.parameters()
    stated = {"parameters": json.dumps(values), "differing": json.dumps(differing(table, values))}
    units = {name: table[name].unit for name in values if name in table and table[name].unit != "1"}
    return stated | ({"parameter_units": json.dumps(units)} if units and scene.name not in SCENES else {})


def coordinates(sweep: Sweep, rows: Mapping[str, int]) -> dict:
    """Return the coordinates of the dataset by name, each as (dimensions, values, attributes).

    `rows`: sizes of the dimensions that are added to the sweep's own, by name.
    """
    coords: dict[str, tuple] = {}

    def add(name: str, along: str, values: np.ndarray, long_name: str, unit: str = "1") -> None:
        coords[name] = ((along,), values, {"units": unit, "long_name": long_name})

    for along, columns in (("", sweep.axes), ("point", sweep.points or {})):
        for name, column in columns.items():
            coords[name] = ((along or name,), column, parameter_attributes(sweep, name))
    states = {f"{VECTOR}{state.name}": state for state in sweep.system.states}
    vectors = sweep.starts.columns if sweep.starts is not None and sweep.starts.has_vectors else {}
    if sweep.own_starts:
        for name, column in vectors.items():
            add(name, "point", column, f"{states[name].long_name} at t = 0", states[name].unit)
    if sweep.points is not None:
        add("point", "point", np.arange(sweep.shape[0]), "number of the point")
    if sweep.run.carry is not None:
        meaning = f"way along {sweep.run.carry} in which lanes run, each from where the last one ended"
        add("direction", "direction", np.array(DIRECTIONS), meaning)
    elif sweep.starts is not None and not (sweep.own_starts and vectors):
        names = [start if isinstance(start, str) else json.dumps(list(start)) for start in sweep.starts]
        labels = np.array(names) if sweep.starts.listed else np.arange(len(names))
        add("start", "point" if sweep.own_starts else "start", labels, "start of the motion")
        for name, column in vectors.items():
            coords[name] = (("start",), column, {})  # a scene may start from other states than its own
            if name in states:
                add(name, "start", column, f"{states[name].long_name}, at t = 0", states[name].unit)
    if "return_index" in rows:
        length = np.arange(rows["return_index"])
        add("return_index", "return_index", length, "number of the return that is kept, the newest last")
    if "multiplier" in rows:
        add("multiplier", "multiplier", np.arange(rows["multiplier"]), "number of the multiplier, by falling modulus")
    return coords


def parameter_attributes(sweep: Sweep, name: str) -> dict[str, str]:
    """Return units, meaning and symbol of a parameter of a sweep."""
    if name in sweep.system.choice_meanings:
        return {"units": "1", "long_name": sweep.system.choice_meanings[name]}
    parameter = (dict(parameters := sweep.system.parameters()) | substitutes(parameters))[name]
    return {"units": parameter.unit, "long_name": parameter.long_name, "symbol": parameter.symbol}
