"""The explorer's view of a dataset over axes, such as a sweep, attractors or a fit: JSON document and motions.

The dataset contains the features of each lane, not its motion. For the motions, the sweep is run again with its orbits,
which gives the state of each lane at the section. From that state the lane's steps are recorded: one period of a
periodic lane, or some section crossings of any other lane.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError, shown
from vibrojax.explorer import document
from vibrojax.explorer.document import SYMBOL_MAX_CHARACTERS, Document
from vibrojax.explorer.encoding import Cell, pack
from vibrojax.explorer.plots_view import items_of
from vibrojax.explorer.recording import SECTION_RETURNS, SHOWN_RETURNS, SHOWN_SECONDS, Excerpt, record_cells
from vibrojax.io.attributes import flags, parameters_of
from vibrojax.io.kinds import kind_of
from vibrojax.io.variables import orbit_name
from vibrojax.lanes.inputs import Features, LaneInputs
from vibrojax.lanes.run import LaneRun
from vibrojax.maps.rerun import has_lanes_of
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.repeats import state_name
from vibrojax.periodic.lane_stages import stop_rule
from vibrojax.periodic.measuring import DRIVEN_RETURNS
from vibrojax.periodic.orbit_stages import OrbitStage
from vibrojax.pictures import contents, overlays
from vibrojax.pictures.axes import scale, with_unit
from vibrojax.pictures.colours import regime_names
from vibrojax.pictures.contents import FORM, REGIME, RETURN, START
from vibrojax.pictures.maps import REGION
from vibrojax.pictures.overlays import LINES, ON_MAPS
from vibrojax.pictures.plots import Plot
from vibrojax.pictures.returns import returns_label
from vibrojax.pictures.starts import described, on_axes, varied_states
from vibrojax.progress import Progress, quiet
from vibrojax.studies.attractors import attractor_colours

LANE = "lane_number"  # name of the variable with the number of the lane that each map cell shows

LEADING_VARIABLES = (
    *("lane_attractor", "regime", "rate_of_penetration"),
    *("share", "elasticity", "impact_velocity", "period", "bit_amplitude"),
)

OVERLAY_MAX_POINTS = 200_000  # points of curves above which a page, of tens of megabytes, does not draw them
REPEAT_MARGIN = 1e-3  # additional recorded time, in return intervals, so that the last crossing is recorded


def map_document(ds: xr.Dataset, sweep: Sweep | None = None) -> Document:
    """Return the JSON document of a dataset over axes, and its sweep, if it has one; empty if nothing can be shown."""
    if sweep is not None and LANE not in ds and has_lanes_of(ds, sweep):
        numbers = xr.DataArray(sweep.over_dims(np.arange(sweep.lanes)).astype(np.int32), dims=sweep.dims)
        ds = ds.assign({LANE: numbers.squeeze([name for name in sweep.dims if name not in ds.dims])})
    if START in ds.dims and START in ds.coords:
        ds = described(on_axes(ds))
    if FORM in ds.dims:
        ds = contents.named_groups(ds)
    if contents.ATTRACTOR in ds.dims:  # numbers are names
        names = [str(number) for number in range(ds.sizes[contents.ATTRACTOR])]
        ds = ds.assign_coords({contents.ATTRACTOR: (contents.ATTRACTOR, names, {"long_name": "attractor"})})
    if "sign" in ds.dims:  # of pushes
        sides = np.where(ds["sign"].values > 0, "positive", "negative")
        ds = ds.assign_coords(sign=("sign", sides, {"long_name": "side of the push"}))
    of_attractors = attractor_colours(ds) if {"share", REGIME} <= {*ds} and contents.ATTRACTOR in ds.dims else ()
    variables = [document.variable_document(ds[name], of_attractors) for name in _shown_variables(ds)]
    for variable in variables:
        if "inner" in variable:
            variable["label"] = with_unit(returns_label(ds[variable["name"]]), variable["units"])
        if variable["name"] == "lane_attractor" and {REGIME, "share"} <= set(ds) and contents.ATTRACTOR in ds.dims:
            variable["flags"] |= _attractor_names(ds)
    if not variables:
        return {}
    lane_axes = [str(dim) for dim in ds[LANE].dims] if LANE in ds else []
    dims = dict.fromkeys([*(dim for each in variables for dim in each["axes"] if dim != RETURN), *lane_axes])
    axes = sorted(dims, key=lambda name: lane_axes.index(name) if name in lane_axes else len(lane_axes))
    return document.document_with(
        ds,
        "grid",
        variables,
        axes=[document.axis_document(ds, name) for name in axes],
        lanes=pack(ds[LANE].values) | {"axes": lane_axes} if LANE in ds else None,
        fixed={
            str(name): document.json_value(data.values.item()) for name, data in ds.coords.items() if data.ndim == 0
        },
        region={name: list(ends) for name, ends in REGION.items()},
        # A fit lacks an axis of its sweep, so none of its map cells is a parameter point.
        run=None if FORM in ds.dims or not ds.attrs.get("scene") else document.run_document(ds, sweep),
        view=(along := _first_axes(ds)),
        first=first_cell(ds, variables, along),
    )


def _shown_variables(ds: xr.Dataset) -> list[str]:
    """Return the names of the displayed variables, the most informative first."""
    names = [str(name) for name, data in ds.data_vars.items() if data.dtype.kind in "fiu" and data.ndim > 0]
    # Individual section crossings are drawn over one axis only, and results of the check run are not drawn.
    over_one_axis = REGIME in ds and contents.swept(ds) and len(contents.long_axes(ds)) < 2
    diagram = contents.returns_in(ds) if over_one_axis else None
    hidden = [n for n in names if n == LANE or n.startswith(("return_", "check_")) or RETURN in ds[n].dims]
    names = [name for name in names if name == diagram or name not in hidden]
    leads = ("objective",) if LANE in ds else ("push_", "objective")  # of pushes with motions, the regimes lead
    first = [name for name in names if name == diagram or name.startswith(leads)]
    # Fractions are more informative than single regimes.
    first += ["share"] if "share" in names and START in ds.dims and len(_basin_states(ds)) < 2 else []
    return list(dict.fromkeys([*first, *(name for name in LEADING_VARIABLES if name in names), *names]))


def _attractor_names(ds: xr.Dataset) -> dict[str, str]:
    """Return the names of attractors by number, with the regime of those that have the same wherever they occur."""
    found, names = {}, regime_names(ds[REGIME])
    for number in range(ds.sizes[contents.ATTRACTOR]):
        regime = ds[REGIME].where(ds["share"] > 0).isel(attractor=number).values
        kinds = [names.get(int(flag), "") for flag in np.unique(regime[np.isfinite(regime)])]
        found[str(number)] = ", ".join([f"attractor {number}", *(kinds if len(kinds) == 1 else [])])
    return found


def _first_axes(ds: xr.Dataset) -> list[str]:
    """Return the axes of the first map, the same as in the picture; empty without a map over two axes.

    An empty name stands for a curve. Attractors have the basins over two states of the initial conditions.
    """
    if LANE in ds and "motion" in ds.dims:  # pushes: the names of the motions have room at the left
        return ["sign", "motion"]
    if FORM in ds.dims and len(groups := [name for name in contents.lane_dims(ds) if ds.sizes[name] > 1]) == 1:
        return [*groups, ""]
    if len(states := _basin_states(ds)) > 1:
        return [f"{START}:{name}" for name in states[:2]]
    if contents.POINT in contents.lane_dims(ds) and len(names := sorted(contents.varied(ds), reverse=True)) == 2:
        return [f"{contents.POINT}:{name}" for name in names]
    long = contents.long_axes(ds)
    if len(long) > 1 and "regime" not in ds:
        return list(long[:2])
    try:
        return list(contents.axes_of_map(ds))
    except InputError:
        return [str(name) for name in ds.dims if str(name).startswith("start_")][:2]


def _basin_states(ds: xr.Dataset) -> tuple[str, ...]:
    return varied_states(ds)[::-1][:2][::-1] if "lane_attractor" in ds and START in ds.dims else ()


def first_cell(ds: xr.Dataset, variables: list[Document], along: list[str]) -> dict[str, int]:
    """Return the cell shown first: the single impact nearest to the middle, stable if that is known.

    On axes other than `along`, the axes of the first view, the index is 0 if a single impact exists there. For
    attractors, the cell is the most frequent attractor; for fits, the form with the lowest AIC.
    """
    if FORM in ds.dims and "aic" in ds:
        aic = ds["aic"].median([dim for dim in ds["aic"].dims if dim != FORM])
        return {FORM: int(aic.argmin(FORM))} if aic.notnull().any() else {}
    if "sign" in ds.dims:
        counts = [x.notnull().sum([d for d in x.dims if d != "sign"]) for x in ds.values() if "sign" in x.dims]
        first = {"sign": int(np.argmax(np.sum([x.values for x in counts], axis=0)))}
        if "motion" in ds.dims:  # the first of those that leave the working cycle
            leaves = (ds["regime"] != ds["regime"].isel(motion=0)).isel(first)
            first["motion"] = int(leaves.any([name for name in leaves.dims if name != "motion"]).argmax("motion"))
        return first
    if "place" in ds and contents.POINT in ds.dims:  # of a tolerance box: the nominal point
        return {contents.POINT: 0}
    if {"share", "lane_attractor"} <= set(ds.variables):
        middle = {str(name): size // 2 for name, size in ds["share"].sizes.items() if name != "attractor"}
        return middle | {"attractor": int(ds["share"].isel(middle).argmax("attractor"))}
    singles = [
        int(k)
        for x in variables
        if x["name"] == "regime"
        for k, name in (x["flags"] or {}).items()
        if name == "single-impact"
    ]
    if not singles:
        return {contents.POINT: ds.sizes[contents.POINT] // 2} if contents.POINT in ds.dims else {}
    single, names = ds["regime"] == singles[0], [str(name) for name in ds["regime"].dims]
    if "stable" in ds and set(ds["stable"].dims) == set(names):
        stable = single & (ds["stable"] == 1)
        single = stable if stable.any() else single
    if not single.any():
        return {}
    along = along or [max(names, key=lambda name: ds.sizes[name])]
    cells, sizes = np.argwhere(single.transpose(*names).values), np.array([ds.sizes[name] for name in names])
    inside = np.array([name in along for name in names])
    away = np.where(inside, np.abs(cells / np.maximum(sizes - 1, 1) - 0.5), 10.0 * (cells > 0))
    return {name: int(k) for name, k in zip(names, cells[np.argmin((away**2).sum(axis=1))], strict=True)}


def overlay_document(ds: xr.Dataset, over: xr.Dataset) -> Document:
    """Return the part of the JSON document with what is drawn over the page of `ds`: borders or curves, or families."""
    if kind_of(over) in ON_MAPS:
        return {"curves": curves_document(ds, over)}
    shown_returns = contents.returns_in(ds)
    if kind_of(over) != "family" or shown_returns is None or not contents.swept(ds):
        raise InputError(
            "over: holds no borders or curves; give the dataset of vibrojax borders or curves, or families over returns"
        )
    along = max(contents.swept(ds), key=lambda name: ds.sizes[name])
    overlays.check_families(ds, [over], along)
    name = overlays.variable_over(shown_returns)
    lines = Plot(overlays.over_layers([over], ds, along, name, scale(ds[shown_returns])[0]))
    return {"overlay": {"variable": shown_returns, "along": along, "items": items_of(lines)}}


def curves_document(ds: xr.Dataset, over: xr.Dataset) -> Document:
    """Return the borders or curves `over`; raise `InputError` if they are malformed, or are not of the map of `ds`."""
    axes, of_curves = overlays.axes_of(over), kind_of(over) == "curves"
    overlays.check_borders(ds, over, *axes)
    point, number = ("point", over["point_curve"].values) if of_curves else ("vertex", over["curve"].values)
    _check_points(over, axes, point)
    shown_curves = overlays.curves_on_map(over, ds, *axes) if of_curves else np.ones(over.sizes["curve"], bool)
    if of_curves and not shown_curves.any():
        raise InputError("over: no curve has the parameters of the map; continue curves with the same values")
    kinds, fixed = flags(over["kind"]), parameters_of(over) if of_curves else {}
    curves: dict[int, Document] = {}
    for curve in np.flatnonzero(shown_curves).tolist():
        plane: Document = {name: document.json_value(over[name].values[curve].item()) for name in overlays.beyond(over)}
        if START in over.coords:
            plane[START] = str(over[START].values[curve])
        plane |= {name: value for name, value in fixed.items() if name in ds.dims and name not in axes}
        points = {n: [document.json_value(x) for x in over[n].values[number == curve].tolist()] for n in axes}
        curves[curve] = {"kind": kinds[int(over["kind"][curve])], "at": plane, "points": points}
    corners: list[Document] = []
    if of_curves:
        _check_points(over, tuple(f"codim2_{name}" for name in axes), "codim2")
        for k, curve in enumerate(over["codim2_curve"].values.tolist()):
            if curve not in curves:
                continue
            place = {name: document.json_value(over[f"codim2_{name}"].values[k].item()) for name in axes}
            name = document.one_line(over["codim2_kind"].values[k], SYMBOL_MAX_CHARACTERS)
            corners.append({"kind": name, "at": curves[curve]["at"], "point": place})
    colours = {kind: str(line["colour"]) for kind, line in LINES.items()}
    return {"of": kind_of(over), "colours": colours, "list": list(curves.values()), "corners": corners}


def _check_points(over: xr.Dataset, names: Sequence[str], dimension: str) -> None:
    """Raise `InputError` unless the named variables are finite numbers along a dimension."""
    if (size := over.sizes.get(dimension, 0)) > OVERLAY_MAX_POINTS:
        raise InputError(f"over: {size} along {dimension}, more than the {OVERLAY_MAX_POINTS} of a page")
    for name in names:
        data = over.get(name)
        if data is None or data.dims != (dimension,) or data.dtype.kind not in "fiu":
            raise InputError(f"over: variable {shown(name)} is not a number along {dimension}")
        if not np.isfinite(data.values).all():
            raise InputError(f"over: variable {name} is not finite")


def lane_cells(sweep: Sweep, progress: bool = True) -> Iterator[Cell]:
    """Run a sweep again, chunk by chunk, and yield the motions of its lanes in the order of `Sweep.counted`."""
    names = sweep.system.driving_part().return_states
    sweep = replace(sweep, run=replace(sweep.run, orbits=bool(names)))
    like, plan = sweep.inputs(0, 1), sweep.plan
    stages = [OrbitStage(like.scene, like.run, like.start_names)] if names else []
    run = LaneRun(like, plan, stop_rule(like, plan), stages)
    with Progress(sweep.lanes, "lanes", progress) as bar:
        for index in range(sweep.chunks):
            first, end = sweep.chunk(index)
            inputs = sweep.inputs(first, end)
            with quiet():
                yield from _chunk_cells(first, inputs, run, run.chunk(inputs, bar.add).features)


def _chunk_cells(first: int, inputs: LaneInputs, run: LaneRun, features: Features) -> list[Cell]:
    """Return the motions of the lanes of a chunk, which are numbered from `first` on."""
    scene, parameters = inputs.scene, dict(inputs.parameters)
    state, excerpt = _excerpts(inputs, run, features)
    reasons = np.full(len(inputs), "its motion was not found", object)
    reasons[~features["finished"]] = "failed: it took too many steps"
    reasons[~features["finite"]] = "failed: it is not finite"
    refusal = scene.refused(parameters)
    if refusal is not None:
        reasons[np.broadcast_to(np.asarray(refusal[1]), reasons.shape)] = f"refused: {refusal[0].replace('-', ' ')}"
    cells = [Cell(lane, "none", str(reason)) for lane, reason in enumerate(reasons, first)]
    usable = np.isfinite(state).all(axis=0) & np.isfinite(excerpt.recorded) & (excerpt.recorded > 0)
    usable &= np.array([not cell.note.startswith(("refused", "failed")) for cell in cells])
    # A batch runs until its longest record ends: lanes with similar ratios of recorded to shown time share one.
    order = np.flatnonzero(usable)
    order = order[np.argsort(excerpt.recorded[order] / np.maximum(excerpt.shown[order], 1e-9), kind="stable")]
    parameters = {name: x[order] for name, x in parameters.items()}
    for lane, cell in zip(order, record_cells(scene, parameters, state[:, order], excerpt.of(order)), strict=True):
        multipliers = None
        if "multiplier_abs" in features:
            multipliers = np.stack([features[f"multiplier_{name}"][lane] for name in ("abs", "arg")], axis=1)
            multipliers = multipliers if np.isfinite(multipliers).all() else None
        cells[lane] = replace(cell, lane=first + int(lane), multipliers=multipliers)
    return cells


def _excerpts(
    inputs: LaneInputs, run: LaneRun, features: Features
) -> tuple[Float[np.ndarray, "states lanes"], Excerpt]:
    """Return the states from which a chunk's lanes are recorded: of orbits, section crossings or settled lanes."""
    scene, parameters, count = inputs.scene, inputs.parameters, len(inputs)
    driving = scene.driving_part()
    zero, nan = np.zeros(count), np.full(count, np.nan)
    orbit_cycles = features.get("orbit_cycles", zero)
    state = np.zeros((len(scene.states), count))
    for name in driving.return_states:
        last = features[state_name(name)][:, -1] if state_name(name) in features else nan
        state[scene.place(name)] = np.where(orbit_cycles > 0, features.get(orbit_name(name), last), last)
    period = features["period"] if "period" in features else 1 / parameters.get("frequency", nan)
    unknown = ~np.isfinite(state).all(axis=0) | ~(np.isfinite(period) & (period > 0)) | (not driving.return_states)
    cycles = np.where(orbit_cycles > 0, orbit_cycles, features.get("cycles", zero))
    returns = np.where(unknown, 0, np.where(cycles > 0, np.maximum(cycles, 1), SHOWN_RETURNS)).astype(int)
    repeats = ~unknown & (cycles > 0)
    skipped = np.where(unknown, 0.0, (DRIVEN_RETURNS if driving is not scene else 0) * period)
    shown = np.where(unknown, SHOWN_SECONDS, returns * period)
    beyond_return = np.where(repeats, shown + REPEAT_MARGIN * period, SECTION_RETURNS * period)
    recorded = skipped + np.where(unknown, SHOWN_SECONDS, beyond_return)
    if unknown.any() and not inputs.row:
        subset = np.flatnonzero(unknown)
        [batch] = run.engine.settle([run.engine.start(inputs.of(subset), run.accuracy)])
        assert batch.underway is not None
        state[:, subset] = np.stack([np.asarray(x, float) for x in batch.underway.lane.state])
    elif unknown.any():  # a lane's settled state depends on those of previous lanes, which are not stored
        state[:, unknown] = np.nan
    return state, Excerpt(repeats, skipped, shown, skipped, recorded, returns)
