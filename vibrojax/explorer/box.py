"""A part of a sweep's map computed anew: the box of two axes that a user zooms into, with as many cells as the map."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from vibrojax.errors import Place, shown
from vibrojax.explorer.document import Document
from vibrojax.explorer.encoding import pack
from vibrojax.maps.executor import compute
from vibrojax.maps.rerun import rerun_problem
from vibrojax.maps.run import joined
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic.lane_stages import lane_run

BOX_MAX_SIDE = 50
"""Maximum number of values along an axis of a box; more cells would take minutes."""

PLACE = Place("explore", "box")


def box_of(sweep: Sweep, lane: int, box: object, check: Callable[..., None]) -> Document:
    """Return the variables of a sweep over a box of two of its axes, as JSON.

    **Arguments:** `lane`: number of a lane with the box's other parameters and initial condition; `box`: [low, high] in
    SI units by axis; `check`: called often; an exception that it raises ends the computation.

    **Returns:** `axes`: values by name; `variables`: packed arrays over these axes by name.

    **Raises:** `InputError` if the box does not belong to the sweep, or takes too many steps.
    """
    ends = _ends(sweep, box)
    axes = {
        name: np.linspace(ends[name][0], ends[name][1], min(len(x), BOX_MAX_SIDE))
        for name, x in sweep.axes.items()
        if name in ends
    }
    values, _ = sweep.lane_values(lane, lane + 1)
    fixed = {name: float(x[0]) for name, x in values.items() if name not in axes}
    starts = sweep.starts
    if starts is not None and len(starts):
        index = [int(sweep.lane_values(lane, lane + 1)[1][0])]
        starts = replace(starts, number=starts.number[index], vectors=starts.vectors[index])
    run = replace(sweep.run, orbits=False, keep_returns=0)
    part = replace(sweep, axes=axes, parameters=sweep.parameters | fixed, starts=starts, run=run)
    if problem := rerun_problem(part):
        raise PLACE.error(f"it has {problem}")
    began, lanes = time.monotonic(), lane_run(part.inputs(0, 1), part.plan)
    whole = joined(part, lanes, dict(compute(part, lanes, range(part.chunks), check)), began)
    ds = whole.isel({name: 0 for name in whole.dims if name not in axes}, drop=True)
    arrays = {str(name): x.transpose(*axes) for name, x in ds.data_vars.items() if set(x.dims) == set(axes)}
    return {
        "axes": {name: x.tolist() for name, x in axes.items()},
        "variables": {name: pack(x.values) for name, x in arrays.items() if x.dtype.kind in "fiu"},
    }


def _ends(sweep: Sweep, box: object) -> Mapping[str, Any]:
    if sweep.run.carry is not None or sweep.points is not None:
        raise PLACE.error("only grids of independent lanes have boxes")
    if not isinstance(box, dict) or len(box) != 2 or not set(box) <= set(sweep.axes):
        raise PLACE.error(f"{shown(box)} is not a table of two of the axes {', '.join(sweep.axes)}")
    for name, ends in box.items():
        place, known = PLACE.at(name), sweep.axes[name]
        if known.dtype.kind != "f" or not isinstance(ends, list) or len(ends) != 2:
            raise place.error("give [low, high] of an axis of numbers")
        numbers = all(isinstance(x, (int, float)) and np.isfinite(x) for x in ends)
        step = np.ptp(known) / max(len(known) - 1, 1)
        if not numbers or not known.min() - step <= ends[0] < ends[1] <= known.max() + step:
            raise place.error(f"{shown(ends)} is not an interval within that of the map")
    return box
